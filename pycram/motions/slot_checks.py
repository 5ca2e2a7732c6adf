"""Checks of slot values, one for each kind of value.

A check returns the value in the form that process modules work with, or raises BadArgument with what is expected. Its
docstring describes the value in messages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.reasoning.grasping.grasps import GRASPS
from pycram.world.world import BulletWorld, Object

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm

Value: TypeAlias = Any
Check: TypeAlias = Callable[[str, Value], Value]


def arm_names() -> tuple[str, ...]:
    """Return the names of the current robot's arms; "left" and "right" if none is known."""
    return tuple(_arms()) or ("left", "right")


def default_arm() -> str:
    """Return the arm that is meant where a plan names none: the only one, or the left one as in the thesis.

    Raises:
        BadArgument: The robot has several arms, and none is called "left".
    """
    arms = arm_names()
    if len(arms) > 1 and "left" not in arms:
        raise BadArgument("arm", None, f"one of {', '.join(arms)}, as the robot has several")
    return arms[0] if len(arms) == 1 else "left"


def only_arm() -> str:
    """Return the arm of a robot that has one.

    Raises:
        BadArgument: It has several.
    """
    arms = arm_names()
    if len(arms) != 1:
        raise BadArgument("arm", None, f"one of {', '.join(arms)}, as the robot has several")
    return arms[0]


def position(name: str, value: Value) -> Value:
    """[x, y, z] in m, world frame."""
    return list(checks.vector(name, value))


def orientation(name: str, value: Value) -> Value:
    """A quaternion [x, y, z, w], world frame."""
    return list(checks.quaternion(name, value))


def name(name: str, value: Value) -> Value:
    """A name."""
    return checks.text(name, value)


def body(name: str, value: Value) -> Value:
    """An Object of a world."""
    world = BulletWorld.current_bullet_world
    if not isinstance(value, Object):
        raise BadArgument(name, value, "an Object of a world")
    if world is not None and value.world is not world:
        raise BadArgument(name, value, f"an Object of the current world {world.name}, not of {value.world.name}")
    return value


def kind(name: str, value: Value) -> Value:
    """A type of objects, or an object of that type."""
    return checks.text(name, getattr(value, "type", value))


def arm(name: str, value: Value) -> Value:
    """An arm's name: "left" or "right" on the PR2."""
    arms = arm_names()
    if checks.text(name, value) not in arms:
        raise BadArgument(name, value, f"one of {', '.join(arms)}")
    return value


def grasp(name: str, value: Value) -> Value:
    """The side from which the gripper comes: "front", "top", "left" or "right"."""
    if value not in GRASPS:
        raise BadArgument(name, value, f"one of {', '.join(GRASPS)}")
    return value


def distance(name: str, value: Value) -> Value:
    """A distance in m, or an angle in rad for what turns, from 0 up."""
    return checks.in_range(name, value, 0.0)


def posture(name: str, value: Value) -> Value:
    """A named posture such as "park", or a list of joint values in rad."""
    described = _arms().get(name.removesuffix("-arm"))
    if isinstance(value, str):
        if described is not None and checks.text(name, value) not in described.poses:
            raise BadArgument(name, value, f"one of {', '.join(described.poses)}, or a list of joint values")
        return value
    if isinstance(value, Mapping) or not isinstance(value, Iterable | np.ndarray):
        raise BadArgument(name, value, '"park", or a list of the values of all its joints')
    values = [checks.number(name, item) for item in value]
    if described is not None and len(values) != len(described.joints):
        raise BadArgument(name, value, f"{len(described.joints)} joint values, for {', '.join(described.joints)}")
    return values


def _arms() -> Mapping[str, Arm]:
    """Return the arms of the current robot; none if it has no description."""
    world = BulletWorld.current_bullet_world
    robot = world.robot if world is not None else None
    return robot.description.arms if robot is not None and robot.description is not None else {}
