"""A failed motion lacked a precondition: an earlier motion failed, or a request was refused, and the plan continued.

The last motion of the same object, arm or joint that should have established the precondition failed, was cancelled, or
was skipped because a perception had found nothing. The failed motion isn't a cause if a later motion has succeeded, or
if the object or joint has changed in another way. A refused request stays a cause until it is fulfilled, or until the
object or joint changes in another way.
"""

from __future__ import annotations

import ast
import builtins
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder import geometry
from recorder.plan_lines import called_name, syntax_nodes
from recorder.records import Mutation, Plain, Query, Refusal, Task, argument_values
from recorder.records.text import link_text
from recorder.tasks import Node, State
from recorder.urdf import read_shapes
from replay.errors import Damaged, NoSuchName
from replay.explain.causes import trials
from replay.explain.causes.case import HANDLER, Cause, FailureCase, about, joints_of, objects_in, values
from replay.explain.causes.raised import is_mistake
from replay.history.source import Line
from replay.history.tasks import causing_tasks
from replay.report import phrases
from replay.state.state import Attachment

if TYPE_CHECKING:
    from replay.explain.causes.trials import Trial

_TAKING: Final = ("pick-up", "accessing")
_OUT_OF_REACH: Final = ("Unreachable", "HandleUnreachable", "LookingFailed")
_SHUT_IN: Final = ("Unreachable", "Blocked", "GraspFailed", "PerceptionError")
_NEARER: Final = 0.05  # difference in m below which two places are equally near to the target
_IN: Final = 0.03  # distance in m from the drawer's boxes within which an object is in the drawer
_PERCEIVING: Final = ("detecting", "world-state-detecting")
_UNSUCCESSFUL: Final = (State.FAILED, State.CANCELLED)
#: Errors that a value None in the plan may cause, in addition to Python's errors.
_MISSING_VALUE: Final = ("DesignatorError", "BadArgument")
_EMPTY: Final = ("IndexError", "KeyError", "StopIteration")  # errors that a missing item of a container may cause
_MAX_ALSO: Final = 3
_MAX_SETTING: Final = 100  # maximum number of motions that may have filled a list
_GOES_ON: Final = 2000  # number of records that are searched for the plan's next step
_POSES: Final = ("set_position", "set_orientation", "set_position_and_orientation")
_JOINTS: Final = ("set_joint_position", "set_joint_positions")
_SEEN: Final = ("PerceptionError", "LookingFailed")
_HANDS: Final = ("held", "hand-free")
_REFUSALS: Final = 200  # number of refusals before the failure that are searched
#: Phrases for missing preconditions.
_LACKED: Final = {
    "held": "so the {arm} gripper didn't hold {subject}",
    "hand-free": "so the {arm} gripper still held {subject}",
    "clear": "so {subject} had not moved",
    "joint-moved": "so {subject} had not moved",
    "at-pose": "so the robot stood at the wrong place",
    "posture": "so the {arm} arm wasn't in that posture",
    "camera-directed": "so the camera looked in another direction",
    "result": "so {subject} had no value",
}
_REFUSED: Final = _LACKED | {
    "moved": "so {subject} had not moved",
    "loaded": "so there was no {subject}",
    "held": "so nothing held {subject}",
    "hand-free": "so {subject} was still held",
}


