"""The world isn't as the plan needs it: an object was removed, a hand was in a wrong state, an answer is outdated.

The object may also be in another world, a container closed, gravity zero, or a fork may have changed the world.

If an answer or a perception contradicts the later failure, a fact has changed since then. Changes by physics
are explained in :mod:`replay.explain.causes.physics`.
"""

from __future__ import annotations

import builtins
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.records import Mutation, Query, Run, argument_values, from_json
from recorder.tasks import Node, State
from replay.explain.causes import trials
from replay.explain.causes.case import (
    Cause,
    CausingChange,
    FailureCase,
    about,
    bodies_in,
    joints_of,
    objects_in,
    result,
    since,
)
from replay.explain.causes.lacked import RefusedRequest, Swallowed, lacking
from replay.explain.causes.raised import answers
from replay.history.blame import commanded
from replay.report import phrases
from replay.state.fold import state_at
from replay.state.state import turn

if TYPE_CHECKING:
    from replay.explain.causes.trials import Trial

_REACH: Final = ("reachable", "reachable_object", "reachable_pose", "reachable_position")
#: Queries whose answer yes contradicts a failure. For queries in ``_NOTHING``, an empty answer contradicts the failure.
_YES: Final = {
    "Unreachable": _REACH,
    "HandleUnreachable": _REACH,
    "PerceptionError": ("visible",),
    "GraspFailed": ("stable",),
    "PlaceFailed": ("stable",),
}
_NOTHING: Final = {"Blocked": ("blocking",), "HandleBlocked": ("blocking",), "PerceptionError": ("occluding",)}
_MOVED: Final = (1e-3, 5e-3)  # change of a pose (m, rad) below which it is ignored
_LOADED: Final = ("load", "removed")  # changes that add or remove a body
_IN_HAND: Final = 0.05  # distance in m below which a motion of an object in a hand is an adjustment
_SEARCHED: Final = 5_000  # number of records before the failure that are searched
_BELIEVED: Final = frozenset(
    ("Blocked", "GraspFailed", "LookingFailed", "ObjectNotFound", "PerceptionError", "PlaceFailed", "Unreachable")
)
_AWAY: Final = 0.02  # error in m below which a belief isn't wrong
#: Matches the messages that WorldClosed has in all releases.
_GONE: Final = re.compile(r": object (.+) (?:is gone|was removed|has been removed|no longer exists)$")


@dataclass(frozen=True, slots=True)
class NoLonger(Cause):
    """An answer or a perception on which the plan relied is no longer true."""

    kind = "no-longer-true"
    asked: Query | Node  # the query with the outdated answer, or the task whose success is outdated
    changes: tuple[CausingChange, ...]  # changes since the answer

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[NoLonger]:
        """Yield the last outdated answer or perception, or the pick-up of an object that later moved in the hand."""
        yield from _moved_in_hand(case)
        asked: Query | Node | None = _contradicted_query(case)
        if asked is None and case.failure.type in ("Unreachable", "Blocked", "PerceptionError", "GraspFailed"):
            # the robot moved what it holds on purpose
            names = {each for each in case.subjects or case.mentioned if not case.holder(each, case.began)}
            done = [
                each for each in case.motions("detecting", "world-state-detecting") if each.status is State.SUCCEEDED
            ]
            asked = next((each for each in done if names.intersection(objects_in(result(each)))), None)
        if asked is None:
            return
        changes = tuple(sorted(_changes(case, asked), key=lambda change: change.step))
        if changes:
            seq = asked.seq if isinstance(asked, Query) else asked.last_step
            yield NoLonger(case.steps(seq, *changes), asked, changes)

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether wrong beliefs explain the outdated perception."""
        believed = {each.body for each in found if isinstance(each, Misbelief)}
        return isinstance(self.asked, Node) and believed.issuperset(change.body for change in self.changes)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial in which all changed bodies are as they were at the answer."""
        bodies = [each.body for each in self.changes if each.how not in _LOADED]
        yield from trials.restored(case, list(dict.fromkeys(bodies)), self.steps[0], self.changes[-1].step)
        for change in self.changes:
            if change.how in _LOADED:
                yield from trials.put_back(case, change)

    def _words(self) -> Iterator[str]:
        if isinstance(self.asked, Query):
            said = f"{phrases.question(self.asked)} was answered {phrases.answer(self.asked)} at step {self.asked.seq}"
        else:
            said = f"{phrases.node(self.asked)} succeeded at step {self.asked.last_step}"
        yield f"{said}; at step {self.steps[-1]} it was no longer true:"
        yield from (change.row for change in self.changes)


