"""Advice on an object that no arm could take: turn the object, or slide it to an edge.

A copy of the process tries each suggested motion of the object. Only reasoning runs in the copy, no code of the plan,
and nothing is recorded.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

from pycram.actions.action import TYPES
from pycram.actions.objects import candidates_of, thing
from pycram.foundation.failures import (
    Blocked,
    DoesNotFit,
    GraspFailed,
    NoPlace,
    PlanFailure,
    ReasoningError,
    Unreachable,
)
from pycram.models.robots.description import Arm
from pycram.projection.child import first_true
from pycram.reasoning.choosing import UNRECORDED
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.choice import holding_grasps
from pycram.reasoning.grasping.grasps import leaning
from pycram.reasoning.grasping.placing import resting_position
from pycram.reasoning.places import standing_places
from pycram.reasoning.places.search import drives
from pycram.scheduling.future import unwrap
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Pose
from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    from pycram.actions.action import ActionDesignator

_TURNS: Final = (30, 60, 90, 120, 150)  # tried turns about the vertical, in degrees
_FAR: Final = (90, 30)  # fewer turns in degrees if the robot may drive, because each needs a search for a place
_ON: Final = 0.02  # maximum distance in m between an object's underside and the surface below it
_INSIDE: Final = 0.02  # distance in m between the middle of a slid object and the edge
_EDGES: Final = 4  # number of nearest edges that are tried; half as many if the robot may drive
_SETTLES: Final = STEPS_PER_SECOND // 4  # simulated steps until a moved object is at rest
_MOVED: Final = 0.02  # maximum motion in m of a moved object until it is at rest
_LEANT: Final = math.radians(10)  # maximum turn of a moved object until it is at rest
_SAME: Final = 1e-3  # maximum distance in m between an object and a target that counts as the object's place


def advice(failure: PlanFailure, action: ActionDesignator) -> str:
    """Return texts of motions of an action's object after which the robot can take it; "" if none helps."""
    slots, failures = dict(action.description), list(_failures(failure))
    robot, given = BulletWorld.current_robot(), candidates_of(thing("object", unwrap(slots["object"])))
    untaken = [body for body in given if failures and all(_untaken(each, body) for each in failures)]
    if robot.description is None or len(untaken) != 1 or untaken[0].fixed or untaken[0].attachments:
        return ""
    body = untaken[0]
    wanted, grasp = (unwrap(slots.get(name)) for name in ("arm", "grasp"))
    arms = [arm for arm in robot.description.arms.values() if wanted in (None, arm.name) and arm.hand is not None]
    free = [arm for arm in arms if attachment.attached_to(robot, arm.tool_frame) is None]
    kind = TYPES.get(action.type)
    chooses = kind is not None and any(slot.name == "place" for slot in kind.slots) and slots.get("place") is None
    moves_base = chooses and drives(robot)
    too_far = all(isinstance(each, Unreachable) and not isinstance(each, Blocked) for each in failures)
    too_big = any(isinstance(each, DoesNotFit) for each in failures)
    turns = [] if too_far or (too_big and grasp is None) else list(_turned(body, _FAR if moves_base else _TURNS))
    slides = [] if too_big else list(_slid(body))[: _EDGES // 2 if moves_base else None]
    found: list[str] = []
    for moves in (turns, slides) if free else ():
        helps = first_true([partial(_helps, robot, body, pose, free, grasp, moves_base) for _, pose in moves])
        found += [moves[helps][0].replace("{}", "it" if found else body.name, 1)] if helps is not None else []
    return f"{' or '.join(found)}, then the robot can take it" if found else ""


def _failures(failure: BaseException) -> Iterator[BaseException]:
    """Yield the failures of all tried choices of an action and its subactions, or else the action's failure."""
    tried = getattr(failure, "tried", ())
    for each in tried:
        if not isinstance(each.failure, ReasoningError):  # skip failures to clear obstacles away
            yield from _failures(each.failure)
    if not tried:
        yield failure


def _untaken(failure: BaseException, body: Object) -> bool:
    """Return whether a failure means that an arm couldn't take an object in its present pose."""
    if isinstance(failure, NoPlace):
        return failure.last == f"reach {body.name}"
    if isinstance(failure, GraspFailed):
        return failure.body == body.name
    return isinstance(failure, Unreachable) and math.dist(failure.target, center(body)) < _SAME


def _turned(body: Object, turns: Sequence[int]) -> Iterator[tuple[str, Pose]]:
    """``{}`` in it represents the object's name."""
    x, y, z = center(body)
    from_middle = geometry.multiply(((-x, -y, -z), geometry.IDENTITY[1]), body.get_position_and_orientation())
    for degrees in turns:
        turn = geometry.product(geometry.from_rpy(0.0, 0.0, math.radians(degrees)), geometry.conjugate(leaning(body)))
        yield f"turn {{}} by {degrees} degrees", geometry.multiply(((x, y, z), turn), from_middle)


def _slid(body: Object) -> Iterator[tuple[str, Pose]]:
    """Yield advice, and poses of an object after sliding straight to the nearest edges of its surface."""
    here = body.get_position_and_orientation()
    middle, bottom = body.world.engine.center_of_mass(body.handle)[0], body.get_AABB()[0][2]
    moves = []
    for furniture in body.world.objects:
        for surface in furniture.surfaces.values():
            pose = furniture.surface_pose(surface)
            x, y, _ = geometry.transform(geometry.invert(pose), middle)
            if abs(bottom - pose[0][2]) > _ON or geometry.margin_in_polygon(surface.outline, (x, y)) < 0.0:
                continue
            for a, b in itertools.pairwise([*surface.outline, surface.outline[0]]):
                u, v = (b[1] - a[1]) / math.dist(a, b), (a[0] - b[0]) / math.dist(a, b)  # unit vector, outward
                way = (a[0] - x) * u + (a[1] - y) * v - _INSIDE
                moves.append((way, geometry.rotate(pose[1], (way * u, way * v, 0.0)), surface.name))
    for way, move, name in sorted(moves)[:_EDGES]:
        if way > 0.0:
            there = geometry.multiply((move, geometry.IDENTITY[1]), here)
            x, y = (round(each, 2) + 0.0 for each in there[0][:2])  # no -0.00
            yield f"slide {{}} by {way * 100:.0f} cm to [{x:.2f}, {y:.2f}], at an edge of {name}", there


def _helps(robot: Object, body: Object, pose: Pose, arms: Sequence[Arm], grasp: str | None, moves_base: bool) -> bool:
    """Move an object, in a copy of the process; return whether the object comes to rest and the robot can take it."""
    engine = body.world.engine  # the engine moves it without a transaction, which would call handlers of the plan
    with body.world.lock:
        there = resting_position(body, *pose), pose[1]
        engine.set_pose(body.handle, there)
        engine.step(_SETTLES)
        position, turn = body.get_position_and_orientation()
        if math.dist(position, there[0]) > _MOVED or geometry.angle(turn, there[1]) > _LEANT:
            return False
    if moves_base:
        names = [arm.name for arm in arms]
        return next(standing_places(robot, reach=[body], arms=names, grasp=grasp, quickly=True), None) is not None
    sides = None if grasp is None else (grasp,)
    with body.world.lock:
        found = (holding_grasps(robot, arm, body, sides, [], UNRECORDED) for arm in arms)
        return any(next(each, None) is not None for each in found)