@dataclass(frozen=True, slots=True)
class Swallowed(Cause):
    """An earlier task failed or was cancelled, the plan continued, and a later task needed the missing effect."""

    kind = "swallowed-failure"
    #: The missing precondition: "held" (the arm holds the object), "hand-free" (the arm holds nothing), "clear" (the
    #: object isn't in the way), "joint-moved", "at-pose" (the robot stands at its target), "posture" (of the arm),
    #: "camera-directed", "result" (of a task, in a variable)
    precondition: str
    subject: str  # object, joint or variable of the precondition, or ""
    arm: str  # name of the arm, or ""
    failed: Node  # the earlier task
    line: Line | None  # the plan's line that requested the task
    went_on: Line | None  # the plan's next line after the failure
    also: tuple[Node, ...] = ()  # other failed attempts, for example with the other arm
    skipped: Line | None = None  # line that skipped the use of the variable, such as a loop over an empty list
    handled: Line | None = None  # line of the ``except`` that took the failure

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Swallowed]:
        """Yield the failures whose missing effects made the motion or the plan's line fail."""
        for lack in lacking(case):
            last = next((motion for motion in case.motions(*lack.motions) if lack.fits(motion)), None)
            if last is not None and last.status in _UNSUCCESSFUL and not _was_done_since(case, lack, last):
                also = _failed_alternatives(case, lack, last)
                yield _swallowing(case, lack.precondition, lack.subject, lack.arm, last, also)
            found = _skipped_use(case, lack) if last is None else None
            if found is not None and not _was_done_since(case, lack, found[0]):
                motion, name, line = found
                yield replace(_swallowing(case, "result", name, "", motion), skipped=line)
        yield from _results(case)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial with the effect of the earlier task, then the trial in which that task uses another arm."""
        yield from _effect(case, self.precondition, self.subject, self.arm, self.failed)
        yield from trials.other_arm(case, self.failed)

    def _words(self) -> Iterator[str]:
        failed = self.failed
        lacked = f"{_lacked(_LACKED[self.precondition], self.subject, self.arm)} at step {self.steps[-1]}"
        if self.skipped is not None:
            skipped = f"{phrases.place(self.skipped)} was skipped: {self.skipped.text}"
            lacked = f"so {self.subject} was empty, and {skipped}"
        how = f"{_where(self.line)} {'was cancelled' if failed.status is State.CANCELLED else 'failed'}"
        went_on = f"the plan continued{_where(self.went_on)}; {lacked}"
        how = f"{how} at step {failed.last_step}" + (f", was handled{_where(self.handled)}," if self.handled else "")
        yield f"{phrases.node(failed)}{how} and {went_on}"
        if failed.error is not None:
            yield f"its failure: {phrases.error(failed)}"
        for task in self.also:
            yield f"{phrases.node(task)} failed as well at step {task.last_step}: {phrases.error(task)}"


@dataclass(frozen=True, slots=True)
class RefusedRequest(Cause):
    """A request of the plan was refused, the plan continued, and a later motion needed the missing effect."""

    kind = "refused"
    #: The missing precondition: "held", "hand-free", "clear", "joint-moved" and "result" as in :class:`Swallowed`,
    #: "moved" (the object or robot is in another place) or "loaded" (the object exists)
    precondition: str
    subject: str  # the object, joint or variable
    asked: Refusal
    line: Line | None  # the plan's line that requested the task
    went_on: Line | None  # the plan's next line after the refusal
    handler: Task | None = None  # the start of the handler's call that made the request

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[RefusedRequest]:
        """Yield, for each subject, the last refusal without whose effect the motion or line failed."""
        if not case.log.counts().get("refusal"):
            return
        found: set[tuple[str, str]] = set()
        for refusal in islice(case.log.backwards(case.began - 1, Refusal), _REFUSALS):
            if (refusal.failure.type, refusal.failure.message) == (case.failure.type, case.failure.message):
                continue  # the refusal is the failure itself, or belongs to the same attempt
            if not case.is_here(refusal):
                continue
            for missed in _missing_effects(case, refusal):
                if missed not in found and not _was_fulfilled_later(case, refusal):
                    found.add(missed)
                    yield _refusal(case, refusal, *missed)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial with the effect of the refused request, if a fork can make that effect."""
        given, failure = argument_values(self.asked.arguments), argument_values(self.asked.failure.data)
        hands = [arm for arm in case.hands if arm == case.given.get("arm")] or list(case.hands)
        position = given.get("position")
        numbers = [each for each in position if isinstance(each, int | float)] if isinstance(position, list) else []
        if self.precondition == "moved" and len(numbers) == 3:  # others are not finite
            yield trials.arranged(case, {self.subject: (numbers, "")}, self.asked.seq)
        elif self.precondition == "joint-moved":
            body, positions = next(objects_in(given.get("object")), ""), given.get("positions")
            asked = [*(positions.values() if isinstance(positions, dict) else ()), position]
            for joint, wanted in zip(_joints_meant(self.asked, given), asked, strict=False):
                low, high = failure.get("lower", wanted), failure.get("upper", wanted)
                if all(isinstance(each, int | float) for each in (wanted, low, high)):
                    yield from trials.joint_at(case, body, joint, min(max(wanted, low), high), self.asked.seq)
        elif self.precondition in (*_HANDS, "clear"):
            yield from _effect(case, self.precondition, self.subject, hands[0] if hands else "", None)

    def _words(self) -> Iterator[str]:
        asked = self.asked
        inside = f", in {phrases.handler(self.handler)}," if self.handler is not None else ""
        lacked = f"{_lacked(_REFUSED.get(self.precondition, ''), self.subject)} at step {self.steps[-1]}"
        refused = f"{phrases.refused(asked)}{_where(self.line)} was refused at step {asked.seq}{inside}"
        yield f"{refused} and the plan continued{_where(self.went_on)}; {lacked}"
        yield f"the reason: {phrases.failure(asked.failure)}"


