"""Reasoning about worlds (thesis 4.4); :mod:`pycram.bullet_world_reasoning` exports the queries.

Callers of functions that aren't queries hold the world's lock. An argument ``base`` is an assumed pose of the robot's
base, or None for its present pose. An argument ``choice`` receives the results for candidates. A ``quick`` search may
miss results.
"""
