"""What other programs need beside the surfaces: names of objects, properties of materials, scripts that import them."""