_CLOSED: Final = re.compile(r"(.+?),? which (?:is|are) closed: open it first")
_OPENING: Final = ("opening", "accessing")


@dataclass(frozen=True, slots=True)
class ClosedContainer(Cause):
    """An object should have been put into, or taken from, a container that was closed."""

    kind = "closed"
    untestable = "the joint of the container isn't known"
    container: str
    opening: Line | None  # a later line of the same function that opens something; None without such a line
    body: str  # the object in the container; "" if the object should have been put into it
    joint: tuple[str, str] | None  # the furniture and the joint of the container; None if unknown

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[ClosedContainer]:
        """Yield the closed container that a failure names, or in which an object of the failed motion lies."""
        found = _CLOSED.match(str(case.data.get("last", "")))
        if case.task is None or case.world is None:
            return
        asked = case.line_of(case.task.started)
        nodes = syntax_nodes(case.source.text(asked.file)) if asked is not None else ()
        calls = (node for node in nodes if isinstance(node, ast.Call) and called_name(node) in _OPENING)
        later = (case.source.line(asked.file, call.lineno) for call in calls if asked and call.lineno > asked.number)
        opening = next((line for line in later if line and asked and line.function == asked.function), None)
        fixed = [each for each in case.world.bodies.values() if each.fixed_base and each is not case.robot]
        closed = [
            (each.name, joint) for each in fixed for joint, value in each.joints.items() if abs(value) <= trials.OPEN
        ]
        if found is not None and case.failure.type == "NoPlace":
            named = [each for each in closed if {*found[1].split()} <= {*each[1].split("_")}]
            yield ClosedContainer((case.step,), found[1], opening, "", named[0] if len(named) == 1 else None)
            return
        for name in _perhaps_enclosed(case):
            for owner, joint in (each for each in closed if lies_in(case, name, *each)):
                moved = case.state.urdf(case.world.bodies[owner]).joints[joint]
                if moved.type == "prismatic" and case.world.carrier(name) is None:  # nothing lies in a door
                    yield ClosedContainer((case.step,), link_text(owner, moved.child), opening, name, (owner, joint))

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether an earlier motion should have opened the container."""
        lacked = [each for each in found if getattr(each, "precondition", "") == "joint-moved"]
        return self.joint is not None and any(self.joint[1] in getattr(each, "subject", "") for each in lacked)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials with the container open."""
        step = case.task.started.seq - 1 if case.task is not None and case.motion is None else None
        if self.joint is not None:
            yield from trials.opened(case, *self.joint, step)

    def _words(self) -> Iterator[str]:
        inside = f"{self.body} was in {self.container}, which" if self.body else self.container
        yield f"{inside} was closed at step {self.steps[0]}"
        if self.opening is not None:
            yield f"{phrases.place(self.opening)} comes later: {phrases.short(self.opening.text)}"


