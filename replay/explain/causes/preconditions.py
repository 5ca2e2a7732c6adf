"""What a failed motion lacked, by the world's state and its failure's data; and which motions bring that about."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from recorder import geometry
from recorder.geometry.shapes import read_shapes
from recorder.records import from_json
from replay.errors import Damaged, NoSuchName
from replay.explain.causes.case import objects_in
from replay.explain.causes.robot_description import hands, joints_of
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from recorder.records import Mutation, Plain
    from recorder.tasks import Node
    from replay.explain.causes.case import Case
    from replay.state.state import Attachment

_TAKING: Final = ("pick-up", "accessing")
_OUT_OF_REACH: Final = ("Unreachable", "HandleUnreachable", "LookingFailed")
_SHUT_IN: Final = ("Unreachable", "Blocked", "GraspFailed", "PerceptionError")
_NEARER: Final = 0.05  # m
_IN: Final = 0.03  # m by which an object's base may be beyond the box of a drawer's parts


@dataclass(frozen=True, slots=True)
class Lacking:
    """What a motion lacked.

    Attributes:
        precondition: as in :class:`replay.explain.causes.cause.Swallowed`.
        subject: name of the object or joint; "" for none.
        arm: name of the arm; "" for none.
        motions: names of the motions that bring it about.
        fits: whether such a motion is about the same object, joint and arm.
        owner: whose joints they are, or the robot that should have been elsewhere; "" else.
        joints: that should have been moved.
    """

    precondition: str
    subject: str
    arm: str
    motions: tuple[str, ...]
    fits: Callable[[Node], bool]
    owner: str = ""
    joints: tuple[str, ...] = ()

    def done_by(self, record: Mutation) -> bool:
        """Return whether a change did it, or something else, to the same: what was before then explains nothing."""
        if self.precondition in ("held", "hand-free"):
            return record.HasField("attach_body") and self.subject in [each.body for each in record.effect.attached]
        if self.joints:
            moved = record.move_joints
            return moved.body == self.owner and not set(moved.joints).isdisjoint(self.joints)
        return record.move_body.body == (self.owner or self.subject) != ""


def lacking(case: Case) -> Iterator[Lacking]:
    """Yield what a failed motion lacked."""
    if case.motion is None or case.world is None or case.robot is None:
        return
    by_hands = list(_hands(case, case.motion.name))
    if by_hands:  # is checked before anything else
        yield from by_hands
        return
    yield from _clear(case)
    yield from _taken_out(case)
    if case.failure.type in _OUT_OF_REACH:
        yield from _at_pose(case)
    elif case.failure.type == "PerceptionError":
        yield Lacking("camera-directed", "", "", ("looking",), lambda _: True)
        yield from _at_pose(case)


def about(task: Node, *, body: str = "", arm: str = "") -> bool:
    """Return whether a motion is about an object, with an arm."""
    given = values(task)
    own = str(given.get("arm") or given.get("gripper") or "")
    return (not body or body in objects_in(list(given.values()))) and (not arm or not own or own == arm)


def values(task: Node) -> dict[str, Plain]:
    """Return what a motion was given, with what was inferred if it was resolved."""
    inferred = [part.parameters for part in task.children if part.kind == "process-module"]
    return task.parameters | (inferred[0] if inferred else {}) | task.solution


def result(task: Node) -> Plain:
    """Return what a task returned."""
    return from_json(task.finished.result_json or "null") if task.finished is not None else None


def _hands(case: Case, name: str) -> Iterator[Lacking]:
    if case.task is None or case.task.kind != "process-module" or case.before is None:
        return  # it wasn't even resolved
    arm = str(case.given.get("arm") or "")
    held = case.held_by(arm)
    body = next(iter(objects_in(case.given.get("object"))), "")
    if name == "place" and body and arm in case.hands and (held is None or held.body != body):
        yield Lacking("held", body, arm, ("pick-up",), lambda task: about(task, body=body, arm=arm))
        if held is None:
            return
    if name not in (*_TAKING, "place") or not arm:
        return
    holding = case.before.carrier(body) if name == "pick-up" and body else None
    for kept in (held, holding if holding != held else None):
        if kept is not None and not (name == "place" and kept.body == body):
            yield _freed(case, kept)


def _freed(case: Case, held: Attachment) -> Lacking:
    arm = next((name for name, frame in case.hands.items() if frame == held.carrier_link), "")

    def fits(task: Node) -> bool:
        return about(task, body=held.body) if task.name == "place" else about(task, arm=arm)

    return Lacking("hand-free", held.body, arm, ("place", "opening-gripper"), fits)


def _clear(case: Case) -> Iterator[Lacking]:
    """Yield what should have been out of the way, by the links that would have met or what hides the object."""
    if case.world is None or case.robot is None or ("rest" in case.data and case.data["rest"] is not None):
        return
    known: set[tuple[str, str]] = set()
    ends = [(pair.get("body", ""), pair.get("body_link", "")) for pair in case.pairs]
    if case.failure.type == "PerceptionError":
        wanted = case.data.get("reasons")
        ends += [(name, "") for name in case.mentioned if not isinstance(wanted, dict) or name not in wanted]
    for name, link in ends:
        if (name, link) in known or name == case.robot.name:
            continue
        known.add((name, link))
        if case.free_body(name) is not None and name not in case.subjects:
            yield _moved_away(name)
        elif name in case.world.bodies:
            yield from _joint_moved(case, name, link)
    for pair in case.pairs:
        yield from _of_robot(case, pair.get("mover", ""), pair.get("link", ""))


def _taken_out(case: Case) -> Iterator[Lacking]:
    """Yield the drawers and doors that should have been moved to get at what lies in them."""
    names = shut_in(case)
    for task in case.motions("accessing") if names else ():
        given = values(task)
        owner, joint = _accessed(case, given)
        if task.failed and any(lies_in(case, name, owner, joint) for name in names):

            def fits(other: Node, accessed: tuple[str, str] = (owner, joint)) -> bool:
                return _accessed(case, values(other)) == accessed

            yield Lacking("joint-moved", f"{joint} of {owner}", "", ("accessing",), fits, owner, (joint,))
            return


def _accessed(case: Case, given: Mapping[str, Plain]) -> tuple[str, str]:
    """Return what an accessing was to move: furniture, and its joint; if there is none of that name, the handle's."""
    owner, joint = next(objects_in(given.get("part-of")), ""), str(given.get("drawer-joint") or "")
    body = case.world.bodies.get(owner) if case.world is not None else None
    if body is not None and joint not in body.joints:
        joint = next(iter(joints_to(case, owner, str(given.get("drawer-handle") or ""))), joint)
    return owner, joint


