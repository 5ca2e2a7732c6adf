"""Motions that take time: collision-free paths, and the fastest timing of each. Nothing here changes a world.

A query has a start and a goal in a :mod:`space`, which has the free configurations. :mod:`path` takes the straight
line, or a path that :mod:`rrt_connect` finds. :mod:`timing` makes it as fast as the limits allow.
"""

from pycram.planning.motions import (
    base_motion as base_motion,
    joint_motion as joint_motion,
    line as line,
    through as through,
    together as together,
)
from pycram.planning.path import PlannedMotion as PlannedMotion
