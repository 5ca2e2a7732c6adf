"""Changes of a forked run after a step: new values of objects and fluents, answers of queries, or the seed.

Each change is a text, on the command line and in the fork's recording: ``milk.position=1,2,0.9``,
``reachable_object(milk)=false``. A fork can therefore run again like any other run.
"""

from __future__ import annotations

import gc
import inspect
import json
import math
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextvars import Context
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NoReturn

from pycram import bullet_world_reasoning as btr
from pycram.fluents.expressions import Variable
from pycram.fluents.fluent import Fluent
from pycram.foundation.failures import PycramError
from pycram.foundation.forcing import SKIPPED
from pycram.reasoning.choosing import Question as Asked
from pycram.reasoning.grasping.fingers import close_around
from pycram.reasoning.grasping.grasps import candidates
from pycram.reasoning.queries.query import RECORDED_AS, Found, Verdict
from pycram.scheduling.schedule import is_held
from pycram.world.attachment import attached_to
from pycram.world.object import Object
from pycram.world.world import BulletWorld, open_worlds
from recorder import geometry, records
from recorder.records import Change, LoadBody, Mutation, Plain, Query, Record, from_json
from recorder.tracing import interrupts, journal
from recorder.tracing.forking import process
from replay.errors import NoSuchName
from replay.report.question import BadQuestion, Name, QueryCall, Term, parse, unquoted
from replay.restore.recorded_world import description_of
from replay.retrace.decisions import BadChange, ForcedDecision, is_same, on_record, parse_decision, text_of
from replay.state.fold import state_at

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader
    from replay.retrace.guide import Guide

_COUNTS: Final = {"position": (3, 7), "orientation": (4,), "color": (4,), "gravity": (3,)}
_EXPECTED: Final = (
    "OBJECT.position=X,Y,Z (m, or these and a quaternion x,y,z,w), OBJECT.orientation=X,Y,Z,W, OBJECT.color=R,G,B,A, "
    "OBJECT.JOINT=VALUE (rad or m), OBJECT.hand=ARM (or none), gravity=X,Y,Z (m/s^2) or FLUENT=VALUE"
)
_HAND, _GRAVITY = "hand", "gravity"
_FLUENT: Final = "fluent:"  # prefix for fluents with a name like OBJECT.QUANTITY
_ANY: Final = re.compile(r"([(,])\s*\.\.\.\s*\)$")  # an ellipsis, which stands for all further arguments
_OF_MANY: Final = "Found[Verdict]"
_OBJECTS: Final = ("object", "object1", "object2", "robot", "pose")  # arguments that are names of objects
_PARTS: Final = ("gripper", "camera")  # arguments that are names of arms or links
_OURS: Final = "pycram.reasoning.queries."

ANSWERABLE: Final = tuple(name for name in btr.__all__ if hasattr(getattr(btr, name), "__wrapped__"))
"""Recorded names of the queries."""

_ANSWERS: Final = {
    "Verdict": "true or false",
    "Found[Object]": "a list of objects, such as [milk, bowl] or []",
    _OF_MANY: "a list with true or false for each target",
}

# --- settings and the seed --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Setting:
    """A value for a quantity of an object, or for a fluent."""

    text: str  # text of the setting, as the user wrote it
    name: str  # name of the object or fluent; "" for gravity
    quantity: str  # "position", "orientation", "color", "hand" or a joint of the object; "gravity"; "" for a fluent
    value: Any  # list of numbers for an object; name of the arm, or "none", for a hand; any value for a fluent

    def make(self, world: str) -> None:
        """Set the value in a world of this process.

        Raises:
            BadChange: There is no such world or fluent.
            PycramError: The setter rejects the value.
        """
        if not self.quantity:
            self._fluent().set_value(self.value)
            return
        opened = next((each for each in open_worlds() if each.name == world), None)
        if opened is None:
            raise BadChange(self.text, f"the world {world} isn't open at that moment")
        if self.quantity == _GRAVITY:
            opened.set_gravity(self.value)
            return
        body = object_of(opened, self.name)
        if self.quantity == _HAND:
            hold(body, self.value)
        elif self.quantity == "position":
            body.set_position(self.value[:3], self.value[3:] or None)
        elif self.quantity in _COUNTS:
            getattr(body, f"set_{self.quantity}")(self.value)
        else:
            body.set_joint_position(self.quantity, *self.value)

    def _fluent(self) -> Fluent:
        """Return the fluent with this name. Only the plan refers to its fluents, so all Python objects are searched."""
        named: dict[Variable, Fluent] = {}
        for each in gc.get_objects():
            if issubclass(type(each), Fluent):  # isinstance() would call proxies
                expression = getattr(each, "expression", None)  # the constructor of the fluent may still be running
                if isinstance(expression, Variable) and not expression.source:
                    named[expression] = each
        found = [each for expression, each in named.items() if expression.text() == self.name]
        if not found:
            names = sorted({expression.text() for expression in named})
            others = f"the plan has {', '.join(names)}" if names else "no fluent can be set"
            raise BadChange(self.text, f"there is no fluent {self.name} at that moment; {others}")
        if len(found) > 1:
            raise BadChange(self.text, f"{len(found)} fluents have the name {self.name}")
        return found[0]