def _effect(case: FailureCase, precondition: str, subject: str, arm: str, failed: Node | None) -> Iterator[Trial]:
    """Yield the trial in which a precondition holds just before the failure."""
    given = values(failed) if failed is not None else {}
    target = given.get("target")
    if precondition == "held":
        yield from trials.in_hand(case, subject, arm)
    elif precondition in ("hand-free", "clear"):
        yield from (trials.freed if precondition == "hand-free" else trials.away)(case, subject)
    elif precondition == "joint-moved":
        (body, joint), distance = _accessed_joint(case, given), given.get("distance")
        if body and isinstance(distance, int | float):
            yield from trials.joint_at(case, body, joint, distance)
    elif precondition == "at-pose" and isinstance(target, list) and case.robot is not None:
        turn = given.get("orientation")
        pose = [*target, *(turn if isinstance(turn, list) else case.robot.orientation)]
        yield trials.arranged(case, {case.robot.name: ([float(str(each)) for each in pose], "")})
    elif precondition == "posture" and isinstance(given.get(f"{arm}-arm"), list):
        for joint, value in zip(joints_of(case.robot, arm), given[f"{arm}-arm"], strict=False):  # type: ignore[arg-type]
            yield from trials.joint_at(case, case.robot.name if case.robot else "", joint, float(str(value)))
    elif case.failure.type == "PerceptionError" and case.task is not None:
        yield from trials.seen(case, case.task)
    elif failed is not None and failed.motion.name in _PERCEIVING:
        yield from trials.seen(case, failed)


def _where(line: Line | None) -> str:
    return f" at {phrases.place(line)}" if line is not None else ""


def _lacked(text: str, subject: str, arm: str = "") -> str:
    return text.format(subject=subject, arm=arm).replace("the  ", "the ")


# --- preconditions of a motion ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Lacking:
    """A precondition that a motion lacked."""

    precondition: str  # as in :class:`Swallowed`
    subject: str  # the object or joint of the precondition, or ""
    arm: str  # name of the arm, or ""
    motions: tuple[str, ...]  # names of motions that can establish the precondition
    fits: Callable[[Node], bool]  # returns whether a motion is about the same object, joint and arm
    owner: str = ""  # body with the joints, or the robot if it is at a wrong place, or ""
    joints: tuple[str, ...] = ()  # the joints that should have been moved

    def done_by(self, record: Mutation) -> bool:
        """Return whether a change affected the same object or joint. If so, earlier failures don't matter."""
        if self.precondition in ("held", "hand-free"):
            return record.HasField("attach_body") and self.subject in [each.body for each in record.effect.attached]
        if self.joints:
            moved = record.move_joints
            return moved.body == self.owner and not set(moved.joints).isdisjoint(self.joints)
        return record.move_body.body == (self.owner or self.subject) != ""


def lacking(case: FailureCase) -> Iterator[Lacking]:
    """Yield the preconditions that a failed motion lacked."""
    if case.motion is None or case.world is None or case.robot is None:
        return
    by_hands = list(_hands(case, case.motion.name))
    if by_hands:  # motions check the hands before everything else
        yield from by_hands
        return
    yield from _clear(case)
    yield from _closed(case)
    if case.failure.type in _OUT_OF_REACH:
        yield from _at_pose(case)
    elif case.failure.type == "PerceptionError":
        yield Lacking("camera-directed", "", "", ("looking",), lambda _: True)
        yield from _at_pose(case)


def _hands(case: FailureCase, name: str) -> Iterator[Lacking]:
    if case.task is None or case.task.kind != "process-module" or case.before is None:
        return  # the arm isn't known if the motion wasn't resolved
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


def _freed(case: FailureCase, held: Attachment) -> Lacking:
    arm = next((name for name, frame in case.hands.items() if frame == held.carrier_link), "")

    def fits(task: Node) -> bool:
        return about(task, body=held.body) if task.name == "place" else about(task, arm=arm)

    return Lacking("hand-free", held.body, arm, ("place", "opening-gripper"), fits)


