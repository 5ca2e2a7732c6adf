"""Live worlds, answers and pictures from a recording. This package imports the executor."""
