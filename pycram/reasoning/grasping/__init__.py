"""Grasps, fingers, handles, and putting objects down."""
