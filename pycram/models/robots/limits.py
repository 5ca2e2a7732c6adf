"""How fast a robot may move, beyond what its URDF says: accelerations, and the velocities of its base."""

from __future__ import annotations

from dataclasses import dataclass, fields

from pycram.foundation import checks
from pycram.models.robots import tables

_MIN_RATE, _MAX_RATE = 1e-3, 1e3


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Largest velocities and accelerations.

    Attributes:
        turning_velocity: of joints that turn and have no velocity limit in the URDF, rad/s.
        turning_acceleration: of joints that turn, rad/s^2.
        sliding_velocity: of joints that slide and have no velocity limit in the URDF, m/s.
        sliding_acceleration: of joints that slide, m/s^2.
        base_velocity: of the base, m/s.
        base_acceleration: of the base, m/s^2.
        base_turning_velocity: of the base about its upright axis, rad/s.
        base_turning_acceleration: of the base about its upright axis, rad/s^2.
    """

    turning_velocity: float = 1.0
    turning_acceleration: float = 4.0
    sliding_velocity: float = 0.2
    sliding_acceleration: float = 0.5
    base_velocity: float = 0.5
    base_acceleration: float = 0.5
    base_turning_velocity: float = 1.0
    base_turning_acceleration: float = 1.0


def read_limits(table: tables.Table) -> MotionLimits:
    """Return the limits of a TOML table, checked; what it leaves out is as by default.

    Raises:
        BadArgument: An entry is unknown or impossible.
    """
    tables.only(table, *(field.name for field in fields(MotionLimits)))
    return MotionLimits(**{name: checks.in_range(name, value, _MIN_RATE, _MAX_RATE) for name, value in table.items()})
