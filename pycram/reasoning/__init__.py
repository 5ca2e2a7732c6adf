"""Queries about worlds (thesis 4.4), one idea a module; :mod:`pycram.bullet_world_reasoning` is their public face."""
