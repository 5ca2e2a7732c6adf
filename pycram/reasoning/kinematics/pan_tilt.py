"""Aiming a head: Newton's method turns the camera's axis to a point with a pan joint, a tilt joint, or both."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from recorder import geometry
from recorder.geometry import Pose, Vector

if TYPE_CHECKING:
    from pycram.models.robots.description import CameraDescription
    from recorder.urdf import Urdf, UrdfJoint

_ITERATIONS: Final = 30
_DERIVATIVE_STEP: Final = 1e-5  # rad
_TOLERANCE: Final = 1e-6  # rad
_GOOD_ENOUGH: Final = 1e-4  # with a smaller error in rad, no other start is tried
_MAX_STEP: Final = 0.5  # rad
_STARTS: Final = ((0.0, 0.0), (2.0, 0.3), (-2.0, 0.3))  # positions of the pan and the tilt joint, rad


def aim_camera(
    urdf: Urdf, joints: Sequence[str], camera: CameraDescription, point: Sequence[float], now: Mapping[str, float]
) -> tuple[dict[str, float], Vector]:
    """Return the joint positions that turn the camera's axis (z of its frame) to a point, or close to it.

    The joints are a pan joint, a tilt joint, both in this order, or none. The point is in the robot's root link, m;
    ``now`` has the present positions of all joints, rad or m. The other result is the point in the turned camera's
    frame, m.
    """
    turning, behind = _neck(urdf, joints, camera, now)

    def seen(values: Sequence[float]) -> Vector:
        at = dict(zip(joints, values, strict=True))
        pose = geometry.IDENTITY
        for before, joint in turning:
            pose = geometry.multiply(geometry.multiply(pose, before), joint.pose(at[joint.name]))
        return geometry.transform(geometry.invert(geometry.multiply(pose, behind)), point)

    def error(at: Vector) -> tuple[float, float]:
        """Return x and y in rad of the rotation vector from the camera's axis to the point, in the camera's frame."""
        x, y, z = at
        off_axis = math.hypot(x, y)
        scale = math.atan2(off_axis, z) / off_axis if off_axis > 1e-12 else 1.0
        return x * scale, y * scale

    limits = [(max(urdf.joint(name).lower, -math.pi), min(urdf.joint(name).upper, math.pi)) for name in joints]
    best, view, least = [0.0] * len(joints), geometry.IDENTITY[0], math.inf
    for start in itertools.chain([[now.get(name, 0.0) for name in joints]], _STARTS):
        turned = list(start[: len(joints)])
        at = seen(turned)
        here = error(at)
        for _ in range(_ITERATIONS if joints else 0):
            if math.hypot(*here) < _TOLERANCE:
                break
            moved = [
                [value + _DERIVATIVE_STEP * (i == k) for i, value in enumerate(turned)] for k in range(len(turned))
            ]
            there = np.array([error(seen(values)) for values in moved])
            step = np.linalg.lstsq((there - here).T / _DERIVATIVE_STEP, np.negative(here), rcond=None)[0]
            step *= min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
            before = turned
            turned = [
                min(max(value + float(change), low), high)
                for value, change, (low, high) in zip(before, step, limits, strict=True)
            ]
            if turned == before:
                break
            at = seen(turned)
            here = error(at)
        remaining = math.hypot(*here)
        if remaining < least - _TOLERANCE:
            best, view, least = turned, at, remaining
        if remaining < _GOOD_ENOUGH:
            break
    return dict(zip(joints, best, strict=True)), view


def _neck(
    urdf: Urdf, joints: Sequence[str], camera: CameraDescription, now: Mapping[str, float]
) -> tuple[Sequence[tuple[Pose, UrdfJoint]], Pose]:
    """Return the joints that turn the camera, with the fixed pose before each, and the fixed pose of the camera."""
    turning: list[tuple[Pose, UrdfJoint]] = []
    behind = geometry.IDENTITY
    for joint in urdf.chain(urdf.root, camera.frame):
        if joint.name in joints:
            turning.append((behind, joint))
            behind = geometry.IDENTITY
        else:
            behind = geometry.multiply(behind, joint.pose(urdf.value(joint.name, now)))
    return turning, camera.pose(behind)
