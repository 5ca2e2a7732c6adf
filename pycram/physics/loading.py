"""How a body is made of its model: decided here, written into the load record, and read from there when it is restored.

Recordings have to come out the same when they are executed again, also those of earlier releases. So whatever changes
the body that a model becomes is an option here, whose default in records is how 0.1.0 did it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from recorder.records import LoadBody, Loading as LoadingRecord

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pycram.physics.body import Joint
    from recorder.geometry import Vector
    from recorder.urdf import Urdf


MOTOR_GAIN: Final = 0.1
"""Share of a joint's error that its motor corrects in a step, for bodies that aren't robots: PyBullet's default."""
#: Least forces (N, N m) with which joints keep their position. With less than 1e4 the PR2's torso sinks.
_LEAST: Final = {"revolute": 500.0, "prismatic": 1e4}
_GRAVITY: Final = 9.81  # m/s^2, that motors of robots have to bear


@dataclass(frozen=True, slots=True)
class Loading:
    """How the engine makes a body of its model.

    Attributes:
        undamped: Damping and friction of the URDF's joints don't act. PyBullet applies them against the motors that
            hold the joints, explicitly in time: a damping that is large for the link's inertia makes it oscillate ever
            more (2e10 N m s/rad in a published PR2: 4 rad off after 0.5 s).
        clamped: Joints start at 0 or, where that isn't allowed, at the limit nearest to it: else they would jump there
            in the first steps.
        mimic: Joints that mimic another follow it whenever that is set. In simulation each is held where it should be
            by a motor of its own: PyBullet has no mimic joints.
        inertia: Links of robots have the moments of inertia that the URDF says. Else PyBullet takes those of the boxes
            around their collision shapes; a link without one has none, and motors move what hangs on it.
        armature: Least moment of inertia of a robot's links that move, kg m^2, as the rotors of geared motors add it.
            Without it the solver's 50 iterations don't bring the motors of wrists and fingers to agree.
        gain: Share of the error of a robot's joint that its motor corrects in a step. What the solver leaves of the
            load on chains of many joints grows to an error that the gain balances: with 0.1 some sagged by 5 mrad.
        strength: How many times the most that gravity may pull at them a robot's motors hold, if that is more than what
            all have, 500 N m or 10 kN: an industrial arm of 330 kg sank by 1.3 rad.
    """

    undamped: bool = True
    clamped: bool = True
    mimic: bool = True
    inertia: bool = True
    armature: float = 0.001
    gain: float = 1.0
    strength: float = 2.0

    @classmethod
    def of(cls, record: LoadBody) -> Loading:
        """Return how a recorded body was loaded."""
        then = record.loading
        gain = then.gain or _AS_0_1_0.gain
        return cls(then.undamped, then.clamped, then.mimic, then.inertia, then.armature, gain, then.strength)

    def to_record(self) -> LoadingRecord | None:
        """Return its record; None if it is that of 0.1.0, which had none."""
        return LoadingRecord(**asdict(self)) if self != _AS_0_1_0 else None

    def start(self, urdf: Urdf) -> dict[str, float]:
        """Return the values (rad or m) at which joints start, by name; only of those that don't start at 0."""
        values = {}
        if self.clamped:
            joints = (urdf.joints[name] for name in urdf.movable)
            values = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in joints}
        if self.mimic:
            values |= urdf.followers({name: values.get(name, 0.0) for name in urdf.movable})
        return {name: value for name, value in values.items() if value}


NOW: Final = Loading()
"""How this release loads models."""

_AS_0_1_0: Final = Loading(
    undamped=False, clamped=False, mimic=False, inertia=False, armature=0.0, gain=0.1, strength=0.0
)


class Load(NamedTuple):
    """A link that hangs on a joint.

    Attributes:
        parent: index of the joint before, -1 for none; joints come after those that they hang on.
        place: of the joint in the world, with all joints at 0, m.
        mass: of the link, kg.
        lever: from the joint to the link's centre of mass, m.
    """

    parent: int
    place: Vector
    mass: float
    lever: float


def least_forces(joints: Collection[Joint]) -> dict[str, float]:
    """Return the forces (N, N m) that the motors of all bodies' joints have, by joint."""
    return {joint.name: _LEAST[joint.kind] for joint in joints}


def holding_forces(joints: Collection[Joint], loads: Sequence[Load], strength: float) -> dict[str, float]:
    """Return the forces (N, N m) of motors that bear what hangs on a robot's joints, by joint; the least, or more.

    Args:
        joints: those that have motors.
        loads: of all joints, also fixed ones, by index.
        strength: how many times the most that gravity may pull in any posture they hold.
    """
    slides = [joint for joint in joints if joint.kind == "prismatic" and math.isfinite(joint.upper - joint.lower)]
    travels = {joint.index: max(abs(joint.lower), abs(joint.upper)) for joint in slides}
    weights = [_GRAVITY * load.mass for load in loads]  # of all that hangs on each joint
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
