"""Worlds and the objects in them. Every change goes through the world transaction (:mod:`pycram.world.transaction`)."""
