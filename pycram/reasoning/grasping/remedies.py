"""What would do where an arm can't open or close something: another arm, another place of the robot, less of it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.choosing import UNRECORDED
from pycram.reasoning.collision import checker
from pycram.reasoning.grasping.handle_path import HandlePath, plan, plan_with_torso
from pycram.reasoning.grasping.handles import ANGLES
from pycram.reasoning.kinematics.solver import Solver
from pycram.reasoning.rejections import Touching
from pycram.world import carried
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.foundation.collision_pair import CollisionPair
    from pycram.models.robots.description import Arm
    from pycram.reasoning.choosing import Choice
    from pycram.reasoning.grasping.handles import Handle
    from pycram.world.object import Object
    from recorder.geometry import Pose, Vector

_STEP: Final = 0.15  # m between places that are tried
_STEPS: Final = 5  # to each side
_MAX_PLACES: Final = 4  # for which a path is looked for


@dataclass(frozen=True, slots=True)
class Remedy:
    """An arm that could do it.

    Attributes:
        arm: its name.
        parked: name of another arm that would have to be parked first; "" for none.
        base: where the robot would have to stand, m, with its present heading; None where it does.
        distance: m from where it stands.
    """

    arm: str
    base: Vector | None = None
    distance: float = 0.0
    parked: str = ""

    def __str__(self) -> str:
        place = "here" if self.base is None else f"[{', '.join(f'{part:.2f}' for part in self.base[:2])}]"
        return f"{self.arm} arm from {place}"

    def phrase(self) -> str:
        """Return it in words."""
        if self.parked:
            return f"the {self.arm} arm could from here with the {self.parked} arm parked"
        if self.base is None:
            return f"the {self.arm} arm could from here"
        place = ", ".join(f"{part:.2f}" for part in self.base)
        return f"the {self.arm} arm could with the robot at [{place}], {self.distance:.2f} m from here"


@dataclass(frozen=True, slots=True)
class InTheWay:
    """An arm that is in the way even where it is parked.

    Attributes:
        arm: its name.
    """

    arm: str

    def phrase(self) -> str:
        """Return it in words."""
        return f"the {self.arm} arm is in the way, also when it is parked"


def arms_in_the_way(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], pairs: Sequence[CollisionPair]
) -> list[Remedy | InTheWay]:
    """Return for the other arms that are in an arm's way whether parking them would do.

    Args:
        robot: the robot; its world's lock is held.
        arm: the arm that can't.
        handle: of what should be moved.
        values: of its joint, rad or m, from the present one on.
        pairs: what would touch what.
    """
    found: list[Remedy | InTheWay] = []
    for other in robot.description.arms.values() if robot.description else ():
        if other is not arm and any(_meets(robot, other, pair) for pair in pairs):
            path = plan(robot, arm, handle, values, others=other.posture("park"))
            found.append(Remedy(arm.name, parked=other.name) if isinstance(path, HandlePath) else InTheWay(other.name))
    return found


def _meets(robot: Object, arm: Arm, pair: CollisionPair) -> bool:
    """Whether a link of an arm, or what it holds, is one of a pair."""
    links = carried.moved_links(robot.urdf, arm.joints)
    own = {pair.link} if pair.mover == robot.name else set()
    own |= {pair.body_link} if pair.body == robot.name else set()
    holds = any(held.body.name == pair.body and held.carrier_link in links for held in robot.carried)
    return holds or pair.gripper == arm.name or not own.isdisjoint(links)


def remedies(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], choice: Choice = UNRECORDED
) -> list[Remedy]:
    """Return what would do instead of an arm that can't, nearest first; an empty list says that nothing nearby would.

    Args:
        robot: the robot; its world's lock is held.
        arm: the arm that can't.
        handle: of what should be moved.
        values: of its joint, rad or m, from the present one on.
        choice: gets what was tried.
    """
    description = robot.description
    free = [
        other
        for other in (description.arms.values() if description else ())
        if all(held.carrier_link != other.tool_frame for held in robot.carried)
    ]
    found: list[Remedy] = []
    for other in free:
        if other is not arm:
            remedy, path = Remedy(other.name), plan(robot, other, handle, values)
            if isinstance(path, HandlePath) or plan_with_torso(robot, other, handle, values) is not None:
                found.append(remedy)
            else:
                choice.reject(str(remedy), path.rejection())
    drives = description is not None and description.drives
    places = (
        _from_elsewhere(robot, other, handle, values, choice)
        for other in sorted(free if drives else (), key=lambda other: other is not arm)
    )
    elsewhere = next((place for place in places if place is not None), None)
    found += [elsewhere] if elsewhere is not None else []
    if found:
        choice.take(str(found[0]))
    return found


def _from_elsewhere(robot: Object, arm: Arm, handle: Handle, values: Sequence[float], choice: Choice) -> Remedy | None:
    """Return the nearest place, of those on a grid, from which an arm could do it."""
    position, heading = robot.get_position_and_orientation()
    now: Pose = (position[0], position[1], position[2]), (heading[0], heading[1], heading[2], heading[3])
    tried = 0
    for base in _promising(robot, arm, handle, values, list(_places(now))):
        remedy = Remedy(arm.name, base[0], math.dist(base[0], position))
        touched = checker.touched(robot, {}, base, all_links=True)
        if touched:
            choice.reject(str(remedy), Touching([collision["pair"] for collision in touched.values()]))
            continue
        path = plan(robot, arm, handle, values, base, quick=True)
        if isinstance(path, HandlePath):
            return remedy
        choice.reject(str(remedy), path.rejection())
        tried += 1
        if tried == _MAX_PLACES:
            break
    return None


def _places(now: Pose) -> Iterator[Pose]:
    """Yield places around the robot, nearest first, with its heading."""
    steps = [_STEP * step for step in range(-_STEPS, _STEPS + 1)]
    for x, y in sorted(itertools.product(steps, steps), key=lambda at: math.hypot(*at)):
        if (x, y) != (0.0, 0.0):
            yield geometry.transform(now, (x, y, 0.0)), now[1]


def _promising(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], bases: Sequence[Pose]
) -> Iterator[Pose]:
    """Yield places from which the arm gets to the handle at the first, the middle and the last value, in some way."""
    solver = Solver(robot, arm.tool_frame)
    grip = handle.grips(robot, arm.gripper)[0]
    picked = sorted({0, len(values) // 2, len(values) - 1})
    tools = [geometry.multiply(handle.pose(values[number]), grip.tool(angle)) for number in picked for angle in ANGLES]
    for base in bases:
        found = solver.closed_form([(*tool, base) for tool in tools])
        reached = np.array([bool(each) for each in found]).reshape(len(picked), len(ANGLES))
        if reached.any(axis=1).all():
            yield base