@dataclass(frozen=True, slots=True)
class Misbelief(Cause):
    """The robot's belief about an object was wrong."""

    kind = "misbelief"
    explained_by = ("physics",)
    body: str
    source: str  # "seen", "told" (read from the world's state), or "placed" (the robot released it there)
    learned: int  # step at which the robot learned the belief; -1 before the recording
    position: tuple[float, ...]  # position in the belief, m
    distance: float  # distance between the belief and the object, m
    change: CausingChange | None  # last change of the object since the belief; None if it isn't known

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Misbelief]:
        """Yield the wrong beliefs about objects of the failure when the failed motion began."""
        world = case.before
        if case.failure.type not in _BELIEVED or world is None:
            return
        sought = case.data.get("object_type")
        names = {*case.mentioned, *(body.name for body in world.bodies.values() if body.type == sought)}
        for belief in world.believed(robot=world.robot):
            body = world.bodies[belief.object]
            away = math.dist(belief.position, body.position)
            if belief.object not in names or away < _AWAY:
                continue
            moved = case.changed(belief.object)
            change = moved if moved is not None and moved.step > belief.step else None
            steps = case.steps(belief.step if belief.step >= 0 else None, change)
            yield Misbelief(steps, belief.object, belief.source, belief.step, belief.position, away, change)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials in which the object is where the robot believed it to be."""
        yield trials.arranged(case, {self.body: (self.position, "where it was believed")})
        if self.change is not None:
            yield from trials.put_back(case, self.change)

    def _words(self) -> Iterator[str]:
        moved = f"at step {self.change.step} {self.change}; " if self.change is not None else ""
        was = f"at step {self.steps[-1]} it was {phrases.length(self.distance)} away from that position"
        at = phrases.vector(self.position)
        yield f"{self.body} was believed at {at}, {phrases.learned(self.source, self.learned)}; {moved}{was}"


@dataclass(frozen=True, slots=True)
class Gone(Cause):
    """The object that the plan used, or the last object of the requested type, had been removed."""

    kind = "removed"
    body: str
    change: CausingChange  # the record that removed the object
    loaded: CausingChange | None = None  # the record that later loaded another object with the same name

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Gone]:
        """Yield the removal of the object that the plan used, or of the last object of the requested type."""
        name, removal = _removal(case)
        if removal is None:
            return
        removed = case.change(removal, name, "removed")
        later = case.log.records(Mutation, removal.seq + 1, case.step)
        again = (each for each in later if each.HasField("load_body") and each.world == removal.world)
        reloaded = next((each for each in again if each.load_body.body == name), None)
        loaded = case.change(reloaded, name, "load") if reloaded is not None else None
        yield Gone(case.steps(removed, loaded), name, removed, loaded)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials in which the object stays, or the motion uses the object that was loaded later."""
        if self.loaded is None:
            yield from trials.put_back(case, self.change)
        elif case.holder(self.body, self.change.step - 1):
            for trial in trials.in_hand(case, self.body, str(case.given.get("arm") or "")):
                yield from (replace(trial, answers=each.answers) for each in trials.replaced(case, "object", self.body))
        elif case.motion is not None and self.body in objects_in(case.motion.parameters.get("object")):
            yield from trials.replaced(case, "object", self.body)

    def _words(self) -> Iterator[str]:
        yield f"{self.body} had been removed at step {self.change.step}{self.change.originator}"
        if self.loaded is not None:
            yield f"step {self.loaded.step}: another {self.loaded}"


