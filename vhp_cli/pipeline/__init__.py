"""Pipeline: run a stage over a model, with workers, cache and resumption."""
