"""Motions that take time: collision-free paths, and their fastest timing. No module here changes a world.

:mod:`path` takes the straight line in a configuration :mod:`space`, or the path that :mod:`rrt_connect` finds.
:mod:`timing` makes the path as fast as the limits allow.
"""

from pycram.planning.motions import (
    base_motion as base_motion,
    joint_motion as joint_motion,
    line as line,
    through as through,
    together as together,
)
from pycram.planning.path import PlannedMotion as PlannedMotion
