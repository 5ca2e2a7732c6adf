"""The scene of a failure: the robot, and all that the failed task was about or its message names, at that moment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from replay.errors import NoSuchName
from replay.explain.causes.case import Case, objects_in
from replay.explain.causes.find import find
from replay.explain.causes.why_data import FailedBranch, InvolvedBody, heading
from replay.history.failures import failures
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from recorder.geometry import Pose
    from recorder.records import Plain
    from recorder.tasks import Node
    from replay.state.state import Body


def bodies(case: Case, names: Iterable[str] = ()) -> tuple[InvolvedBody, ...]:
    """Return the robot and the bodies that a failure is about; of a fixed one the links and joints that it names."""
    return tuple(_bodies(case, names))


def _bodies(case: Case, names: Iterable[str]) -> Iterator[InvolvedBody]:
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


def _parts(case: Case) -> Iterator[tuple[str, str, Pose | None]]:
    """Yield the links, with poses, and the joints, without, that a failure names, and whose they are."""
    if case.world is None:
        return
    ends = [(pair.get(body, ""), pair.get(link, "")) for pair in case.pairs for body, link in _ENDS]
    container = next(objects_in(case.given.get("part-of")), "") or str(case.data.get("body") or "")
    named: Mapping[str, Plain] = {**case.given, **case.data}
    ends += [(container, str(named.get(slot) or "")) for slot in ("drawer-handle", "handle")]
    joints = [(container, str(named.get(slot) or "")) for slot in ("drawer-joint", "joint")]
    for name, link in dict.fromkeys(ends):
        body = case.world.bodies.get(name)
        pose = _link_pose(case, body, link) if body is not None and link else None
        if pose is not None:
            yield name, link, pose
    for name, joint in dict.fromkeys(joints):
        if name in case.world.bodies and joint in case.world.bodies[name].joints:
            yield name, joint, None


_ENDS = (("mover", "link"), ("body", "body_link"))


def _link_pose(case: Case, body: Body, link: str) -> Pose | None:
    try:
        return case.state.link_pose(body, link)
    except NoSuchName:
        return None


def branches(case: Case) -> Iterator[FailedBranch]:
    """Yield the other failures that failed the same block, each with its scene and causes."""
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
    """Yield the tasks in which a failure began: of a block those of all its parts, else the one that it ended with."""
    failed = [child for child in task.children if child.failed]
    if task.kind != "block":
        failed = [child for child in failed if any(each is child for each in task.origin.around())]
    for child in failed:
        yield from _origins(child)
    if not failed:
        yield task


def _branch(case: Case, task: Node) -> FailedBranch:
    step, failure = task.last_step, task.failure
    state = state_at(case.log, step)
    world = state.worlds.get(case.world.name) if case.world is not None else None
    opened = world if world is not None and world.open else None
    before = failures(case.log, step + 1)
    own = next((each for each in before.origins if each.id == task.id), task)
    other = Case(case.log, step, failure or case.failure, own, before, state, opened)
    motion = own.motion.asked or own.motion.started
    return FailedBranch(own, case.line_of(motion), bodies(other, other.subjects), find(other))
