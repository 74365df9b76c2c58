"""Grids of cells with many episodes each: conditions, kinds of ground, commands."""
