"""Robots as data: each robot has a TOML file that is checked against its URDF."""
