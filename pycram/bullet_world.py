"""Worlds and the objects in them, under the names of the thesis (4.2, 4.3)."""

from pycram.world.object import Object
from pycram.world.world import BulletWorld

__all__ = ["BulletWorld", "Object"]
