"""Pictures of surfaces, drawn without a screen: the same bytes on every machine."""
