"""Motions that take time: paths on which nothing is touched, and their times. Nothing here changes a world.

General layout: a query is a start and a goal in a space (:mod:`space`); what is in the way there says :mod:`clearance`;
:mod:`path` takes the straight line, or what :mod:`rrt_connect` finds, and :mod:`timing` makes it as fast as
:mod:`rates` allow.
"""

from pycram.planning.base_motion import base_motion as base_motion
from pycram.planning.joint_motion import joint_motion as joint_motion, through as through, together as together
from pycram.planning.planned import Planned as Planned
from pycram.planning.tool_line import line as line