def settings(log: RecordReader, step: int, texts: Iterable[str], world: str | None = None) -> list[Change]:
    """Return settings, such as ``milk.position=1,2,0.9``, as changes after a step. The default world was opened last.

    Raises:
        BadChange: A setting has a wrong form.
        NoSuchName: There is no such world, object or joint at the step.
    """
    changes = []
    if world is not None:
        state_at(log, step).world(world)  # names are checked even if there are no settings
    for text in texts:
        setting = parse_setting(text, fluent=_is_of_fluent(log, text))
        there = state_at(log, step).world(world) if setting.quantity else None
        if there is not None and setting.quantity != _GRAVITY:
            is_robot = setting.name == "robot" and "robot" not in there.bodies
            if is_robot and not there.robot:
                raise BadChange(text, f"{there.name} has no robot at step {step}")
            body = there.body(there.robot if is_robot else setting.name)
            if setting.quantity not in (*_COUNTS, _HAND) and setting.quantity not in body.joints:
                raise NoSuchName(f"position, orientation, color or joint of {body.name}", setting.quantity, body.joints)
        changes.append(Change(step=step, set=text, world=there.name if there is not None else ""))
    return changes


def _is_of_fluent(log: RecordReader, text: str) -> bool:
    """Return whether a setting is for a fluent. A fluent's name may look like OBJECT.QUANTITY."""
    quoted, rest = unquoted(text)
    name = text.partition("=")[0].strip()
    if quoted:
        return not rest.startswith(".")
    recorded = any(record.name == name for record in log.records(records.Fluent))
    return recorded or name.startswith(_FLUENT) or ("." not in name and name != _GRAVITY)