def _clear(case: FailureCase) -> Iterator[Lacking]:
    """Yield the obstacles that should have been moved: colliding links, and bodies that hide the object."""
    if case.world is None or case.robot is None or case.data.get("rest") is not None:
        return
    ends = [(pair.get("body", ""), pair.get("body_link", "")) for pair in case.pairs]
    if case.failure.type == "PerceptionError":
        wanted = case.data.get("reasons")
        ends += [(name, "") for name in case.mentioned if not isinstance(wanted, dict) or name not in wanted]
    for name, link in dict.fromkeys(ends):
        if case.free_body(name) is not None and name not in case.subjects:
            yield Lacking("clear", name, "", ("pick-up", "place"), partial(about, body=name))
        elif name in case.world.bodies and name != case.robot.name:
            yield from _joint_moved(case, name, link)
    for pair in case.pairs:
        yield from _of_robot(case, pair.get("mover", ""), pair.get("link", ""))


def _closed(case: FailureCase) -> Iterator[Lacking]:
    """Yield the closed drawer or door that contains the object."""
    names = _perhaps_enclosed(case)
    for task in case.motions("accessing") if names else ():
        given = values(task)
        owner, joint = _accessed_joint(case, given)
        if task.failed and any(lies_in(case, name, owner, joint) for name in names):

            def fits(other: Node, accessed: tuple[str, str] = (owner, joint)) -> bool:
                return _accessed_joint(case, values(other)) == accessed

            yield Lacking("joint-moved", f"{joint} of {owner}", "", ("accessing",), fits, owner, (joint,))
            return


def _accessed_joint(case: FailureCase, given: Mapping[str, Plain]) -> tuple[str, str]:
    """Return the furniture and joint of an accessing motion. The default joint is the joint of the handle."""
    owner, joint = next(objects_in(given.get("part-of")), ""), str(given.get("drawer-joint") or "")
    body = case.world.bodies.get(owner) if case.world is not None else None
    if body is not None and joint not in body.joints:
        joint = next(iter(case.joints_to(owner, str(given.get("drawer-handle") or ""))), joint)
    return owner, joint


def _perhaps_enclosed(case: FailureCase) -> list[str]:
    return _wanted(case) if case.failure.type in _SHUT_IN else []


def lies_in(case: FailureCase, name: str, owner: str, joint: str) -> bool:
    """Return whether an object is inside the boxes of the links that a joint moves."""
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
        if boxes and joint in case.joints_to(owner, link):
            point = geometry.transform(geometry.invert(geometry.multiply(body.pose, pose)), position)
            lowest, highest = (
                [reach(box.pose[0][i] + side * box.size[i] / 2 for box in boxes) for i in range(3)]
                for reach, side in ((min, -1), (max, 1))
            )
            if all(low - _IN <= x <= high + _IN for low, x, high in zip(lowest, point, highest, strict=True)):
                return True
    return False


def _joint_moved(case: FailureCase, name: str, link: str) -> Iterator[Lacking]:
    joints = case.joints_to(name, link)
    if link and not joints:
        return

    def fits(task: Node) -> bool:
        given = values(task)
        return name in objects_in(given.get("part-of")) and (not link or given.get("drawer-joint") in joints)

    yield Lacking("joint-moved", ", ".join(joints) or name, "", ("accessing",), fits, name, joints)


def _of_robot(case: FailureCase, mover: str, link: str) -> Iterator[Lacking]:
    """Yield the held object that should have been put down, or the arm that should have been folded."""
    held = case.world.carrier(mover) if case.world is not None else None
    if held is not None and mover not in case.subjects:
        yield _freed(case, held)
    elif case.motion is not None and case.motion.name == "moving" and case.robot is not None and link:
        moving = set(case.joints_to(case.robot.name, link))
        for arm in case.hands:
            joints = joints_of(case.robot, arm)
            if moving.intersection(joints):

                def fits(task: Node, slot: str = f"{arm}-arm") -> bool:
                    return slot in task.parameters

                yield Lacking("posture", "", arm, ("move-arm-joints",), fits, case.robot.name, joints)


