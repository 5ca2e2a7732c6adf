"""The target was out of reach, a body was in the way, or all candidates were rejected."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from recorder.records import Query, argument_values
from recorder.records.text import link_text, rejection_lines
from replay.explain.causes import trials
from replay.explain.causes.case import Cause, CausingChange, FailureCase, joints_of, since
from replay.explain.causes.changed import Misbelief, NoLonger
from replay.explain.causes.lacked import Swallowed, lies_in
from replay.explain.causes.physics import Physics
from replay.history.tasks import choices
from replay.report import phrases

if TYPE_CHECKING:
    from replay.explain.causes.trials import Trial

TOO_FAR: Final = 1.2  # distance from the robot's base at which no arm reaches anything, m
_MET: Final = re.compile(r"(?P<link>\S+) would touch (?P<body_link>\S+) of (?P<body>\S+)$")  # in NoPlace's message
_DEEPER: Final = (Physics, NoLonger, Misbelief, Swallowed)  # these causes explain the causes in this module


@dataclass(frozen=True, slots=True)
class ObstructingBody(Cause):
    """A body was in the way, or hid the object."""

    kind = "in-the-way"
    untestable = "no fork moves fixed furniture"
    explained_by = ("physics",)
    body: str
    link: str  # name of the link; "" if it is the only one, or unknown
    mover: str  # the link or held object that would have touched the body; "" for a body that hid an object
    change: CausingChange | None  # the change that moved the body to its place; None if there is none

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[ObstructingBody]:
        """Yield the bodies that the robot or a held object would have touched, and the bodies that hid an object."""
        if case.world is None:
            return
        obstacles = _MET.finditer(case.failure.message) if case.failure.type == "NoPlace" else ()
        for pair in (*case.pairs, *(each.groupdict() for each in obstacles)):
            body, link = pair.get("body", ""), pair.get("body_link", "")
            if body in case.world.bodies and body != case.world.robot:
                yield _obstacle(case, body, link, pair.get("link") or pair.get("mover", ""))
        touching = case.data.get("touching")  # the bodies at the new place of the object
        for met in touching if isinstance(touching, list) else []:
            body = str(met.get("body", "")) if isinstance(met, dict) else ""
            if case.free_body(body) is not None:
                yield _obstacle(case, body, "", ", ".join(case.subjects))
        reasons = case.data.get("reasons")
        if case.failure.type == "PerceptionError" and isinstance(reasons, dict):
            for name in case.mentioned:
                if name not in reasons and name != case.world.robot:
                    yield _obstacle(case, name, "", "")

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials in which the body isn't in the way, or the drawer with the hidden object is open."""
        if self.change is not None and self.change.how != "load":
            back = trials.put_back(case, self.change)
            yield from (replace(each, partial=bool(self.change.joint)) for each in back)
        yield from trials.away(case, self.body)
        for joint in case.joints_to(self.body, self.link)[:1]:
            yield from trials.opened(case, self.body, joint)
        owner = None if case.world is None or self.mover else case.world.bodies[self.body]
        for joint in owner.joints if owner is not None and owner.fixed_base else ():
            if any(lies_in(case, name, self.body, joint) for name in case.mentioned):  # a drawer hides what lies in it
                for end in trials.ends(case, self.body, joint)[:1]:
                    yield from trials.joint_at(case, self.body, joint, end)

    def _words(self) -> Iterator[str]:
        what = link_text(self.body, self.link)
        whose = f" of {self.mover}" if self.mover else " of the camera's view"
        verb = "loaded" if self.change is not None and self.change.how == "load" else ""
        yield f"{what} was in the way{whose}{since(self.change, verb)}"


