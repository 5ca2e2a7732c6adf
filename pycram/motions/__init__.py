"""Designators and the process modules that carry them out (thesis 4.5-4.9)."""