def _at_pose(case: FailureCase) -> Iterator[Lacking]:
    """Yield the precondition that the robot is at another place, nearer to the target."""
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


def _wanted(case: FailureCase) -> list[str]:
    """Return the objects that should have been reached or seen."""
    reasons = case.data.get("reasons")
    names = list(reasons) if isinstance(reasons, dict) else list(case.subjects)
    return [name for name in names if case.free_body(name) is not None]


# --- swallowed failures ----------------------------------------------------------------------------------------------


def _was_done_since(case: FailureCase, lack: Lacking, failed: Node) -> bool:
    changes = case.log.records(Mutation, failed.last_step + 1, case.began)
    here = case.world.name if case.world is not None else ""
    return any(isinstance(each, Mutation) and each.world == here and lack.done_by(each) for each in changes)


def _swallowing(
    case: FailureCase, precondition: str, subject: str, arm: str, failed: Node, also: tuple[Node, ...] = ()
) -> Swallowed:
    outer = max((failed, *also), key=lambda task: task.last_step).outermost_failed
    stack = case.source.call_stack(outer.started)
    around = {node.id for node in outer.around()} - {outer.id} | {0}
    step, went_on = _next_step(case, outer.last_step, around, outer.started.thread, stack)
    steps = case.steps(failed.last_step, step or None, *(task.last_step for task in also))
    line = case.line_of(failed.started)
    handled = case.source.handler(line) if line is not None else None
    return Swallowed(steps, precondition, subject, arm, failed, line, went_on, also, handled=handled)


def _failed_alternatives(case: FailureCase, lack: Lacking, failed: Node) -> tuple[Node, ...]:
    """Return the attempts that failed since the last success, with any arm."""
    found: list[Node] = []
    for motion in case.motions(*lack.motions) if lack.arm else ():
        if not about(motion, body=lack.subject):
            continue
        if motion.status not in _UNSUCCESSFUL:
            break
        if motion is not failed and motion.error not in [each.error for each in (failed, *found)]:
            found.append(motion)
    return tuple(found[:_MAX_ALSO][::-1])


def _next_step(
    case: FailureCase, end: int, around: Collection[int], thread: str, stack: Sequence[Line]
) -> tuple[int, Line | None]:
    """Return the first step of the plan's own code after a step, and its line; 0 and None if there is none.

    ``around`` contains the ids of the tasks around the step; 0 stands for the plan itself. ``stack`` is the call stack
    of the step.
    """
    for record in case.log.records((Task, Mutation), end + 1, min(case.began + 1, end + _GOES_ON)):
        if not isinstance(record, Task | Mutation) or (isinstance(record, Task) and record.phase == Task.FINISHED):
            continue
        parent = record.parent if isinstance(record, Task) else record.task
        lines = case.source.call_stack(record) if parent in around else ()
        if lines and record.thread == thread:
            if list(lines) == list(stack):  # this step belongs to the next iteration of a loop
                return record.seq, case.line(lines)
            fresh = (line for line, before in zip(lines, stack, strict=False) if line != before)
            return record.seq, next(fresh, lines[min(len(stack), len(lines) - 1)])
    return 0, None


def _results(case: FailureCase) -> Iterator[Swallowed]:
    """Yield the failures that left a variable of the failed line empty."""
    setting = _motions_setting_variables(case) if _lacks_value(case) else iter(())
    if case.failure.type in _EMPTY:  # several motions may have added items to the container
        found = list(islice(setting, _MAX_SETTING))
        succeeded = [motion.parameters for motion, _ in found if motion.status not in _UNSUCCESSFUL]
        missing = [each for each in found if each[0].status in _UNSUCCESSFUL and each[0].parameters not in succeeded]
        key = case.failure.message.strip("'") if case.failure.type == "KeyError" else ""
        named = [each for each in missing if key and key in each[0].parameters.values()]
        last = next(iter(named or missing), None)
    else:
        last = next(setting, None)
    if last is not None and last[0].status in _UNSUCCESSFUL:
        yield _swallowing(case, "result", ", ".join(last[1]), "", last[0])


