"""Where a pan-tilt head has to turn so that the camera looks at a point: Newton's method on its two joints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.geometry.urdf import Urdf

_ITERATIONS: Final = 30
_STEP: Final = 1e-5  # rad, of the numeric derivative
_DONE: Final = 1e-6  # rad
_LONGEST_STEP: Final = 0.5  # rad


def look(
    urdf: Urdf, joints: tuple[str, str], camera: str, point: Sequence[float], now: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Turns the camera's axis (z of its frame) to a point.

    Args:
        urdf: of the robot.
        joints: names of the pan and the tilt joint.
        camera: the camera's optical frame.
        point: in the robot's root link, m.
        now: present values of all joints, rad or m.

    Returns:
        Values of the two joints within their limits, and the angle in rad that remains to the point.
    """
    limits = [(max(urdf.joint(name).lower, -math.pi), min(urdf.joint(name).upper, math.pi)) for name in joints]
    best: tuple[float, tuple[float, float]] | None = None
    for start in ((now.get(joints[0], 0.0), now.get(joints[1], 0.0)), (0.0, 0.0), (2.0, 0.3), (-2.0, 0.3)):
        values = start
        for _ in range(_ITERATIONS):
            error = _error(urdf, joints, camera, point, now, values)
            if float(np.linalg.norm(error)) < _DONE:
                break
            columns = []
            for index in range(2):
                moved = list(values)
                moved[index] += _STEP
                columns.append((_error(urdf, joints, camera, point, now, (moved[0], moved[1])) - error) / _STEP)
            step = np.linalg.lstsq(np.column_stack(columns), -error, rcond=None)[0]
            step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-12))
            pan, tilt = (
                min(max(value + float(change), low), high)
                for value, change, (low, high) in zip(values, step, limits, strict=True)
            )
            if (pan, tilt) == values:
                break
            values = (pan, tilt)
        remaining = float(np.linalg.norm(_error(urdf, joints, camera, point, now, values)))
        if best is None or remaining < best[0] - _DONE:
            best = (remaining, values)
        if remaining < 1e-4:  # rad: as good as it gets, and the nearest to where the head is
            break
    if best is None:
        raise AssertionError("there is always a start")
    return dict(zip(joints, best[1], strict=True)), best[0]


def _error(
    urdf: Urdf,
    joints: tuple[str, str],
    camera: str,
    point: Sequence[float],
    now: Mapping[str, float],
    values: tuple[float, float],
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Rotation vector's two parts, in the camera's frame, from its axis to the point; its length is the angle."""
    pose = urdf.forward_kinematics({**now, **dict(zip(joints, values, strict=True))}, camera)
    x, y, z = geometry.transform(geometry.invert(pose), point)
    unrecorded = math.hypot(x, y)
    angle = math.atan2(unrecorded, z)
    scale = angle / unrecorded if unrecorded > 1e-12 else 1.0
    return np.array([x * scale, y * scale])