@dataclass(frozen=True, slots=True)
class HandState(Cause):
    """A hand didn't hold its object, or held an object although it should have been empty."""

    kind = "hand-state"
    precondition: str  # "held": the arm should have held the object; "hand-free": it should not have held the object
    body: str
    arm: str  # the arm of the failed motion
    holder: str  # the object's holder at the failure: an arm, or ``CARRIER (LINK)``; "" if there is none
    change: CausingChange | None  # change that led to this state; None without a change

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[HandState]:
        """Yield the cause if a hand didn't hold the motion's object, or still held another object."""
        arm = str(case.given.get("arm") or "")
        for lack in lacking(case):
            if lack.precondition not in ("held", "hand-free") or (lack.precondition == "hand-free" and case.pairs):
                continue
            holder = case.holder(lack.subject)
            change = _last_grip(case, lack.subject, attached=bool(holder) or lack.precondition == "hand-free")
            yield HandState(case.steps(change), lack.precondition, lack.subject, arm, holder, change)

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether a removal of the object, or an earlier failure or refusal, explains the state."""
        lacked = [(each.precondition, each.subject) for each in found if isinstance(each, Swallowed | RefusedRequest)]
        removed = [each.body for each in found if isinstance(each, Gone)]
        return self.body in removed or (self.precondition, self.body) in lacked

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial with the hand in the required state."""
        if self.precondition == "held":
            yield from trials.in_hand(case, self.body, self.arm)
        else:
            yield from trials.freed(case, self.body)

    def _words(self) -> Iterator[str]:
        step = f"at step {self.steps[-1]}"
        if self.precondition == "hand-free":
            hand = f"the {self.holder} gripper" if " (" not in self.holder else self.holder
            yield f"{hand} held {self.body} {step}{since(self.change, 'taken')}"
            return
        end = since(self.change, "released") if self.change is not None else ": no hand had taken it"
        if self.holder:
            hand = f"the {self.holder} gripper" if " " not in self.holder else self.holder
            end = f": {hand} did{since(self.change, 'taken')}"
        yield f"the {self.arm} gripper didn't hold {self.body} {step}{end}"


def _contradicted_query(case: FailureCase) -> Query | None:
    """Return the last query whose answer contradicts the failure, or made the plan raise it."""
    judged = [each for each in answers(case) if isinstance(each, Query)] if case.motion is None else []
    no = next((query for query in reversed(judged) if from_json(query.answer_json) is False), None)
    question = _question(no) if no is not None else None
    yes, nothing = _YES.get(case.failure.type, ()), _NOTHING.get(case.failure.type, ())
    start = no.seq if no is not None else case.began
    for query in islice(case.log.backwards(start - 1, Query), _SEARCHED):
        answer = from_json(query.answer_json)
        if question is not None:
            if _question(query) == question:
                return query if answer is True else None
            continue
        about = set(objects_in(list(argument_values(query.arguments).values())))
        wanted = set(case.subjects or case.mentioned) - {case.world.robot if case.world is not None else ""}
        if not about & wanted or (query.name in yes and answer is False):
            continue
        if (query.name in yes and answer is True) or (query.name in nothing and answer == []):
            return query
    return None


def _question(query: Query) -> tuple[object, ...]:
    return (query.name, query.world, *((each.name, each.json) for each in query.arguments))


def _changes(case: FailureCase, asked: Query | Node) -> Iterator[CausingChange]:
    """Yield those changes since an answer that affect the answer."""
    step = asked.seq if isinstance(asked, Query) else asked.last_step
    then = state_at(case.log, step).worlds.get(case.world.name) if case.world is not None else None
    if then is None or case.world is None:
        return
    named = isinstance(asked, Query)
    given = list(argument_values(asked.arguments).values()) if isinstance(asked, Query) else result(asked)
    obstacles = [pair.get("body", "") for pair in case.pairs]
    hiders = case.mentioned if case.failure.type == "PerceptionError" else ()
    robot = case.world.robot
    for name in dict.fromkeys((*objects_in(given), *obstacles, *hiders, *([robot] if named else []))):
        before, after = then.bodies.get(name), case.world.bodies.get(name)
        if after is None:
            continue
        moved = before is None or math.dist(before.position, after.position) > _MOVED[0]
        if not moved and before is not None and turn(before.orientation, after.orientation) <= _MOVED[1]:
            continue
        removal = removal_of(case, name, step) if before is not None else None
        if removal is not None:  # another body now has this name
            yield case.change(removal, name, "removed")
        yield from _last_change(case, name, step)
    before, after = then.bodies.get(robot), case.world.bodies.get(robot)
    if named and isinstance(asked, Query) and before is not None and after is not None:
        # only some queries depend on the head's posture
        head = joints_of(after, "head") if asked.name in ("visible", "occluding") else ()
        for joint in (*joints_of(after, "torso"), *head):
            if abs(before.joints.get(joint, 0.0) - after.joints.get(joint, 0.0)) > _MOVED[1]:
                change = case.blame(f"{robot}.{joint}")
                if change is not None and change.record.seq > step:
                    yield case.blamed(change)


