"""Robots as data: one TOML file each."""
