"""Timing of paths: as fast as the limits of velocity and acceleration allow, with TOPP-RA in the package toppra.

Source: Pham, Pham: A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis, IEEE T-RO 2018.
A spline rounds the path at its way points. With more way points, the spline is nearer to the path, but slower at
corners.
"""

from __future__ import annotations

import logging
import math
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pycram.models.robots.description import MotionLimits
from pycram.planning.space import between
from pycram.world.object import Object
from recorder.packages import needed
from recorder.tracing.call_stack import call_site

if TYPE_CHECKING:
    Array = NDArray[np.float64]

SPACINGS: Final = (0.3, 0.1, 0.03)  # distances in rad or m of the spline's way points; short distances keep corners
_RATE: Final = 30.0  # number of a trajectory's knots per second; the trajectory is cubic between knots
_STILL: Final = 1e-4  # a path that is shorter, in rad or m, takes one step
_GRID: Final = 25  # number of points of toppra's grid between way points, if toppra's own grid fails
_FINE: Final = np.linspace(0.0, 1.0, 9)  # number of moments between two knots at which velocities are checked
_DEFAULTS: Final = MotionLimits()
_OCTAGON: Final = math.cos(math.pi / 8)  # distance of an octagon's sides from the centre, as a share of its radius


@dataclass(frozen=True, slots=True)
class Rates:
    """Limits of velocity and acceleration: of coordinates, or of weighted sums of coordinates."""

    lower: Array  # (d,) lower limits of the coordinates
    upper: Array  # (d,) upper limits of the coordinates
    directions: Array  # (k, d) weights of the limited sums
    velocities: Array  # (k,) limits of the sums' velocities, rad/s or m/s
    accelerations: Array  # (k,) limits of the sums' accelerations, rad/s^2 or m/s^2


@dataclass(frozen=True, slots=True)
class Knots:
    """Times in s from 0 on, with positions and velocities (n, d); the motion is cubic between knots."""

    times: Array
    positions: Array
    velocities: Array


def timed(path: Array, rates: Rates, spacing: float) -> Knots:
    """Return a path (n, d) with times; the motion starts and ends at rest.

    ``spacing`` is the distance in rad or m between way points of the spline that rounds the path's corners.
    """
    kept = [path[0]]
    for row in path[1:]:
        if np.abs(row - kept[-1]).max() > _STILL:
            kept.append(row)
    if len(kept) == 1:
        if np.array_equal(path[0], path[-1]):
            return Knots(np.zeros(1), path[:1], np.zeros_like(path[:1]))
        return slowed(Knots(np.array([0.0, 1 / _RATE]), path[[0, -1]], np.zeros((2, path.shape[1]))), rates)
    kept[-1] = path[-1]
    return slowed(_fastest(np.array(kept), rates, spacing), rates)


def stopping(path: Array, rates: Rates) -> Knots:
    """Return a path with times. The motion stops at each way point, so corners aren't rounded."""
    parts = [timed(np.array(ends), rates, math.inf) for ends in pairwise(path)]
    ends = np.cumsum([0.0, *(part.times[-1] for part in parts)])
    return Knots(
        np.concatenate([[0.0], *(part.times[1:] + begin for part, begin in zip(parts, ends, strict=False))]),
        np.concatenate([path[:1], *(part.positions[1:] for part in parts)]),
        np.concatenate([np.zeros_like(path[:1]), *(part.velocities[1:] for part in parts)]),
    )


@cache
def _toppra() -> Any:
    plots = {name: ModuleType(name) for name in ("matplotlib", "matplotlib.pyplot") if name not in sys.modules}
    with needed(), warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # Python 3.12 warns about docstrings of toppra
        sys.modules.update(plots)  # toppra uses matplotlib only in functions that draw; its import takes half a second
        try:
            import toppra  # noqa: PLC0415  importing toppra takes half a second, mostly for SciPy
        finally:
            for name in plots:
                del sys.modules[name]
    logging.getLogger("toppra").setLevel(logging.ERROR)
    return toppra


def _fastest(path: Array, rates: Rates, spacing: float) -> Knots:
    dense = np.concatenate([path[:1], *(between(a, b, spacing) for a, b in pairwise(path))])
    toppra = _toppra()
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    spline = toppra.SplineInterpolator(at, dense @ rates.directions.T, "natural")  # splines of the limited sums
    constraints = [
        toppra.constraint.JointVelocityConstraint(rates.velocities),
        toppra.constraint.JointAccelerationConstraint(rates.accelerations),
    ]
    for grid in (None, np.linspace(0.0, at[-1], _GRID * len(at))):
        found = toppra.algorithm.TOPPRA(
            constraints, spline, gridpoints=grid, parametrizer="ParametrizeConstAccel"
        ).compute_trajectory(0.0, 0.0)
        if found is not None:
            break
    else:
        return stopping(path, rates)
    times = np.linspace(0.0, found.duration, max(2, math.ceil(found.duration * _RATE) + 1))
    back = np.linalg.pinv(rates.directions).T
    positions, velocities = (values @ back for values in (found(times), found(times, 1)))
    positions[[0, -1]], velocities[[0, -1]] = path[[0, -1]], 0.0
    return Knots(times, positions, velocities)