def _last_change(case: FailureCase, name: str, step: int) -> Iterator[CausingChange]:
    change = case.blame(name)
    if change is not None and change.how == "physics" and change.earlier is not None:
        change = change.earlier  # changes by physics belong to another kind of cause
    if change is not None and change.record.seq > step and change.how not in ("physics", "before"):
        yield case.blamed(change)


def _moved_in_hand(case: FailureCase) -> Iterator[NoLonger]:
    """Yield the pick-ups of held objects that the plan later moved away from the hand."""
    if case.motion is None or case.before is None or case.robot is None:
        return
    moved = {pair.get("mover") for pair in case.pairs} | set(case.subjects if case.motion.name == "place" else ())
    for held in case.before.carried(case.robot.name):
        if held.body not in moved:
            continue
        grasp = next((each for each in case.motions("pick-up") if about(each, body=held.body)), None)
        if grasp is not None and not grasp.failed:
            changes = tuple(_commanded_moves(case, held.body, grasp.last_step))
            yield from [NoLonger(case.steps(grasp.last_step, *changes), grasp, changes)] if changes else []


def _commanded_moves(case: FailureCase, name: str, start: int) -> Iterator[CausingChange]:
    for record in case.log.records(Mutation, start + 1, case.began):
        if not record.HasField("move_body") or record.move_body.body != name or not case.is_here(record):
            continue
        states = (state_at(case.log, step) for step in (record.seq - 1, record.seq))
        before, after = (state.worlds[record.world].bodies[name] for state in states)
        distance = math.dist(before.position, after.position)
        if distance > _IN_HAND:
            yield case.change(record, name, "in-hand", size=(distance, turn(before.orientation, after.orientation)))


def _removal(case: FailureCase) -> tuple[str, Mutation | None]:
    """Return the name of the failure's object, and the record that removed the object.

    If a hand should have held the object, its removal counts only if a hand held it.
    """
    kind, sought = case.failure.type, case.data.get("name")
    for lack in lacking(case):
        removal = removal_of(case, lack.subject) if lack.precondition == "held" else None
        if removal is not None and case.holder(lack.subject, removal.seq - 1):
            return lack.subject, removal
    used = _GONE.search(case.failure.message) if kind == "WorldClosed" else None
    if used is not None:
        return used[1], removal_of(case, used[1])
    if kind == "UnknownName" and case.data.get("kind") == "object" and isinstance(sought, str):
        return sought, removal_of(case, sought)
    wanted = case.data.get("object_type")
    there = {body.type for body in case.world.bodies.values()} if case.world is not None else ()
    if kind == "PerceptionError" and isinstance(wanted, str) and wanted not in there:
        return _removal_of_type(case, wanted)
    return "", None


def removal_of(case: FailureCase, name: str, start: int = 0) -> Mutation | None:
    """Return the last record from a step on that removed an object; None if there is none."""
    for record in case.log.backwards(case.step, Mutation, naming=name):
        if record.seq < start:
            break
        if name in record.effect.removed and case.is_here(record):
            return record
    return None


def _removal_of_type(case: FailureCase, object_type: str) -> tuple[str, Mutation | None]:
    for record in islice(case.log.backwards(case.step, Mutation), _SEARCHED):
        if not record.HasField("remove_body") or not case.is_here(record):
            continue
        body = state_at(case.log, record.seq - 1).worlds[record.world].bodies.get(record.remove_body.body)
        if body is not None and body.type == object_type:
            return body.name, record
    return "", None


def _last_grip(case: FailureCase, body: str, *, attached: bool) -> CausingChange | None:
    for record in case.log.backwards(case.step, Mutation, naming=body):
        made = [each.body for each in record.effect.attached] if record.HasField("attach_body") else []
        undone = [each.body for each in record.effect.detached]
        if body in (made if attached else undone):
            return case.change(record, body, "attached" if attached else "detached")
        if record.HasField("load_body") and record.load_body.body == body:
            break
    return None


