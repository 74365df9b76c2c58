"""What a URDF must fulfill before it is converted: its elements, its tree, its bodies."""
