"""Models: they turn the file that a user names into a checked, self-contained URDF with shapes and convex pieces."""