_FORKED: Final = 10  # maximum number of changes that a fork makes at a step
#: Matches messages about objects that move, hang or lack support.
_OF_GRAVITY: Final = re.compile(r"\bmoves at|\bhangs?\b|\bin the air\b|\bsupport|\brest\b|\bfall")


@dataclass(frozen=True, slots=True)
class OtherWorld(Cause):
    """An object of the failure is only in another world."""

    kind = "other-world"
    body: str
    world: str  # the object's world
    needed: str  # the world of the failure
    change: CausingChange | None  # the loading of the object; None if it isn't recorded
    opened: CausingChange | None  # the record that opened the object's world

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[OtherWorld]:
        """Yield the objects that the failure names, or of the type that it seeks, if they are only in another world."""
        if case.world is None:
            return
        needed, wanted = case.world, case.data.get("object_type")
        here = {body.type for body in needed.bodies.values()}
        used = {name for name, world in bodies_in(list(case.given.values())) if world != needed.name}
        named = {case.data.get("name"), *re.findall(r"[\w-]+(?:\.[\w-]+)*", case.failure.message)}
        for other in case.state.worlds.values():
            for body in other.bodies.values() if other.open and other.name != needed.name else ():
                sought = body.type == wanted and wanted not in here
                if body.name in used or ((body.name in named or sought) and body.name not in needed.bodies):
                    load = _last(case, other.name, "load_body", body.name)
                    opened = _last(case, other.name, "open_world")
                    yield OtherWorld(case.steps(load, opened), body.name, other.name, needed.name, load, opened)

    def _words(self) -> Iterator[str]:
        loaded = since(self.change, "loaded")
        yield f"{self.body} is in {self.world}{loaded}; it isn't in {self.needed}"
        if self.opened is not None:
            yield f"step {self.opened.step}: {self.world} was opened{self.opened.originator}"


@dataclass(frozen=True, slots=True)
class NoGravity(Cause):
    """Gravity is zero or points upwards, and the failure is about objects that move, hang or lack support."""

    kind = "gravity"
    gravity: tuple[float, ...]  # in m/s^2
    change: CausingChange | None  # the record that set the gravity; None if the plan never set it

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[NoGravity]:
        """Yield an unusual gravity of the failure's world."""
        if case.world is None or case.world.gravity[2] < 0:
            return
        of_python = hasattr(builtins, case.failure.type)  # "not supported between" doesn't concern gravity
        if case.world.gravity[2] > 0 or (not of_python and _OF_GRAVITY.search(case.failure.message)):
            change = _last(case, case.world.name, "set_gravity")
            yield NoGravity(case.steps(change), tuple(case.world.gravity), change)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial with the earth's gravity, from the first change of the world that could set it."""
        yield from trials.downwards(case, self.steps[0] if self.change is not None else case.began - 1)

    def _words(self) -> Iterator[str]:
        how = since(self.change) if self.change is not None else ": the plan never set it"
        yield f"gravity is {phrases.vector(self.gravity)} m/s^2{how}"


@dataclass(frozen=True, slots=True)
class ForkedChange(Cause):
    """The fork, not the plan, had changed an object."""

    kind = "fork"
    change: CausingChange

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[ForkedChange]:
        """Yield the changes that the fork made."""
        began = case.log[0]
        steps = sorted({each.step for each in began.origin.changes} if isinstance(began, Run) else ())
        for record in (each for step in steps for each in case.log.records(Mutation, step + 1, step + 1 + _FORKED)):
            if record.by_fork and record.seq < case.step and case.is_here(record) and commanded(record):
                yield ForkedChange(case.steps(record.seq), case.change(record, commanded(record), "command"))

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial without the change."""
        yield from trials.put_back(case, self.change)

    def _words(self) -> Iterator[str]:
        yield f"step {self.change.step}: {self.change}, not by the plan"


def _last(case: FailureCase, world: str, command: str, body: str = "") -> CausingChange | None:
    """Return the last command of a kind in a world; it is about a body or the world itself."""
    for record in case.log.backwards(case.step, Mutation):
        if (record.world, record.WhichOneof("command")) == (world, command) and body in ("", record.load_body.body):
            return case.change(record, body or world, "gravity" if command == "set_gravity" else "load")
    return None
