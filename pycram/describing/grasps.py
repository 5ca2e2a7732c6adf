"""A check of a robot's description: its arms pick up household objects from a table."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from pycram.foundation.failures import PlanFailure
from pycram.models.robots.description import Arm
from pycram.motions.designator import MotionDesignator
from pycram.motions.modules.pick_up import PickUp
from pycram.reasoning.kinematics.forward import Chain
from pycram.reasoning.kinematics.inverse import halton_postures
from pycram.world.object import Object
from recorder import geometry
from recorder.geometry import Pose, Vector

OBJECTS: Final = ("cup", "bottle", "spoon")  # names of the objects that an arm picks up
_PLACES: Final = 5  # number of places on the table for each object
_SAMPLES: Final = 1000  # number of sampled postures; the places on the table are below the tool in some of them
_TOP: Final = 0.72  # height in m of the table's top
_FRONT: Final = 0.3  # distance in m from the table's origin to its front edge
_INSET: Final = 0.1  # distance in m from the front edge to the objects
_BAND: Final = 0.25  # maximum height in m of the tool above the table
_LEVEL: Final = 0.3  # maximum z of the direction of the tool; a tool that points upwards takes nothing from a table
_LOW: Final = 25  # percentile of the tool's heights that is the height of the table, if the robot doesn't drive
_CLEAR: Final = 1e-3  # distance in m between an object and the table, so that they don't overlap


def picked_up(robot: Object, arm: Arm, chain: Chain) -> Iterator[tuple[str, int, int, str]]:
    """Try to pick up each object from several places on a table.

    The robot stands before the table; if it doesn't drive, the table has the height at which its arm works best.

    Yields:
        An object's name, the number of places from which the arm takes it, the number of places, and the first failure.
    """
    world, parked = robot.world, robot.get_joint_positions()
    world.robot = robot
    assert robot.description is not None  # noqa: S101  the caller has loaded the robot with a description
    table = Object("table", "environment", "table.urdf", [0.0, 0.0, -10.0], world=world)
    places = list(_places(robot, arm, chain, table))
    for name in OBJECTS:
        taken, failure = 0, "no posture of the arm brings the tool over a table"
        for place, pose in places:
            table.set_position_and_orientation(*pose)
            body = Object(name, name, f"{name}.stl", world=world)
            low = body.get_AABB()[0][2]
            body.set_position([place[0], place[1], pose[0][2] + _TOP - low + _CLEAR])
            try:
                PickUp().execute(MotionDesignator([("type", "pick-up"), ("object", body), ("arm", arm.name)]))
                taken += 1
            except PlanFailure as error:
                failure = str(error)
            body.remove()
            robot.set_joint_positions(parked)
        yield name, taken, len(places), failure
    table.remove()


def _places(robot: Object, arm: Arm, chain: Chain, table: Object) -> Iterator[tuple[Vector, Pose]]:
    """Yield places on a table before the robot, and a pose of the table at which it doesn't touch the robot."""
    assert robot.description is not None  # noqa: S101  see above
    poses = chain.poses(chain.limited(halton_postures(chain, 0, _SAMPLES)))
    tools = geometry.pose_matrix(robot.get_link_position_and_orientation(arm.base_link)) @ poses
    base, found = robot.get_position(), 0
    if robot.description.drives:
        top = robot.get_AABB()[0][2] + _TOP
    else:
        top = max(base[2], float(np.percentile(tools[:, 2, 3], _LOW)))
    above = tools[:, 2, 3] - top
    for x, y, z in tools[(above > 0.0) & (above < _BAND) & (tools[:, 2, 0] < _LEVEL), :3, 3].tolist():
        yaw = math.atan2(y - base[1], x - base[0])
        away = _FRONT - _INSET
        position = x + away * math.cos(yaw), y + away * math.sin(yaw), top - _TOP
        pose: Pose = position, geometry.from_rpy(0.0, 0.0, yaw)
        table.set_position_and_orientation(*pose)
        if robot.world.engine.deepest(robot.handle, table.handle) is None:
            yield (x, y, z), pose
            found += 1
        if found == _PLACES:
            return
