"""Robots as data: each robot has a TOML file, which is checked against the robot's URDF."""