def slowed(knots: Knots, rates: Rates) -> Knots:
    """Return knots that keep the limits, even between knots: slower knots if toppra or the cubic exceeds a limit."""
    inside = np.clip(knots.positions, rates.lower, rates.upper)  # at a turning point, the spline may exceed a limit
    knots = Knots(knots.times, inside, np.where(inside == knots.positions, knots.velocities, 0.0))
    spans = np.diff(knots.times)[:, None]
    rows, speeds = (values @ rates.directions.T for values in (knots.positions, knots.velocities))
    a, b, v, w = rows[:-1], rows[1:], speeds[:-1], speeds[1:]
    mean = (b - a) / spans
    s = _FINE[:, None, None]
    velocities = 6 * s * (1 - s) * mean + (1 - s) * (1 - 3 * s) * v + s * (3 * s - 2) * w
    accelerations = np.stack([6 * mean - 4 * v - 2 * w, 2 * v + 4 * w - 6 * mean]) / spans
    fast = float((np.abs(velocities) / rates.velocities).max())
    slower = max(1.0, fast, math.sqrt(float((np.abs(accelerations) / rates.accelerations).max())))
    return Knots(knots.times * slower, knots.positions, knots.velocities / slower)


def at(knots: Knots, times: Array) -> Array:
    """Return positions (n, d) at times (n,) from the first to the last knot."""
    after = np.clip(np.searchsorted(knots.times, times, side="right"), 1, max(1, len(knots.times) - 1))
    if len(knots.times) == 1:
        return np.repeat(knots.positions, len(times), axis=0)
    spans = (knots.times[after] - knots.times[after - 1])[:, None]
    s = (times[:, None] - knots.times[after - 1][:, None]) / spans
    a, b = knots.positions[after - 1], knots.positions[after]
    v, w = knots.velocities[after - 1] * spans, knots.velocities[after] * spans
    return a + s * (v + s * (3 * (b - a) - 2 * v - w + s * (2 * (a - b) + v + w)))


class NoVelocityLimit(UserWarning):
    """A warning: a URDF has no velocity limits for some joints; the robot's description or a default limits them."""


def joint_rates(body: Object, joints: Sequence[str]) -> Rates:
    """Return the limits of joints; warn once about joints of a robot without velocity limits."""
    limits = body.description.limits if body.description else _DEFAULTS
    velocities, accelerations, unlimited = [], [], []
    for name in joints:
        joint = body.urdf.joint(name)
        slides = joint.type == "prismatic"
        velocity = joint.velocity
        if not 0 < velocity < math.inf:
            velocity = limits.sliding_velocity if slides else limits.turning_velocity
            unlimited.append(name)
        velocities.append(velocity)
        accelerations.append(limits.sliding_acceleration if slides else limits.turning_acceleration)
    if unlimited and body.is_robot:
        _warn(body.name, body.urdf.name, tuple(unlimited), limits)
    lower, upper = np.array([body.joint_limits(name) for name in joints]).reshape(-1, 2).T
    return Rates(lower, upper, np.eye(len(joints)), np.array(velocities), np.array(accelerations))


@cache
def _warn(name: str, robot: str, joints: tuple[str, ...], limits: MotionLimits) -> None:
    text = (
        f"{name}: the URDF {robot!r} has no velocity limit for {', '.join(joints)}; the joints move at up to "
        f"{limits.turning_velocity:g} rad/s or {limits.sliding_velocity:g} m/s. Set <limit velocity=...> in the URDF, "
        "or turning_velocity and sliding_velocity under [limits] in the robot's description."
    )
    warnings.warn_explicit(text, NoVelocityLimit, *call_site())


def base_rates(robot: Object) -> Rates:
    """Return the limits of a base's x, y and yaw. Speed is limited in eight directions, which approximates a circle."""
    limits = robot.description.limits if robot.description else _DEFAULTS
    half = math.sqrt(0.5)
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [half, half, 0.0], [half, -half, 0.0], [0.0, 0.0, 1.0]])
    velocities = np.array([_OCTAGON * limits.base_velocity] * 4 + [limits.base_turning_velocity])
    accelerations = np.array([_OCTAGON * limits.base_acceleration] * 4 + [limits.base_turning_acceleration])
    endless = np.full(3, math.inf)
    return Rates(-endless, endless, directions, velocities, accelerations)


def stacked(parts: Sequence[Rates]) -> Rates:
    """Return the limits of several bodies together, with the columns of the bodies in order."""
    rows, columns = (sum(part.directions.shape[axis] for part in parts) for axis in (0, 1))
    directions = np.zeros((rows, columns))
    row = column = 0
    for part in parts:
        height, width = part.directions.shape
        directions[row : row + height, column : column + width] = part.directions
        row, column = row + height, column + width
    return Rates(
        np.concatenate([part.lower for part in parts]),
        np.concatenate([part.upper for part in parts]),
        directions,
        np.concatenate([part.velocities for part in parts]),
        np.concatenate([part.accelerations for part in parts]),
    )
