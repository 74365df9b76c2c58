"""What a URDF must fulfil before it is converted: its elements, its tree, its bodies."""