def _motions_setting_variables(case: FailureCase) -> Iterator[tuple[Node, list[str]]]:
    """Yield earlier motions, the latest first, with the variables that the failed line reads."""
    for motion in reversed(case.failed.motions):
        if motion.last_step < case.step and motion is not case.motion:
            names = _variables_from(case, case.source.call_stack(motion.started))
            if names:
                yield motion, names


def _lacks_value(case: FailureCase) -> bool:
    """Return whether a line of the plan failed because a value was missing."""
    failed, message = case.failure.type, case.failure.message
    if failed in (*_EMPTY, "NameError", "UnboundLocalError"):
        return True
    own_mistake = hasattr(builtins, failed) or failed in _MISSING_VALUE
    texts = (message, *(case.motion.parameters.values() if case.motion is not None else ()))
    return own_mistake and any(text is None or "None" in str(text) for text in texts)


def _variables_from(case: FailureCase, setting: Sequence[Line]) -> list[str]:
    """Return the variables that these lines assign, and that the failed lines use."""
    stack = case.source.call_stack(case.task.motion.started) if case.task is not None else ()
    lines = (*stack, *(line for error in case.traced for line in error.lines))
    places = [{(line.file, line.number) for line in each} for each in (lines, setting)]
    shared = places[0] & places[1]  # lines of helper functions that several calls share
    read, written = (
        case.names_in([line for line in each if (line.file, line.number) not in shared], context)
        for each, context in ((lines, ast.Load), (setting, ast.Store))
    )
    return sorted(name for _, name in read & written)


def _skipped_use(case: FailureCase, lack: Lacking) -> tuple[Node, str, Line] | None:
    """Return the failed perception of a missing object, its variable, and the line that skipped the variable's use."""
    body = case.world.bodies.get(lack.subject) if case.world is not None else None
    if body is None:
        return None
    of_type = (each for each in case.motions(*_PERCEIVING) if each.parameters.get("object-type") == body.type)
    motion = next(of_type, None)
    if motion is None or not motion.failed:
        return None
    for line in case.source.call_stack(motion.started):
        for function, name in sorted(case.names_in([line], ast.Store)):
            for head, last in _heads(case, line, function, name):
                if not _ran(case, motion, head, last):
                    return motion, name, head
    return None


def _heads(case: FailureCase, line: Line, function: str, name: str) -> Iterator[tuple[Line, int]]:
    """Yield later ``for``, ``while`` and ``if`` lines that read a variable, and the last lines of their bodies."""
    for node in syntax_nodes(case.source.text(line.file)):
        if not isinstance(node, ast.For | ast.While | ast.If) or node.lineno <= line.number:
            continue
        head = case.source.line(line.file, node.lineno)
        decided = node.iter if isinstance(node, ast.For) else node.test
        used = {name, *(_names_below(node.target) if isinstance(node, ast.For) else ())}
        if head is None or head.function != function or name not in _names_below(decided):
            continue
        calls = [part for statement in node.body for part in ast.walk(statement) if isinstance(part, ast.Call)]
        if any(used & _names_below(part) for part in calls):
            yield head, node.body[-1].end_lineno or node.lineno