def shut_in(case: Case) -> list[str]:
    """Return the objects that couldn't be got at, which may be for what they lie in."""
    return _wanted(case) if case.failure.type in _SHUT_IN else []


def lies_in(case: Case, name: str, owner: str, joint: str) -> bool:
    """Return whether an object is within what a joint of another body moves, by the boxes of its links."""
    assets = case.state.assets
    if case.world is None or assets is None or owner not in case.world.bodies or not joint:
        return False
    body, position = case.world.bodies[owner], case.world.bodies[name].position
    try:
        poses = case.state.urdf(body).link_poses(body.joints)
        shapes = read_shapes(assets[body.models[0]], "collision")
    except (NoSuchName, Damaged, IndexError):
        return False
    for link, pose in poses.items():
        boxes = [shape for shape in shapes.get(link, ()) if shape.kind == "box"]
        if boxes and joint in joints_to(case, owner, link):
            point = geometry.transform(geometry.invert(geometry.multiply(body.pose, pose)), position)
            lowest, highest = (
                [reach(box.pose[0][i] + side * box.size[i] / 2 for box in boxes) for i in range(3)]
                for reach, side in ((min, -1), (max, 1))
            )
            if all(low - _IN <= x <= high + _IN for low, x, high in zip(lowest, point, highest, strict=True)):
                return True
    return False


