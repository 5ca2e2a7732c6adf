"""Reasoning about worlds (thesis 4.4); :mod:`pycram.bullet_world_reasoning` exports the queries."""
