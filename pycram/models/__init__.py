"""Models: from the file that a user names to a checked, self-contained URDF with shapes and convex pieces."""
