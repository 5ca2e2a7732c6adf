"""Worlds and the objects in them; every change is a world transaction (:mod:`pycram.world.transaction`)."""