@dataclass(frozen=True, slots=True)
class UnreachedTarget(Cause):
    """The arm can't reach the target from the robot's pose."""

    kind = "out-of-reach"
    arm: str
    body: str  # name of the target body; "" if the target isn't a body
    distance: float  # distance in m on the ground from the robot's base to the target
    miss: float | None  # distance in m between the target and the nearest posture that the arm reaches
    orientation: tuple[float, ...]  # requested orientation of the tool, xyzw; empty for every orientation
    changes: tuple[CausingChange, ...]  # the last changes of the robot, the robot's torso and the object

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[UnreachedTarget]:
        """Yield the distance of the target, and the last changes of the robot, its torso and the object."""
        if case.failure.type not in ("Unreachable", "HandleUnreachable") or case.robot is None or case.motion is None:
            return
        body = next((name for name in case.subjects if case.free_body(name) is not None), "")
        taken = body if case.motion.name == "pick-up" else ""
        target = case.data.get("target")
        if not isinstance(target, list) or len(target) != 3:
            return
        distance = math.dist([float(str(part)) for part in target[:2]], case.robot.position[:2])
        miss, turned = case.data.get("distance"), case.given.get("orientation")
        lift = joints_of(case.robot, "torso") if distance <= TOO_FAR else ()
        torso = (f"{case.robot.name}.{joint}" for joint in lift)
        changed = (case.changed(name) for name in (case.robot.name, taken, *torso) if name)
        changes = tuple(sorted((each for each in changed if each is not None), key=lambda change: change.step))
        arm = str(case.data.get("arm") or case.given.get("arm") or "")
        gap = float(miss) if isinstance(miss, int | float) else None
        orientation = tuple(float(str(part)) for part in turned) if isinstance(turned, list) else ()
        yield UnreachedTarget(case.steps(*changes), arm, taken, distance, gap, orientation, changes)

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether a change since an earlier success, or a swallowed failure, explains the distance."""
        return any(isinstance(each, _DEEPER) for each in found)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials with the robot nearer to the target, and without the last changes."""
        yield from trials.nearer(case, [float(str(each)) for each in case.data["target"]], self.miss or 0.0)  # type: ignore[union-attr]
        yield from _brought(case, self.body)
        for change in reversed(self.changes):
            yield from trials.put_back(case, change) if change.how != "load" else ()

    def _words(self) -> Iterator[str]:
        what = self.body or "the target"
        miss = f"; the {self.arm} arm misses it by {phrases.length(self.miss)}" if self.miss is not None else ""
        turned = " in the requested orientation" if self.orientation else ""
        yield f"{what} was {self.distance:.2f} m from the robot on the ground{miss}{turned}"
        yield from (change.row for change in self.changes)


@dataclass(frozen=True, slots=True)
class NoCandidate(Cause):
    """All candidates, such as grasps or postures, were rejected."""

    kind = "no-candidate"
    untestable = "no change of the world is known that gives the motion other candidates"
    asked: Query  # the choice, with its candidates and the reasons why they were rejected
    count: int  # number of candidates

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[NoCandidate]:
        """Yield the last choice of the failed motion, if all candidates were rejected."""
        if case.task is None or case.motion is None:
            return
        last = next(reversed(list(choices(case.log, case.task, case.step + 1))), None)
        if last is not None and last.chosen < 0:
            count = sum(each.count or len(each.names) for each in last.candidates)
            if count:
                yield NoCandidate(case.steps(last.seq), last, count)

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether another cause explains the choice. The failure's message explains a single candidate."""
        return len(found) > 1 if self.count == 1 else any(isinstance(each, _DEEPER) for each in found)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials without the free bodies that the candidates would touch, and with the robot nearer."""
        recorded = [argument_values(each.data).get("pairs") for each in self.asked.candidates]
        pairs = [pair for found in recorded if isinstance(found, list) for pair in found]
        touched = [str(pair.get("body", "")) for pair in pairs if isinstance(pair, dict)]
        reasons = [str(argument_values(each.data).get("reason") or "") for each in self.asked.candidates]
        bodies = case.world.bodies if case.world is not None else {}
        touched += [name for name in bodies if any(each.startswith(f"{name} is there") for each in reasons)]
        yield from trials.seen(case, case.task) if case.task is not None else ()
        for body in dict.fromkeys(touched):
            yield from trials.away(case, body)
        links = ((str(each.get("body")), str(each.get("body_link", ""))) for each in pairs if isinstance(each, dict))
        for body, link in {each: None for each in links if each[0] in bodies and bodies[each[0]] is not case.robot}:
            for joint in case.joints_to(body, link)[:1]:
                yield from trials.opened(case, body, joint)
        goal = case.data.get("target")
        misses = (argument_values(each.data).get("distance") for each in self.asked.candidates)
        known = [each for each in misses if isinstance(each, int | float)]
        if not touched and not known and case.motion is not None and case.motion.name == "place":
            yield from trials.given_back(case)
        if isinstance(goal, list) and known:
            yield from trials.nearer(case, [float(str(each)) for each in goal], min(known))
        yield from _brought(case, case.subjects[0]) if case.motion is not None and case.motion.name == "pick-up" else ()

    def _words(self) -> Iterator[str]:
        rejected = "its only candidate" if self.count == 1 else f"all {self.count} candidates"
        yield f"{phrases.question(self.asked)} rejected {rejected} at step {self.asked.seq}:"
        yield from rejection_lines(self.asked)


def _brought(case: FailureCase, body: str) -> Iterator[Trial]:
    """Yield the trials in which a body is where the plan wants it, near the robot."""
    robot = case.robot
    if robot is None or case.free_body(body) is None:
        return
    for place in trials.wanted(case, body, before=False):
        if math.dist(place[0][:2], robot.position[:2]) < TOO_FAR:
            yield replace(trials.arranged(case, {body: place}), succeeds=True, partial=True)


def _obstacle(case: FailureCase, body: str, link: str, mover: str) -> ObstructingBody:
    if case.free_body(body) is not None:
        change = case.changed(body) or case.loaded(body)
    else:
        change = next(filter(None, (case.changed(f"{body}.{joint}") for joint in case.joints_to(body, link))), None)
    return ObstructingBody(case.steps(change), body, link, mover, change)