def _moved_away(name: str) -> Lacking:
    return Lacking("clear", name, "", ("pick-up", "place"), lambda task: about(task, body=name))


def _joint_moved(case: Case, name: str, link: str) -> Iterator[Lacking]:
    joints = joints_to(case, name, link)
    if link and not joints:
        return

    def fits(task: Node) -> bool:
        given = values(task)
        return name in objects_in(given.get("part-of")) and (not link or given.get("drawer-joint") in joints)

    yield Lacking("joint-moved", ", ".join(joints) or name, "", ("accessing",), fits, name, joints)


def _of_robot(case: Case, mover: str, link: str) -> Iterator[Lacking]:
    """Yield what the robot should have put down, or folded away."""
    held = case.world.carrier(mover) if case.world is not None else None
    if held is not None and mover not in case.subjects:
        yield _freed(case, held)
    elif case.motion is not None and case.motion.name == "moving" and case.robot is not None and link:
        moving = set(joints_to(case, case.robot.name, link))
        for arm in case.hands:
            joints = joints_of(case.robot, arm)
            if moving.intersection(joints):
                fits = partial(_takes, f"{arm}-arm")
                yield Lacking("posture", "", arm, ("move-arm-joints",), fits, case.robot.name, joints)


def _takes(slot: str, task: Node) -> bool:
    return slot in task.parameters


def _at_pose(case: Case) -> Iterator[Lacking]:
    """Yield that the robot should have been elsewhere, if it would be nearer there to what it can't reach."""
    target = case.data.get("target")
    if isinstance(target, list) and len(target) == 3:
        goal = [float(str(part)) for part in target[:2]]
    else:
        bodies = [case.world.bodies[name] for name in _wanted(case)] if case.world is not None else []
        goal = list(bodies[0].position[:2]) if bodies else []
    here = list(case.robot.position[:2]) if case.robot is not None else []

    def fits(task: Node) -> bool:
        there = values(task).get("target")
        if not isinstance(there, list) or len(there) != 3 or not here:
            return False
        place = [float(str(part)) for part in there[:2]]
        if math.dist(place, here) < _NEARER:
            return False
        return not goal or math.dist(place, goal) < math.dist(here, goal) - _NEARER

    robot = case.robot.name if case.robot is not None else ""
    yield Lacking("at-pose", "", "", ("moving",), lambda task: not task.failed or fits(task), robot)


def _wanted(case: Case) -> list[str]:
    """Return the objects that should have been reached or seen."""
    reasons = case.data.get("reasons")
    names = list(reasons) if isinstance(reasons, dict) else list(case.subjects)
    return [name for name in names if case.free_body(name) is not None]


def joints_to(case: Case, name: str, link: str) -> tuple[str, ...]:
    """Return the movable joints between a body's base and a link, from the link inwards."""
    if case.world is None or not link:
        return ()
    body = case.world.bodies[name]
    try:
        model = case.state.urdf(body)
    except NoSuchName:
        return ()
    found = []
    joint = model.parent_joint(link) if link in model.links else None
    while joint is not None:
        if joint.name in body.joints:
            found.append(joint.name)
        joint = model.parent_joint(joint.parent)
    return tuple(found)


def holder(case: Case, body: str, step: int | None = None) -> str:
    """Return who holds an object: the name of the robot's arm, or the carrier with its link; "" for nobody."""
    state = case.state if step is None else state_at(case.log, step)
    world = state.worlds.get(case.world.name) if case.world is not None else None
    held = world.carrier(body) if world is not None else None
    if held is None or world is None:
        return ""
    arms = hands(world.bodies.get(held.carrier))
    arm = next((name for name, frame in arms.items() if frame and frame == held.carrier_link), "")
    return arm or held.carrier + (f" ({held.carrier_link})" if held.carrier_link else "")
