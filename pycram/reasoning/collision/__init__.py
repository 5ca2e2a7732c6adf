"""Collisions of a robot in other postures, computed in copies of the world."""
