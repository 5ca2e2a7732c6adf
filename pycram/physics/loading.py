"""Loading of models into the engine: options, which are recorded, and the forces of joint motors.

Recordings of earlier releases have to give the same result when they are executed again. So everything that changes the
loaded body is an option here; if a record lacks the option, its value is that of 0.1.0.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from recorder.records import LoadBody, Loading as LoadingRecord

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pycram.physics.body import MovableJoint
    from recorder.geometry import Vector
    from recorder.urdf import Urdf


MOTOR_GAIN: Final = 0.1
"""Share of a joint's error that its motor corrects in a step, for bodies that aren't robots: PyBullet's default."""
#: Least forces (N, N m) with which joints keep their position. With less than 1e4 the PR2's torso sinks.
_LEAST: Final = {"revolute": 500.0, "prismatic": 1e4}
_GRAVITY: Final = 9.81  # m/s^2, the gravity that motors of robots have to bear


@dataclass(frozen=True, slots=True)
class Loading:
    """Options by which the engine makes a body of a model."""

    undamped: bool = True
    """Damping and friction of the URDF's joints are ignored. PyBullet applies them against the motors, explicitly in
    time, so a damping that is large for the link's inertia causes growing oscillations (2e10 N m s/rad in a published
    PR2: 4 rad off after 0.5 s)."""
    clamped: bool = True
    """Joints start at 0, or at the nearest limit if 0 isn't allowed; otherwise they would jump in the first steps."""
    mimic: bool = True
    """Joints that mimic another one follow it whenever that is set. In simulation a motor holds each of them, as
    PyBullet has no mimic joints."""
    inertia: bool = True
    """Links of robots have the URDF's moments of inertia. Otherwise PyBullet computes them from the boxes around the
    collision shapes, which gives no inertia to a link without shape."""
    armature: float = 0.001
    """Least moment of inertia of a robot's moving links, kg m^2, like that of the rotors of geared motors. Without it
    the solver's 50 iterations don't converge for the motors of wrists and fingers."""
    gain: float = 1.0
    """Share of the error of a robot's joint that its motor corrects in a step. The solver's remaining error grows on
    long chains of joints: with 0.1, some sagged by 5 mrad."""
    strength: float = 2.0
    """Largest force of a robot's motors, as a multiple of the largest load by gravity, if that is more than the 500 N m
    or 10 kN of all motors: an industrial arm of 330 kg sank by 1.3 rad."""

    @classmethod
    def of(cls, record: LoadBody) -> Loading:
        """Return the options with which a recorded body was loaded."""
        then = record.loading
        gain = then.gain or _AS_0_1_0.gain
        return cls(then.undamped, then.clamped, then.mimic, then.inertia, then.armature, gain, then.strength)

    def to_record(self) -> LoadingRecord | None:
        """Return the options' record; None for the options of 0.1.0, which had no such record."""
        return LoadingRecord(**asdict(self)) if self != _AS_0_1_0 else None

    def start(self, urdf: Urdf) -> dict[str, float]:
        """Return the start positions (rad or m) of the joints that don't start at 0, by name."""
        values = {}
        if self.clamped:
            joints = (urdf.joints[name] for name in urdf.movable)
            values = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in joints}
        if self.mimic:
            values |= urdf.followers({name: values.get(name, 0.0) for name in urdf.movable})
        return {name: value for name, value in values.items() if value}


NOW: Final = Loading()
"""The options of this release."""

_AS_0_1_0: Final = Loading(
    undamped=False, clamped=False, mimic=False, inertia=False, armature=0.0, gain=0.1, strength=0.0
)


class Load(NamedTuple):
    """A link that hangs on a joint."""

    parent: int  # index of the parent joint, -1 for none; parents come first
    place: Vector  # position of the joint in the world, with all joints at 0, m
    mass: float  # mass of the link, kg
    lever: float  # distance of the link's centre of mass from the joint, m


def least_forces(joints: Collection[MovableJoint]) -> dict[str, float]:
    """Return the least motor forces (N, N m) of any body, by joint."""
    return {joint.name: _LEAST[joint.kind] for joint in joints}


def holding_forces(joints: Collection[MovableJoint], loads: Sequence[Load], strength: float) -> dict[str, float]:
    """Return the motor forces (N, N m) that hold a robot's links in any posture, by joint.

    Args:
        joints: The joints with motors.
        loads: Loads of all joints by index, including fixed joints.
        strength: Multiple of the largest load by gravity that the motors hold.
    """
    slides = [joint for joint in joints if joint.kind == "prismatic" and math.isfinite(joint.upper - joint.lower)]
    travels = {joint.index: max(abs(joint.lower), abs(joint.upper)) for joint in slides}
    weights = [_GRAVITY * load.mass for load in loads]  # weights of all links that hang on each joint
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
