"""What the slots of motion designators may hold: one check per kind of value.

A check takes the slot's value and gives it back in the form that process modules work with, or raises BadArgument with
what is expected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

from pycram import checks
from pycram.failures import BadArgument

Value: TypeAlias = Any
Check: TypeAlias = Callable[[str, Value], Value]

SIDES = ("left", "right")
GRASPS = ("front", "top", "left", "right")


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
    from pycram.objects import Object  # noqa: PLC0415  objects know nothing of designators

    if not isinstance(value, Object):
        raise BadArgument(name, value, "an Object of a world")
    return value


def kind(name: str, value: Value) -> Value:
    """A type of objects, or an object of that type."""
    return checks.text(name, getattr(value, "type", value))


def side(name: str, value: Value) -> Value:
    """An arm's name: "left" or "right" on the PR2."""
    return checks.text(name, value)


def grasp(name: str, value: Value) -> Value:
    """The side from which the gripper comes: "front", "top", "left" or "right"."""
    if value not in GRASPS:
        raise BadArgument(name, value, f"one of {', '.join(GRASPS)}")
    return value


def distance(name: str, value: Value) -> Value:
    """A distance in m, or an angle in rad for what turns, from 0 up."""
    number = checks.number(name, value)
    if number < 0:
        raise BadArgument(name, value, "a number from 0 up")
    return number


def posture(name: str, value: Value) -> Value:
    """A named posture such as "park", or a list of joint values in rad."""
    if isinstance(value, str):
        return checks.text(name, value)
    if not isinstance(value, Iterable | np.ndarray):
        raise BadArgument(name, value, '"park" or a list of joint values')
    return [checks.number(name, item) for item in value]
