"""The scene at a failure: the robot, and the bodies that the failed task or the message names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from recorder.geometry import Pose
from recorder.records import Plain
from recorder.tasks import Node
from replay.errors import NoSuchName
from replay.explain.causes import find
from replay.explain.causes.case import Cause, FailureCase, objects_in
from replay.history.source import Line
from replay.history.tasks import failures
from replay.report import phrases
from replay.state.fold import state_at
from replay.state.state import Attachment, Body

_ENDS = (("mover", "link"), ("body", "body_link"))


@dataclass(frozen=True, slots=True)
class InvolvedBody:
    """The state of the robot or of a body of the failed task at a failure."""

    body: Body
    held: Attachment | None  # attachment of the body to a carrier
    holds: tuple[Attachment, ...]  # attachments of other bodies to this body
    is_robot: bool
    distance: float | None  # distance in m on the ground from the robot's base; None for the robot
    #: Direction relative to the robot's heading in rad, positive to the left; None for the robot.
    bearing: float | None
    hands: Mapping[str, str] = field(default_factory=dict)  # the robot's arms, by the body that they hold
    links: Mapping[str, Pose] = field(default_factory=dict)  # poses of links that the failure names
    joints: Mapping[str, float] = field(default_factory=dict)  # positions of joints that the failure names, rad or m

    def lines(self) -> Iterator[str]:
        """Yield the body as text. Of fixed bodies, the text contains only the named links and joints."""
        body = self.body
        if self.is_robot or not body.fixed_base or not (self.links or self.joints):
            yield self._line()
        for name, (position, _) in self.links.items():
            yield f"{name} of {body.name} at {phrases.vector(position)}"
        for name, value in self.joints.items():
            yield f"joint {name} of {body.name} at {phrases.number(value)}"

    def _line(self) -> str:
        text = f"{self.body.name} at {phrases.vector(self.body.position)}"
        if self.is_robot:
            held = [
                held.body + (f" in the {self.hands[held.body]} gripper" if held.body in self.hands else "")
                for held in self.holds
            ]
            text += f", facing {facing(self.body)}, holding {phrases.names(held)}"
        elif self.distance is not None and self.bearing is not None:
            side = math.degrees(self.bearing)
            direction = f"{abs(side):.0f} degrees to the {'left' if side > 0 else 'right'}"
            turn = "straight ahead" if abs(side) < 1 else direction
            text += f", {self.distance:.2f} m from the robot, {turn}"
        if self.held is not None:
            hand = self.hands.get(self.body.name)
            text += f", held by {f'the {hand} gripper of {self.held.carrier}' if hand else phrases.carrier(self.held)}"
        return text


@dataclass(frozen=True, slots=True)
class FailedBranch:
    """A failed part of the failed block, other than the explained part."""

    task: Node
    line: Line | None  # the plan's line that requested the failed part
    bodies: tuple[InvolvedBody, ...]  # the robot and the bodies of the failed part at the failure
    causes: tuple[Cause, ...]  # causes of the part's failure

    def lines(self) -> Iterator[str]:
        """Yield the failure as text."""
        yield (phrases.error(self.task) if self.task.error else "") + phrases.at(self.line)
        yield from (line for cause in self.causes for line in cause.lines())
        yield from (line for involved in self.bodies for line in involved.lines())


def heading(body: Body) -> float:
    """Return the angle in rad from the world's x axis to a body's heading."""
    x, y, z, w = body.orientation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def facing(body: Body) -> str:
    """Return the heading of a body as text."""
    return f"{round(math.degrees(heading(body))) or 0} degrees"


def bodies(case: FailureCase, names: Iterable[str] = ()) -> Iterator[InvolvedBody]:
    """Yield the robot and the bodies of a failure, with the links and joints that the failure names."""
    world, robot = case.world, case.robot
    if world is None:
        return
    parts = list(_parts(case))
    named = [body for body, _, _ in parts]
    for name in dict.fromkeys((world.robot, *names, *case.mentioned, *named)):
        body = world.bodies.get(name)
        if body is None:
            continue
        links = {link: pose for owner, link, pose in parts if owner == name and pose is not None}
        joints = {part: body.joints[part] for owner, part, pose in parts if owner == name and pose is None}
        if body.fixed_base and body is not robot and name not in names and not (links or joints):
            continue
        distance = bearing = None
        if robot is not None and body is not robot:
            dx, dy = body.position[0] - robot.position[0], body.position[1] - robot.position[1]
            distance = math.hypot(dx, dy)
            bearing = math.remainder(math.atan2(dy, dx) - heading(robot), math.tau)
        carrier, carried = world.carrier(name), tuple(world.carried(name))
        arms = {frame: arm for arm, frame in case.hands.items()} if robot is not None else {}
        grips = (*carried, *([carrier] if carrier is not None else []))
        held = {each.body: arms[each.carrier_link] for each in grips if each.carrier_link in arms}
        yield InvolvedBody(body, carrier, carried, body is robot, distance, bearing, held, links, joints)


def _parts(case: FailureCase) -> Iterator[tuple[str, str, Pose | None]]:
    """Yield the names in a failure: bodies with links and their poses, or with joints and None."""
    if case.world is None:
        return
    ends = [(pair.get(body, ""), pair.get(link, "")) for pair in case.pairs for body, link in _ENDS]
    container = next(objects_in(case.given.get("part-of")), "") or str(case.data.get("body") or "")
    named: Mapping[str, Plain] = {**case.given, **case.data}
    ends += [(container, str(named.get(slot) or "")) for slot in ("drawer-handle", "handle")]
    joints = [(container, str(named.get(slot) or "")) for slot in ("drawer-joint", "joint")]
    for name, link in dict.fromkeys(ends):
        if link and name in case.world.bodies:
            with suppress(NoSuchName):
                yield name, link, case.state.link_pose(case.world.bodies[name], link)
    for name, joint in dict.fromkeys(joints):
        if name in case.world.bodies and joint in case.world.bodies[name].joints:
            yield name, joint, None


def branches(case: FailureCase) -> Iterator[FailedBranch]:
    """Yield the other failures of the failed block with their scenes and causes."""
    if case.task is None:
        return
    for block in case.task.around():
        if not block.failed:
            break
        if block.kind == "block":
            own = next((child for child in block.children if any(each is child for each in case.task.around())), None)
            for child in block.children:
                if child is not own and child.failed:
                    yield from (_branch(case, task) for task in _origins(child))


def _origins(task: Node) -> Iterator[Node]:
    """Yield the tasks in which a failure began. Each failed part of a block has such a task."""
    failed = [child for child in task.children if child.failed]
    if task.kind != "block":
        failed = [child for child in failed if any(each is child for each in task.origin.around())]
    for child in failed:
        yield from _origins(child)
    if not failed:
        yield task


def _branch(case: FailureCase, task: Node) -> FailedBranch:
    step, failure = task.last_step, task.failure
    state = state_at(case.log, step)
    world = state.worlds.get(case.world.name) if case.world is not None else None
    opened = world if world is not None and world.open else None
    before = failures(case.log, step + 1)
    own = next((each for each in before.origins if each.id == task.id), task)
    other = FailureCase(case.log, step, failure or case.failure, own, before, state, opened)
    motion = own.motion.asked or own.motion.started
    return FailedBranch(own, case.line_of(motion), tuple(bodies(other, other.subjects)), find(other))
