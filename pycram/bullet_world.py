"""Worlds and their objects, under the names of the thesis (sections 4.2 and 4.3)."""

from pycram.world.object import Object
from pycram.world.world import BulletWorld

__all__ = ["BulletWorld", "Object"]
