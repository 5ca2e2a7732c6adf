"""The physics engine: the only package that uses PyBullet."""
