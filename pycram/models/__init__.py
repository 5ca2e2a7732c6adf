"""Models: the conversion of a user's file to a checked, self-contained URDF with shapes and convex pieces."""