def _names_below(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _ran(case: FailureCase, motion: Node, head: Line, last: int) -> bool:
    """Return whether the body of a head line ran after a motion. If there are too many records, return True."""
    records = list(islice(case.log.records((Task, Mutation, Query), motion.last_step + 1, case.began), _GOES_ON))
    if len(records) == _GOES_ON:
        return True
    stacks = (case.source.call_stack(record) for record in records)
    return any(line.file == head.file and head.number < line.number <= last for stack in stacks for line in stack)


# --- refused requests ------------------------------------------------------------------------------------------------


def _refusal(case: FailureCase, refusal: Refusal, precondition: str, subject: str) -> RefusedRequest:
    stack = case.source.call_stack(refusal)
    step, line = _next_step(case, refusal.seq, {refusal.task}, refusal.thread, stack)
    tasks = (each.started for each in causing_tasks(case.log, refusal).tasks)
    handler = next((each for each in tasks if each.kind == HANDLER), None)
    event = handler.cause or None if handler is not None else None
    steps = case.steps(refusal.seq, event, step or None)
    return RefusedRequest(steps, precondition, subject, refusal, case.line_of(refusal), line, handler)


def _missing_effects(case: FailureCase, refusal: Refusal) -> Iterator[tuple[str, str]]:
    """Yield the missing preconditions that a refused request would have established, with their subjects."""
    given = argument_values(refusal.arguments)
    subject = next(objects_in(given.get("object")), "")
    lacks = {(each.precondition, each.subject) for each in lacking(case)}
    by_hands = {(kind, name) for kind, name in lacks if kind in _HANDS}
    is_robot = case.robot is not None and case.robot.name == subject
    if refusal.name == "Object" and case.failure.type == "UnknownName":
        if case.data.get("name") == given.get("name"):
            yield "loaded", str(given.get("name"))
    elif refusal.name in ("attach", "detach"):
        held = "held" if refusal.name == "attach" else "hand-free"
        other = next(objects_in(given.get("other")), "")
        if case.robot is not None and case.robot.name in (subject, other):  # attachments to other bodies don't matter
            yield from {(held, name) for name in (other, subject) if (held, name) in by_hands}
    elif is_mistake(case.failure.type):  # the state of the world doesn't matter here
        names = _variables_from(case, case.source.call_stack(refusal)) if _lacks_value(case) else []
        yield from [("result", ", ".join(names))] if names else []
    elif by_hands:
        return
    elif refusal.name in _POSES and (subject in case.mentioned or (is_robot and case.motion is not None)):
        yield "moved", subject
    elif refusal.name in _JOINTS:
        yield from _refused_joints(case, subject, refusal, given)
    elif refusal.name == "remove" and ("clear", subject) in lacks:
        yield "clear", subject


def _refused_joints(
    case: FailureCase, subject: str, refusal: Refusal, given: Mapping[str, Plain]
) -> Iterator[tuple[str, str]]:
    """Yield the joints that a refused request would have moved, if the failure depends on the joints."""
    names = set(_joints_meant(refusal, given))
    if case.robot is not None and subject == case.robot.name:
        parts = ["torso", "head"] if case.failure.type in _SEEN else ["torso"]
        touching = [arm for arm in case.hands if any(pair.get("mover") == subject for pair in case.pairs)]
        relevant = {joint for part in (*parts, *touching) for joint in joints_of(case.robot, part)}
        names = names & relevant if case.motion is not None else set()
    elif subject not in case.mentioned:
        names = {joint for joint in names for name in _perhaps_enclosed(case) if lies_in(case, name, subject, joint)}
    if names:
        yield "joint-moved", f"{', '.join(sorted(names))} of {subject}"


def _joints_meant(refusal: Refusal, given: Mapping[str, Plain]) -> Iterator[str]:
    """Yield the joints of a refused request. For a misspelt name, the first suggestion counts."""
    positions = given.get("positions")
    error = argument_values(refusal.failure.data) if refusal.failure.type == "UnknownName" else {}
    near = error.get("nearest")
    for name in (*(positions if isinstance(positions, dict) else ()), given.get("name")):
        if isinstance(name, str):
            yield str(near[0]) if isinstance(near, list) and near and name == error.get("name") else name


def _was_fulfilled_later(case: FailureCase, refusal: Refusal) -> bool:
    """Return whether the request was fulfilled later, or the object was moved in another way."""
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
        if refusal.name in ("attach", "detach") and command == f"{refusal.name}_body":
            grip = record.attach_body if command == "attach_body" else record.detach_body
            if {grip.carrier, grip.body} == {*objects_in(given.get("object")), *objects_in(given.get("other"))}:
                return True
    return False
