"""Robots as data: one TOML file each, checked against the robot's URDF when it is loaded."""
