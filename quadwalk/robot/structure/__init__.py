"""A robot's structure, found from its URDF: tree, legs, feet, standing pose."""
