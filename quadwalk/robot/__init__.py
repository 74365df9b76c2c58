"""From URDF to MuJoCo: strict reading, conversion to MJCF, and what training needs to know."""
