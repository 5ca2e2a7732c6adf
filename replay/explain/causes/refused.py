"""What was refused, so that a later motion lacked what it would have done: the same object, joint or hand.

A refusal counts until what it asked for is done after all, or something else is done to the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Mutation, Refusal, argument_values
from replay.explain.causes.case import HANDLER, objects_in
from replay.explain.causes.cause import Refused
from replay.explain.causes.preconditions import lacking, lies_in, shut_in
from replay.explain.causes.raised import is_mistake
from replay.explain.causes.robot_description import joints_of
from replay.explain.causes.swallowed import lacks_value, values_from, went_on
from replay.history.tasks import causing_tasks

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.records import Plain
    from replay.explain.causes.case import Case

_POSES: Final = ("set_position", "set_orientation", "set_position_and_orientation")
_JOINTS: Final = ("set_joint_position", "set_joint_positions")
_SEEN: Final = ("PerceptionError", "LookingFailed")
_HANDS: Final = ("held", "hand-free")
_SEARCHED: Final = 200  # refusals before the failure
_WENT_ON: Final = 2000  # records in which a plan goes on


def find(case: Case) -> Iterator[Refused]:
    """Yield the refusals for want of which the case's motion, or line, failed; the last of each subject."""
    if not case.log.counts().get("refusal"):
        return
    found: set[tuple[str, str]] = set()
    for number, refusal in enumerate(case.log.backwards(case.began - 1, Refusal)):
        if number == _SEARCHED:
            return
        if (refusal.failure.type, refusal.failure.message) == (case.failure.type, case.failure.message):
            continue  # it is the failure itself, or was tried before in the same way
        if not case.is_here(refusal):
            continue
        for missed in _missed(case, refusal):
            if missed not in found and not _done_since(case, refusal):
                found.add(missed)
                yield _refused(case, refusal, *missed)


def _refused(case: Case, refusal: Refusal, precondition: str, subject: str) -> Refused:
    stack = case.source.call_stack(refusal)
    stop = min(case.began + 1, refusal.seq + _WENT_ON)
    step, line = went_on(case, refusal.seq + 1, stop, {refusal.task}, refusal.thread, stack)
    tasks = (each.started for each in causing_tasks(case.log, refusal).tasks)
    handler = next((each for each in tasks if each.kind == HANDLER), None)
    event = [handler.cause] if handler is not None and handler.cause else []
    steps = {refusal.seq, *event, *([step] if step else []), case.step}
    asked = case.line_of(refusal)
    return Refused(tuple(sorted(steps)), precondition, subject, refusal, asked, line, handler)


def _missed(case: Case, refusal: Refusal) -> Iterator[tuple[str, str]]:
    """Yield what the failure lacked of what a refusal would have done: the precondition and its subject."""
    given = argument_values(refusal.arguments)
    subject = next(objects_in(given.get("object")), "")
    lacks = {(each.precondition, each.subject) for each in lacking(case)}
    by_hands = {(kind, name) for kind, name in lacks if kind in _HANDS}
    if refusal.name == "Object" and case.failure.type == "UnknownName":
        if case.data.get("name") == given.get("name"):
            yield "loaded", str(given.get("name"))
    elif refusal.name in ("attach", "detach"):
        held = "held" if refusal.name == "attach" else "hand-free"
        other = next(objects_in(given.get("other")), "")
        if case.robot is not None and case.robot.name in (subject, other):  # it is the robot's hands that matter
            yield from {(held, name) for name in (other, subject) if (held, name) in by_hands}
    elif is_mistake(case):  # however the world was
        names = values_from(case, case.source.call_stack(refusal)) if lacks_value(case) else []
        yield from [("result", ", ".join(names))] if names else []
    elif by_hands:
        return
    elif refusal.name in _POSES and (subject in case.mentioned or _is_robot(case, subject)):
        yield "moved", subject
    elif refusal.name in _JOINTS:
        yield from _joints(case, subject, refusal, given)
    elif refusal.name == "remove" and ("clear", subject) in lacks:
        yield "clear", subject


def _is_robot(case: Case, name: str) -> bool:
    """Return whether it is the robot, and the failure depends on where that stands."""
    return case.motion is not None and case.robot is not None and case.robot.name == name


def _joints(case: Case, subject: str, refusal: Refusal, given: Mapping[str, Plain]) -> Iterator[tuple[str, str]]:
    """Yield the joints that would have been moved, if the failure depends on these."""
    names = set(_joints_meant(refusal, given))
    if case.robot is not None and subject == case.robot.name:
        parts = ["torso", "head"] if case.failure.type in _SEEN else ["torso"]
        touching = [arm for arm in case.hands if any(pair.get("mover") == subject for pair in case.pairs)]
        relevant = {joint for part in (*parts, *touching) for joint in joints_of(case.robot, part)}
        names = names & relevant if case.motion is not None else set()
    elif subject not in case.mentioned:
        names = {joint for joint in names for name in shut_in(case) if lies_in(case, name, subject, joint)}
    if names:
        yield "joint-moved", f"{', '.join(sorted(names))} of {subject}"


def _joints_meant(refusal: Refusal, given: Mapping[str, Plain]) -> Iterator[str]:
    """Yield the joints that would have been moved; of a misspelt one the name that the refusal suggests first."""
    positions = given.get("positions")
    error = argument_values(refusal.failure.data) if refusal.failure.type == "UnknownName" else {}
    near = error.get("nearest")
    for name in (*(positions if isinstance(positions, dict) else ()), given.get("name")):
        if isinstance(name, str):
            yield str(near[0]) if isinstance(near, list) and near and name == error.get("name") else name


def _done_since(case: Case, refusal: Refusal) -> bool:
    """Return whether the same was done between a refusal and the failure, or the plan moved the object otherwise."""
    given = argument_values(refusal.arguments)
    subject, joints = next(objects_in(given.get("object")), ""), set(_joints_meant(refusal, given))
    for record in case.log.records(Mutation, refusal.seq + 1, case.began) if subject else ():
        if record.world != refusal.world:
            continue
        command = record.WhichOneof("command")
        if command == "move_joints" and record.move_joints.body == subject and joints & set(record.move_joints.joints):
            return True
        moved = command == "move_body" and record.move_body.body == subject
        loaded = command in ("load_body", "reset")
        if refusal.name in _POSES and (moved or (loaded and record.load_body.body in ("", subject))):
            return True
        if refusal.name in ("attach", "detach") and command == f"{refusal.name}_body" and _same(record, given):
            return True
    return False


def _same(record: Mutation, given: Mapping[str, Plain]) -> bool:
    names = {*objects_in(given.get("object")), *objects_in(given.get("other"))}
    grip = record.attach_body if record.HasField("attach_body") else record.detach_body
    return {grip.carrier, grip.body} == names
