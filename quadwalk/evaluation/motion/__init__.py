"""How a robot moved: kinematics, footfalls, gait."""
