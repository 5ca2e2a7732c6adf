"""Options of loading a model into the engine, and the forces of joint motors.

A recording must give the same result in later releases, so recordings contain the options. If a record lacks an option,
the option has the value of release 0.1.0.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Final, NamedTuple

from pycram.physics.body import MovableJoint
from recorder.geometry import Vector
from recorder.records import LoadBody, Loading as LoadingRecord
from recorder.urdf import Urdf

MOTOR_GAIN: Final = 0.1  # share of a joint's error that a motor corrects in a step, as PyBullet does for other bodies
#: Minimum forces (N m, N) with which motors hold joints. With less than 1e4 N, the torso of the PR2 sinks.
_LEAST: Final = {"revolute": 500.0, "prismatic": 1e4}
_GRAVITY: Final = 9.81  # gravity in m/s^2 from which the motor forces of robots are computed


@dataclass(frozen=True, slots=True)
class Loading:
    """Options of loading a model; they affect the loaded body."""

    undamped: bool = True
    """Whether damping and friction of the URDF's joints are ignored. PyBullet integrates damping explicitly, so damping
    that is large for a link's inertia causes growing oscillations. A published URDF of the PR2 has a damping of 2e10 N
    m s/rad.
    """
    clamped: bool = True  # whether joints start within their limits. Joints outside of limits would jump at first.
    mimic: bool = True
    """Whether joints that mimic another joint are set with it. In simulation, motors hold them, because PyBullet has no
    mimic joints."""
    inertia: bool = True
    """Whether links of robots have the URDF's moments of inertia. Otherwise PyBullet computes them from collision
    shapes, and a link without a shape has no inertia."""
    armature: float = 0.001
    """Minimum moment of inertia of a robot's moving links in kg m^2, similar to rotors of geared motors. Without it,
    the solver's 50 iterations don't converge for wrists and fingers.
    """
    gain: float = 1.0
    """Share of the error of a robot's joint that its motor corrects in a step. With 0.1, long chains of joints sagged
    by up to 5 mrad."""
    strength: float = 2.0
    """Largest force of a robot's motors as a multiple of the largest load by gravity, but at least the minimum force.
    Without these forces, an industrial arm of 330 kg sank by 1.3 rad.
    """

    @classmethod
    def of(cls, record: LoadBody) -> Loading:
        """Return the options of a recorded body."""
        then = record.loading
        gain = then.gain or _AS_0_1_0.gain
        return cls(then.undamped, then.clamped, then.mimic, then.inertia, then.armature, gain, then.strength)

    def to_record(self) -> LoadingRecord | None:
        """Return the options as a record; None for the options of 0.1.0, whose recordings lack this record."""
        return LoadingRecord(**asdict(self)) if self != _AS_0_1_0 else None

    def start(self, urdf: Urdf) -> dict[str, float]:
        """Return the start positions (rad or m), by joint name, of the joints that don't start at 0."""
        values = {}
        if self.clamped:
            joints = (urdf.joints[name] for name in urdf.movable)
            values = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in joints}
        if self.mimic:
            values |= urdf.followers({name: values.get(name, 0.0) for name in urdf.movable})
        return {name: value for name, value in values.items() if value}


NOW: Final = Loading()  # the options of this release

_AS_0_1_0: Final = Loading(
    undamped=False, clamped=False, mimic=False, inertia=False, armature=0.0, gain=0.1, strength=0.0
)


class Load(NamedTuple):
    """A link that hangs on a joint."""

    parent: int  # index of the parent joint, -1 for none; a parent has a smaller index
    place: Vector  # position of the joint in the world if all joints are at 0, m
    mass: float  # mass of the link, kg
    lever: float  # distance of the link's centre of mass from the joint, m


def least_forces(joints: Collection[MovableJoint]) -> dict[str, float]:
    """Return the minimum motor forces (N m or N) by joint."""
    return {joint.name: _LEAST[joint.kind] for joint in joints}


def holding_forces(joints: Collection[MovableJoint], loads: Sequence[Load], strength: float) -> dict[str, float]:
    """Return the motor forces (N m or N) by joint that hold a robot's links in any posture.

    ``loads`` has each joint's load by index; ``strength`` is the factor for the largest load by gravity.
    """
    slides = [joint for joint in joints if joint.kind == "prismatic" and math.isfinite(joint.upper - joint.lower)]
    travels = {joint.index: max(abs(joint.lower), abs(joint.upper)) for joint in slides}
    weights = [_GRAVITY * load.mass for load in loads]  # weights of all links below each joint
    torques = [_GRAVITY * load.mass * load.lever for load in loads]
    for index in reversed(range(len(loads))):
        load = loads[index]
        if load.parent >= 0:
            lever = math.dist(load.place, loads[load.parent].place) + travels.get(index, 0.0)
            weights[load.parent] += weights[index]
            torques[load.parent] += torques[index] + weights[index] * lever
    pulls = {"prismatic": weights, "revolute": torques}
    least = least_forces(joints)
    return {joint.name: max(least[joint.name], strength * pulls[joint.kind][joint.index]) for joint in joints}
