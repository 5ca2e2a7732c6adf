"""Live worlds, answers and pictures from a recording. This package and the packages above it import the executor."""
