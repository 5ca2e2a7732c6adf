"""Designators of motions, and the process modules that perform these motions (thesis 4.5-4.9)."""
