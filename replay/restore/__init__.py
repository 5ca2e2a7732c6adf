"""Live worlds, answers and pictures from a recording. This room and those above it import the executor."""