def parse_setting(text: str, *, fluent: bool) -> Setting:
    """Parse ``milk.position=1,2,0.9``, ``pr2.torso_lift_joint=0.2`` or (for a fluent) ``battery=20``.

    For a fluent that isn't recorded and has a dot in its name, write ``fluent:left.battery=20``. Any name can be in
    quotes: ``'milk carton'.position=1,2,0.9``. For a text of another form, raise BadChange.
    """
    quoted, rest = unquoted(text)
    left, _, right = (part.strip() for part in rest.partition("="))
    if quoted:
        name, quantity = quoted, left.removeprefix(".").strip()
    else:
        name, _, quantity = (left.removeprefix(_FLUENT), "", "") if fluent else left.rpartition(".")
    if not right or not (name if fluent else quantity and (name or quantity == _GRAVITY)):
        raise BadChange(text, f"expected {_EXPECTED}")
    if fluent:
        try:
            return Setting(text, name, "", json.loads(right))
        except ValueError:
            return Setting(text, name, "", right)
    if quantity == _HAND:
        return Setting(text, name, quantity, right)
    try:
        numbers = [float(part) for part in right.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in _COUNTS.get(quantity, (1,)) or not all(map(math.isfinite, numbers)):
        raise BadChange(text, f"expected {_EXPECTED}")
    return Setting(text, name, quantity, numbers)


def hold(body: Object, arm: str) -> None:
    """Put an object into the closed hand of its world's robot, or take it out of all hands (``none``)."""
    for held in [each for each in body.attachments.values() if each.body is body]:
        held.carrier.detach(body)
    robot = body.world.robot
    if arm == "none":
        return
    if robot is None or robot.description is None:
        raise BadChange(f"{body.name}.{_HAND}={arm}", f"{body.world.name} has no robot with a description")
    part = robot.description.arm(arm)
    holds = attached_to(robot, part.tool_frame)
    if holds is not None:
        release = f"{holds.name}.{_HAND}=none"
        raise BadChange(f"{body.name}.{_HAND}={arm}", f"the hand holds {holds.name}; before it, set {release}")
    tool = part.tool_pose(robot.get_link_position_and_orientation(part.tool_frame))
    stood = body.get_position_and_orientation()
    for grasp in candidates(body, robot, part):
        moved = geometry.multiply(tool, geometry.invert((grasp.position, grasp.orientation)))
        body.set_position_and_orientation(*geometry.multiply(moved, stood))
        closed = close_around(robot, part, {}, body)
        if closed is not None and closed.sides == 2:
            robot.set_joint_positions(closed.positions)
            robot.attach(body, part.tool_frame)
            return
    raise BadChange(f"{body.name}.{_HAND}={arm}", f"{body.name} doesn't fit into this hand")


def change_text(change: Change) -> str:
    """Return the text of a change."""
    return change.set or change.answer or f"seed {change.seed}"


def object_of(world: BulletWorld, name: str) -> Object:
    """Return an object of a world by name. If no object is called ``robot``, this name means the robot."""
    if name == "robot" and world.robot is not None and not world.get_objects_by_name(name):
        return world.robot
    return world.get_object(name)


# --- answers ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GivenAnswer:
    """An answer for the next matching query."""

    text: str  # text of the answer, as the user wrote it
    query: str  # name of the query
    arguments: Mapping[str, Term]  # arguments that the query must have, by recorded name
    answer: Term  # the answer: true or false, names of objects, or an answer for each target

    def fits(self, name: str, arguments: Mapping[str, object]) -> bool:
        """Return whether the answer is for this query."""
        wanted = self.arguments.items()
        return name == self.query and all(key in arguments and is_same(term, arguments[key]) for key, term in wanted)

    def replace(self, own: Any, world: BulletWorld) -> Any:
        """Return the answer with the evidence of the query's own answer; raise BadChange if the lengths differ."""

        def with_evidence(kind: Callable[..., Any], value: Any, of: Any) -> Any:
            return kind(value, of.evidence, of.picture, of.considered)

        if not isinstance(self.answer, list):
            return with_evidence(Verdict, self.answer, own)
        if _kind(self.query) != _OF_MANY:
            return with_evidence(Found, [object_of(world, text_of(term)) for term in self.answer], own)
        if len(self.answer) != len(own):
            raise BadChange(self.text, f"the query has {len(own)} answers, not {len(self.answer)}")
        items = [with_evidence(Verdict, term, each) for term, each in zip(self.answer, own, strict=True)]
        return with_evidence(Found, items, own)


def parse_answer(text: str) -> GivenAnswer | ForcedDecision:
    """Parse ``reachable_object(milk)=false``, ``blocking(...)=[bowl]``. Only the given arguments must match.

    :mod:`replay.retrace.decisions` parses decisions that aren't queries, such as ``grasp(milk)=top``.

    Raises:
        BadChange: The text has a wrong form, or the query can't have this answer.
        NoSuchName: There is no such query.
    """
    left, equals, right = text.rpartition("=")
    if text.partition("(")[0].strip() not in ANSWERABLE or right.strip() == SKIPPED:
        return parse_decision(text)
    try:
        asked = parse(_ANY.sub(lambda match: f"{match[1].rstrip(',')})", left.strip()))
        given = parse(f"answer({right})").arguments if equals and right.strip() else ()
    except BadQuestion as error:
        raise BadChange(text, f"expected QUERY(ARGUMENTS)=ANSWER, such as stable(milk)=false: {error.cause}") from None
    kind, answer = _kind(asked.query), given[0] if len(given) == 1 else None
    wanted: Any = bool if kind == _OF_MANY else (Name, str)
    listed = isinstance(answer, list) and all(isinstance(each, wanted) for each in answer)
    if answer is None or not (isinstance(answer, bool) if kind == "Verdict" else listed):
        raise BadChange(text, f"its answer is {_ANSWERS[kind]}")
    return GivenAnswer(text, asked.query, _bound(asked, text), answer)


def checked_answer(log: RecordReader, step: int, text: str) -> str:
    """Return the text of an answer after a step. The recording must contain the decision and all names.

    Raises:
        BadChange: The text has a wrong form, or the decision can't have this answer.
        NoSuchName: The recording has no such object, arm, link or decision.
    """
    given = parse_answer(text)
    if isinstance(given, ForcedDecision):
        return on_record(log, step, given, ANSWERABLE)
    loaded = {each.load_body.body: each.load_body for each in log.records(Mutation) if each.HasField("load_body")}
    loaded |= {each.body: each for keyframe in log.records(records.Keyframe) for each in keyframe.loaded}
    answer = given.answer if isinstance(given.answer, list) else []
    terms = [(each, given.arguments.get(each)) for each in (*_OBJECTS, *_PARTS)]
    for argument, term in [*terms, *((_OBJECTS[0], each) for each in answer if not isinstance(each, bool))]:
        if isinstance(term, Name | str):
            known = [*loaded, "robot"] if argument in _OBJECTS else [*_parts(log, loaded.values())]
            if text_of(term) not in known:
                raise NoSuchName(argument.rstrip("12"), text_of(term), known)
    return text


def _parts(log: RecordReader, loaded: Iterable[LoadBody]) -> Iterator[str]:
    """Yield the arms and links of all robots."""
    for robot in loaded:
        description = description_of(robot.robot_description)
        if description is not None:
            yield from description.arms
            yield from log.assets.urdf(f"{robot.assets[0].sha256}/{robot.assets[0].path}").links


def _bound(asked: QueryCall, text: str) -> dict[str, Term]:
    """Return the arguments of a question, by recorded name."""
    parameters = {recorded: parameter for parameter, recorded in RECORDED_AS.items()}
    keywords = {parameters.get(name, name): term for name, term in asked.keywords.items()}
    try:
        bound = inspect.signature(getattr(btr, asked.query)).bind_partial(*asked.arguments, **keywords)
    except TypeError as error:
        raise BadChange(text, str(error)) from None
    return {RECORDED_AS.get(name, name): term for name, term in bound.arguments.items() if name != "world"}


def _kind(query: str) -> str:
    return str(inspect.signature(getattr(btr, query)).return_annotation)


# --- while the plan runs ----------------------------------------------------------------------------------------------


class PendingChanges:
    """Changes of a fork; each is made after its step, in the process of the plan.

    A step is recorded within the operation that it describes. A change therefore waits until the main thread has no
    uninterruptible section, no lock and no deferred calls. Between the operation and the change, the plan can't read
    the world. Changes are made outside of tasks, by the same setters that plans call. The records of changes name the
    fork.

    ``answers`` receives the changes that are answers. ``make`` makes other changes. For an impossible change,
    ``refuse`` is called with the error, and doesn't return.
    """

    def __init__(
        self,
        changes: Sequence[Change],
        answers: AnswerOracle,
        make: Callable[[Change], None],
        refuse: Callable[[Exception], NoReturn],
    ) -> None:
        self._changes, self._answers, self._make, self._refuse = changes, answers, make, refuse
        self._process = process()
        self._making = False
        self._done: Callable[[], None] | None = None
        self.due: list[Change] = []  # due changes

    def passed(self, step: int, done: Callable[[], None]) -> None:
        """Make the changes after a step as soon as possible, then call ``done``."""
        changes = [each for each in self._changes if each.step == step]
        self._answers.given += [parse_answer(each.answer) for each in changes if each.answer]
        self.due += [each for each in changes if not each.answer]
        if not self.due:
            done()
            return
        self._done = done
        interrupts.call_soon(self._try)

    def complete(self, record: Record) -> None:
        """Add the name of the fork to a record of a change."""
        if isinstance(record, Query):
            self._answers.complete(record)
        elif self._making and isinstance(record, Mutation | records.Fluent) and not record.task and not record.cause:
            is_set = isinstance(record, Mutation) or not record.source  # other fluents follow the world
            record.by_fork = is_set and threading.current_thread() is threading.main_thread()

    def _try(self) -> bool:
        """Make the due changes if possible, and return whether all are made."""
        if process() != self._process:  # a projection ends before any change is made
            return True
        if is_held():
            world = next((each for each in open_worlds() if each.lock.is_mine), None)
            if world is not None:
                world.lock.defer([self._try_again])
            return world is not None
        if not journal.recording():
            return False
        due, self.due = self.due, []
        self._making = True
        try:
            for change in due:
                Context().run(self._make, change)
        except Exception as error:  # noqa: BLE001  the setter or the plan's event handlers may raise any error
            self._refuse(error)
        finally:
            self._making = False
        if self._done is not None:
            self._done()
        return True

    def _try_again(self) -> None:
        if not self._try():
            interrupts.call_soon(self._try)


class AnswerOracle:
    """Answers queries with the fork's own answers, or with the recorded answers (``taken``).

    A recorded answer is used only if the next recorded query is the same, at the same moment, without other records in
    between. Three kinds of queries are always asked: failed queries, queries about many targets (evidence of their
    single answers isn't recorded), and queries that the plan defines. For an impossible answer, ``refuse`` is called
    with the error, and doesn't return.
    """

    def __init__(self, guide: Guide, *, taken: bool, refuse: Callable[[Exception], NoReturn]) -> None:
        self._guide, self._takes, self._refuse = guide, taken, refuse
        self._process = process()
        self._beside: dict[int, Query] = {}  # fields to add to the record of a query, by thread
        self.taken = 0  # number of recorded answers that were used
        self.given: list[GivenAnswer | ForcedDecision] = []  # forced values for the next matching decisions

    def __call__(
        self, question: Asked, world: BulletWorld, function: Callable[..., Any], ask: Callable[[], Any]
    ) -> Any:
        """Answer a query (:class:`pycram.reasoning.queries.query.Oracle`)."""
        if process() != self._process or not function.__module__.startswith(_OURS):
            return ask()
        recorded = self._guide.upcoming() if self._takes else None
        if isinstance(recorded, Query) and _answers(recorded, question, world):
            self._beside[threading.get_ident()] = recorded
            self.taken += 1
            answer = _live(from_json(recorded.answer_json), world)
            evidence = {each.name: _live(from_json(each.json), world) for each in recorded.evidence}
            picture = recorded.picture if recorded.HasField("picture") else None
            return Found(answer, evidence, picture) if isinstance(answer, list) else Verdict(answer, evidence, picture)
        own = ask()
        for given in self.given:
            if isinstance(given, GivenAnswer) and given.fits(question.name, question.arguments):
                self.given.remove(given)
                self._beside[threading.get_ident()] = Query(by_fork=True, own_answer_json=records.to_json(own))
                try:
                    return given.replace(own, world)
                except (BadChange, PycramError) as error:
                    self._refuse(error)
        return own

    def decide(self, decision: str, arguments: Mapping[str, Any]) -> Any:
        """Return the forced value of a decision (:class:`pycram.foundation.forcing.Decider`)."""
        if process() != self._process:
            return None
        kind, _, name = decision.partition(" ")
        for given in self.given:
            if isinstance(given, ForcedDecision) and given.fits(kind, name, arguments):
                value = given.decide(kind, arguments)
                if value is not None and kind != "order":
                    self.given.remove(given)
                given.used |= value is not None
                return value
        return None

    def missing(self, decision: str, candidate: str, candidates: Sequence[str]) -> None:
        """End the run, because a choice doesn't have the candidate that the fork forces."""
        cause = f"there is no such candidate; there are {', '.join(candidates)}"
        self._refuse(BadChange(f"{decision}={candidate}", cause))

    @property
    def unused(self) -> list[str]:
        """The unused answers."""
        return [each.text for each in self.given if not (isinstance(each, ForcedDecision) and each.used)]

    def complete(self, record: Query) -> None:
        """Complete the record of a query with a recorded or given answer."""
        beside = self._beside.pop(threading.get_ident(), None)
        if beside is None:
            return
        if beside.by_fork:
            record.by_fork, record.own_answer_json = True, beside.own_answer_json
            return
        record.candidates.extend(beside.candidates)
        if beside.HasField("chosen"):
            record.chosen = beside.chosen


def _answers(recorded: Query, question: Asked, world: BulletWorld) -> bool:
    """Return whether a recorded query asks the same question at the same moment, and has its own complete answer."""
    known = recorded.name in ANSWERABLE and _kind(recorded.name) != _OF_MANY
    if not known or recorded.HasField("failure") or recorded.by_fork:
        return False
    moment = recorded.name, recorded.world, recorded.sim_step
    same_moment = moment == (question.name, world.name, world.sim_step)
    return same_moment and list(recorded.arguments) == records.arguments(question.arguments)


def _live(value: Plain, world: BulletWorld) -> Any:
    if isinstance(value, list):
        return [_live(item, world) for item in value]
    if isinstance(value, dict):
        if value.keys() == {"object", "world"} and value["world"] == world.name:
            return world.get_object(str(value["object"]))
        if value.keys() == {"float"}:
            return float(str(value["float"]))
        return {key: _live(item, world) for key, item in value.items()}
    return value
