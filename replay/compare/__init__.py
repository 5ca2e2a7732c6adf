"""Comparisons: of two states, two runs, two records."""
