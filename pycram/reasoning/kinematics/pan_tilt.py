"""Aiming a pan-tilt head: Newton's method on its two joints turns the camera's axis to a point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.geometry.urdf import Urdf

_ITERATIONS: Final = 30
_DERIVATIVE_STEP: Final = 1e-5  # rad
_TOLERANCE: Final = 1e-6  # rad
_GOOD_ENOUGH: Final = 1e-4  # rad: further starts wouldn't be nearer to where the head is
_MAX_STEP: Final = 0.5  # rad


def look(
    urdf: Urdf, joints: tuple[str, str], camera: str, point: Sequence[float], now: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Turn the camera's axis (z of its frame) to a point.

    Args:
        urdf: of the robot.
        joints: names of the pan and the tilt joint.
        camera: the camera's optical frame.
        point: in the robot's root link, m.
        now: present values of all joints, rad or m.

    Returns:
        Values of the two joints within their limits, and the angle in rad that remains to the point.
    """

    def error(values: tuple[float, float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Return the rotation vector's two parts, in the camera's frame, from its axis to the point, rad."""
        pose = urdf.forward_kinematics({**now, **dict(zip(joints, values, strict=True))}, camera)
        x, y, z = geometry.transform(geometry.invert(pose), point)
        off_axis = math.hypot(x, y)
        angle = math.atan2(off_axis, z)
        scale = angle / off_axis if off_axis > 1e-12 else 1.0
        return np.array([x * scale, y * scale])

    limits = [(max(urdf.joint(name).lower, -math.pi), min(urdf.joint(name).upper, math.pi)) for name in joints]
    best, least = (0.0, 0.0), math.inf
    for start in ((now.get(joints[0], 0.0), now.get(joints[1], 0.0)), (0.0, 0.0), (2.0, 0.3), (-2.0, 0.3)):
        pan, tilt = start
        for _ in range(_ITERATIONS):
            here = error((pan, tilt))
            if float(np.linalg.norm(here)) < _TOLERANCE:
                break
            moved = (pan + _DERIVATIVE_STEP, tilt), (pan, tilt + _DERIVATIVE_STEP)
            jacobian = np.column_stack([(error(values) - here) / _DERIVATIVE_STEP for values in moved])
            step = np.linalg.lstsq(jacobian, -here, rcond=None)[0]
            step *= min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
            before = pan, tilt
            pan, tilt = (
                min(max(value + float(change), low), high)
                for value, change, (low, high) in zip(before, step, limits, strict=True)
            )
            if (pan, tilt) == before:
                break
        remaining = float(np.linalg.norm(error((pan, tilt))))
        if remaining < least - _TOLERANCE:
            best, least = (pan, tilt), remaining
        if remaining < _GOOD_ENOUGH:
            break
    return dict(zip(joints, best, strict=True)), least
