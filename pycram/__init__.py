"""High-level robot plans, run in a physics world, with everything that happens on record."""
