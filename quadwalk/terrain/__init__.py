"""Ground that is not flat: heights on a grid, made from a seed or read from a file. No JAX."""
