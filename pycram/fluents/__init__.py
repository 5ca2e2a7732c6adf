"""Fluents: expressions with values, their pulses, waiting for them, and those that follow a world."""
