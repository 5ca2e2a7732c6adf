"""A failure with the facts about its causes, and the base class of all kinds of causes.

The data, the finder and the text of a kind of cause are in one file. The ``kind`` and the field names are keys of ``why
--json`` (docs/reference/causes.md), so they must not change.
"""

from __future__ import annotations

import ast
import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from recorder.plan_lines import called_name, deciding, last_name, syntax_nodes
from recorder.records import Failure, Keyframe, Mutation, Plain, Query, Refusal, Task, argument_values, from_json
from recorder.tasks import Node
from replay.errors import NoSuchName
from replay.history.blame import Blame, blame, commanded
from replay.history.source import Line, ParsedException, PlanSource, parse_traceback
from replay.history.tasks import Failures, causing_tasks
from replay.report import phrases
from replay.state.fold import state_at
from replay.state.state import Attachment, Body, State, World

if TYPE_CHECKING:
    from replay.explain.causes.trials import Trial
    from replay.file.record_reader import RecordReader

_MAX_RECORDS: Final = 5_000  # maximum number of records in which skipped lines are searched
_WITH_MOTIONS = ("motion", "process-module")
HANDLER = "handler"  # kind of the tasks that are calls of event handlers


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause of a failure."""

    kind: ClassVar[str]
    untestable: ClassVar[str] = "no change of a fork takes this cause away"  # why a cause may have no trials
    explained_by: ClassVar[tuple[str, ...]] = ()  # kinds of causes that explain this cause if they have the same body
    steps: tuple[int, ...]  # sorted steps of the records that show the cause

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Self]:
        """Yield the causes of this kind."""
        raise NotImplementedError

    def _words(self) -> Iterator[str]:
        raise NotImplementedError

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether another cause in ``found`` explains this cause."""
        body = getattr(self, "body", None)
        return any(each.kind in self.explained_by and getattr(each, "body", None) == body for each in found)

    def trials(self, case: FailureCase) -> Iterator[Trial]:  # noqa: ARG002  most kinds need this argument
        """Yield trials: forks that take the cause away, the most direct fork first."""
        yield from ()

    def causing_changes(self) -> Iterator[CausingChange]:
        """Yield the changes in the cause's fields."""
        values = [getattr(self, each.name) for each in fields(self)]
        every = (each for value in values for each in (value if isinstance(value, tuple) else (value,)))
        return (each for each in every if isinstance(each, CausingChange))

    def with_events(self) -> Self:
        """Return the cause with the steps of the events whose handlers made its changes."""
        events = {each.handler.cause for each in self.causing_changes() if each.handler is not None}
        events.discard(0)  # before the recording
        return replace(self, steps=tuple(sorted({*self.steps, *events}))) if events else self

    def lines(self) -> Iterator[str]:
        """Yield the text of the cause, with indented details."""
        first, *details = self._words()
        yield first
        yield from (f"  {line}" for line in details)


@dataclass(frozen=True, slots=True)
class CausingChange:
    """A record that changed a body or joint."""

    step: int
    body: str
    joint: str = ""  # name of the joint; "" for the body's pose
    #: How the body changed: a value of ``how`` in :class:`replay.history.blame.Blame`, or "attached", "detached",
    #: "joints", "gravity", or "in-hand" (a command moved the body within the hand).
    how: str = ""
    task: Task | None = None  # start of the innermost motion, handler or task around the change; None outside of tasks
    line: Line | None = None  # the plan's line that requested the change
    mover: str = ""  # the body, or ``JOINT of BODY``, that a command for another body moved
    distance: float = 0.0  # length of the motion in m, or angle of a revolute joint in rad
    angle: float = 0.0  # angle of the turn in rad
    handler: Task | None = None  # the start of the event handler's call that made the change, if any
    by_fork: bool = False  # whether the fork made the change, not the plan

    @property
    def originator(self) -> str:
        """Return the task or handler that made the change, and the plan's line, as text."""
        if self.by_fork:
            return ", by the fork"
        task, handler, by = self.task, self.handler, ""
        if task is not None and task is handler:
            by = f", by {phrases.handler(task)}"
        elif task is not None:
            by = f", by {phrases.task(task.kind, task.name, argument_values(task.parameters))}"
        by += phrases.at(self.line)
        return by + (f", in {phrases.handler(handler)}" if handler is not None and task is not handler else "")

    def __str__(self) -> str:
        name = f"{self.body}.{self.joint}" if self.joint else self.body
        has_size = self.distance and math.isfinite(self.distance) and not self.joint
        size = f" by {phrases.length(self.distance)}" if has_size else ""
        return f"{phrases.change(name, self.how, self.mover)}{size}{self.originator}"

    @property
    def row(self) -> str:
        """Return the step and the change as text."""
        return f"step {self.step}: {self}"


def since(change: CausingChange | None, verb: str = "") -> str:
    """Return ", since step N" with the task or line that made a change; "" if there is none."""
    if change is None:
        return ""
    return f", {f'{verb} at' if verb else 'since'} step {change.step}{change.originator}"


@dataclass(frozen=True)
class FailureCase:
    """A failure, and the facts around it."""

    log: RecordReader
    step: int  # the step of the failure
    failure: Failure  # raised exception
    task: Node | None  # task in which the failure began; None for the plan's own code
    failed: Failures  # failed and successful tasks before the failure
    state: State  # states of all worlds at the failure
    world: World | None  # world of the failure; None without an open world
    #: Exceptions that led to the failure, the causes first.
    exceptions: tuple[ParsedException, ...] = field(default=(), repr=False)

    # --- the failed task ---------------------------------------------------------------------------------------------

    @cached_property
    def source(self) -> PlanSource:
        """The plan's source."""
        return PlanSource(self.log)

    @cached_property
    def motion(self) -> Node | None:
        """The failed motion; None if the failure began outside of motions or in the plan's code."""
        if self.task is None or self.task.kind not in _WITH_MOTIONS or self.task.motion.kind != "motion":
            return None
        return self.task.motion

    @cached_property
    def began(self) -> int:
        """The step at which the failed motion began; without a motion, the step of the failure."""
        return self.motion.started.seq if self.motion is not None else self.step

    @cached_property
    def given(self) -> Mapping[str, Plain]:
        """The parameters of the motion, also inferred ones; empty without a motion."""
        if self.motion is None or self.task is None:
            return {}
        inner = self.task.parameters if self.task.kind == "process-module" else {}
        return self.motion.parameters | self.motion.solution | inner

    @cached_property
    def data(self) -> Mapping[str, Plain]:
        """The fields of the failure."""
        return argument_values(self.failure.data)

    @cached_property
    def pairs(self) -> tuple[Mapping[str, str], ...]:
        """The links that would have collided: ``mover``, ``link``, ``body``, ``body_link``, ``gripper``."""
        return pairs_of(self.failure)

    @cached_property
    def subjects(self) -> tuple[str, ...]:
        """Names of the objects in the motion's parameters."""
        return tuple(dict.fromkeys(objects_in(list(self.given.values()))))

    @cached_property
    def mentioned(self) -> tuple[str, ...]:
        """Names of all bodies in the motion's parameters, and in the failure's fields and message."""
        names = [*self.subjects, *_names_in(self.data)]
        if self.world is not None:
            words = re.findall(r"[\w.-]+", self.failure.message)
            names += [name for word in words for name in (word, word.rstrip(".")) if name in self.world.bodies]
            names = [name for name in names if name in self.world.bodies]
        return tuple(dict.fromkeys(names))

    @cached_property
    def traced(self) -> tuple[ParsedException, ...]:
        """The exceptions of the task's failure, causes first; without a task, of the plan's failure."""
        if self.task is not None and self.task.failure is not None and self.task.failure.traceback:
            return tuple(parse_traceback(self.task.failure.traceback, self.source))
        return self.exceptions

    # --- bodies and hands --------------------------------------------------------------------------------------------

    @property
    def robot(self) -> Body | None:
        """The robot; None if the world has none."""
        return self.world.bodies.get(self.world.robot) if self.world is not None else None

    @cached_property
    def hands(self) -> Mapping[str, str]:
        """The tool frames of the robot's arms, by arm."""
        return hands(self.robot)

    @cached_property
    def before(self) -> World | None:
        """The world when the failed motion began; None if the world wasn't open."""
        if self.motion is None or self.world is None:
            return self.world
        return state_at(self.log, self.began).worlds.get(self.world.name)

    def held_by(self, arm: str) -> Attachment | None:
        """Return the attachment to an arm when the motion began; None if the hand was empty."""
        if self.before is None or self.robot is None:
            return None
        held = self.before.carried(self.robot.name)
        return next((each for each in held if each.carrier_link == self.hands.get(arm, "")), None)

    def free_body(self, name: str) -> Body | None:
        """Return a movable body; None if it is fixed, the robot, or unknown."""
        body = self.world.bodies.get(name) if self.world is not None else None
        return None if body is None or body.fixed_base or body is self.robot else body

    def joints_to(self, name: str, link: str) -> tuple[str, ...]:
        """Return the movable joints from a link to the body's base."""
        if self.world is None or not link:
            return ()
        body = self.world.bodies[name]
        try:
            model = self.state.urdf(body)
        except NoSuchName:
            return ()
        found = []
        joint = model.parent_joint(link) if link in model.links else None
        while joint is not None:
            if joint.name in body.joints:
                found.append(joint.name)
            joint = model.parent_joint(joint.parent)
        return tuple(found)

    def limits(self, name: str, joint: str) -> tuple[float, float] | None:
        """Return the limits of a body's joint; None if they aren't known."""
        body = self.world.bodies.get(name) if self.world is not None else None
        with suppress(NoSuchName, KeyError):
            return (found := self.state.urdf(body).joints[joint]).lower, found.upper  # type: ignore[arg-type]
        return None

    def holder(self, body: str, step: int | None = None) -> str:
        """Return the holder of an object: the robot's arm, or another carrier with its link; "" if there is none."""
        state = self.state if step is None else state_at(self.log, step)
        world = state.worlds.get(self.world.name) if self.world is not None else None
        held = world.carrier(body) if world is not None else None
        if held is None or world is None:
            return ""
        arms = hands(world.bodies.get(held.carrier))
        arm = next((name for name, frame in arms.items() if frame and frame == held.carrier_link), "")
        return arm or held.carrier + (f" ({held.carrier_link})" if held.carrier_link else "")

    # --- records -----------------------------------------------------------------------------------------------------

    def motions(self, *names: str) -> Iterator[Node]:
        """Yield earlier motions of this world with given names, the latest first."""
        for motion in reversed(self.failed.motions):
            earlier = motion.last_step < self.began and motion is not self.motion
            if earlier and motion.name in names and self.is_here(motion.started):
                yield motion

    def is_here(self, record: Task | Refusal | Mutation) -> bool:
        """Return whether a record belongs to the world of the failure. Earlier worlds may have the same name."""
        if self.world is None:
            return True
        lifetime = self.log.lifetime_at(record.world, record.seq)
        return (record.world, lifetime.number if lifetime is not None else 0) == (self.world.name, self.world.lifetime)

    def blame(self, target: str) -> Blame | None:
        """Return the last change of a body or a joint (``BODY.JOINT``); None if none is recorded."""
        try:
            return blame(self.log, target, self.step, self.world.name if self.world is not None else None)
        except NoSuchName:
            return None

    def changed(self, target: str) -> CausingChange | None:
        """Return the last change of a body or joint; None if it came before the first motion."""
        last = self._unsettled(target)
        first = self.step if self.failed.first_motion is None else self.failed.first_motion
        if last is None or last.how == "before" or (last.how == "load" and last.record.seq < first):
            return None
        return self.blamed(last)

    def _unsettled(self, target: str) -> Blame | None:
        """Return the last change of a body or joint that is more than settling."""
        last = self.blame(target)
        while last is not None and last.how == "physics" and last.earlier is not None:
            if last.distance >= _SETTLED[0] or last.angle >= _SETTLED[1]:
                break
            last = blame(self.log, target, last.earlier.record.seq, last.world)
        return last

    def blamed(self, last: Blame) -> CausingChange:
        """Return the last change of a body or joint as a causing change."""
        return self.change(last.record, last.body, last.how, joint=last.joint, size=(last.distance, last.angle))

    def steps(self, *shown: int | CausingChange | None) -> tuple[int, ...]:
        """Return the sorted steps of records and changes, and the step of the failure."""
        known = (each.step if isinstance(each, CausingChange) else each for each in shown)
        return tuple(sorted({*(step for step in known if step is not None), self.step}))

    def loaded(self, body: str) -> CausingChange | None:
        """Return the loading of a body that has not moved since then; None if another change came last."""
        last = self._unsettled(body)
        return None if last is None or last.how != "load" else self.change(last.record, body, "load")

    def change(
        self, record: Mutation | Keyframe, body: str, how: str, joint: str = "", size: tuple[float, float] = (0.0, 0.0)
    ) -> CausingChange:
        """Return a record as the change of a body, with its task, handler and line."""
        because = causing_tasks(self.log, record)
        tasks = [each.started for each in because.tasks]
        task = next((each for each in tasks if each.kind in ("motion", HANDLER)), tasks[0] if tasks else None)
        stack = next((each.call_stack for each in because.tasks if each.started is task), because.call_stack)
        handler = next((each for each in tasks if each.kind == HANDLER), None)
        if task is not None and task.kind != "motion":
            stack = because.call_stack or stack  # the handler's line or branch that made the change itself
        mover = _mover(record)
        other = mover if mover != body and not joint else ""
        by_fork = isinstance(record, Mutation) and record.by_fork
        line = self.line(stack)
        return CausingChange(record.seq, body, joint, how, task, line, other, *size, handler=handler, by_fork=by_fork)

    # --- lines of the plan -------------------------------------------------------------------------------------------

    def line_of(self, record: Task | Mutation | Refusal) -> Line | None:
        """Return the plan's line that caused a record; None if it is unknown."""
        return self.line(self.source.call_stack(record))

    def line(self, stack: Sequence[Line]) -> Line | None:
        """Return the innermost informative line of a call stack.

        Lines of helper functions that only pass values on are left out. Other lines are informative only if all motions
        that they requested have the same name.
        """
        inner = [(line.file, line.number) for line in reversed(stack)]
        stack = stack[: len(stack) - deciding(inner, self.source.text)]
        performed = [(line, self._motions_by_line[line.file, line.number]) for line in reversed(stack)]
        one = [line for line, motions in performed if len(motions) <= 1]
        one += [line for line, motions in performed if len({name for name, _ in motions}) <= 1]
        return next(iter(one), stack[-1] if stack else None)

    @cached_property
    def _motions_by_line(self) -> Mapping[tuple[str, int], set[tuple[str, str]]]:
        """The names and parameters of the motions that each line requested."""
        found: dict[tuple[str, int], set[tuple[str, str]]] = defaultdict(set)
        for motion in self.failed.motions:
            for line in self.source.call_stack(motion.started):
                found[line.file, line.number].add((motion.name, str(motion.parameters)))
        return found

    def skipped(self, file: str) -> Iterator[Line]:
        """Yield the lines before the failure that perform something, although no record shows that they ran."""
        reached = {line.function: line.number for error in self.traced for line in error.lines}
        nodes = [each for each in syntax_nodes(self.source.text(file)) if self._ran and isinstance(each, ast.expr)]
        places = ((each, self.source.line(file, each.lineno)) for each in nodes)
        before = [(each, at) for each, at in places if at and at.number <= reached.get(at.function, at.number)]
        used = {(last_name(each), at.function) for each, at in before}
        entered = {"", "<module>", *(at.function for _, at in before if (file, at.number) in self._ran)}
        while more := {name for name, function in used if function in entered} - entered:
            entered |= more  # the other functions were never called
        for call, line in before:
            if isinstance(call, ast.Call) and called_name(call) == "perform" and line.function in entered:
                numbers = range(call.lineno, (call.end_lineno or call.lineno) + 1)
                if self._ran.isdisjoint((file, number) for number in numbers):
                    yield line

    @cached_property
    def _ran(self) -> set[tuple[str, int]]:
        """The lines that led to tasks, queries and refusals before the failure; empty if there are too many records."""
        records = list(islice(self.log.records((Task, Query, Refusal), stop=self.step + 1), _MAX_RECORDS))
        lines = [line for each in records for line in self.source.call_stack(each)]
        lines += [line for error in self.traced for line in error.lines]
        return {(line.file, line.number) for line in lines} if len(records) < _MAX_RECORDS else set()

    def names_in(self, lines: Sequence[Line], context: type[ast.expr_context]) -> set[tuple[str, str]]:
        """Return the variables that statements at the given lines read (``ast.Load``), or set or fill (``ast.Store``).

        A variable, as a pair: the name of its function, and its own name.
        """
        found: set[tuple[str, str]] = set()
        for line in lines:
            for statement in syntax_nodes(self.source.text(line.file)):
                if not isinstance(statement, ast.stmt) or hasattr(statement, "body"):
                    continue
                if statement.lineno <= line.number <= (statement.end_lineno or statement.lineno):
                    nodes = [node for node in ast.walk(statement) if isinstance(node, ast.Name)]
                    found |= {(line.function, node.id) for node in nodes if isinstance(node.ctx, context)}
                    if context is ast.Store:
                        found |= {(line.function, name) for name in _filled_containers(statement)}
        return found


_SETTLED = 0.02, math.radians(15)  # a smaller change (m, rad) in simulation counts as settling


def _mover(record: Mutation | Keyframe) -> str:
    body = commanded(record)
    if not isinstance(record, Mutation) or not record.HasField("move_joints"):
        return body
    joints = list(record.move_joints.joints)
    return f"{joints[0]} of {body}" if len(joints) == 1 else body


def pairs_of(failure: Failure) -> tuple[Mapping[str, str], ...]:
    """Return the links that would have collided in a failed motion."""
    recorded = argument_values(failure.data).get("pairs")
    pairs = [pair for pair in recorded if isinstance(pair, dict)] if isinstance(recorded, list) else []
    return tuple({key: value for key, value in pair.items() if isinstance(value, str)} for pair in pairs)


def bodies_in(value: Plain) -> Iterator[tuple[str, str]]:
    """Yield the names of the bodies in a recorded value, with their worlds."""
    if isinstance(value, dict):
        if set(value) == {"object", "world"}:
            yield str(value["object"]), str(value["world"])
            return
        value = list(value.values())
    for item in value if isinstance(value, list) else ():
        yield from bodies_in(item)


def objects_in(value: Plain) -> Iterator[str]:
    """Yield the names of the bodies in a recorded value."""
    return (name for name, _ in bodies_in(value))


def _names_in(data: Mapping[str, Plain]) -> Iterator[str]:
    """Yield texts in a failure's fields that may be names of bodies."""
    for value in data.values():
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, str):
                yield item
            elif isinstance(item, dict):
                yield from (str(item[key]) for key in ("mover", "body") if key in item)
    reasons = data.get("reasons")
    if isinstance(reasons, dict):
        yield from reasons


_FILLING: Final = ("add", "append", "extend", "insert", "setdefault", "update")  # methods that add items to containers


def _filled_containers(statement: ast.stmt) -> Iterator[str]:
    """Yield the variables of the containers to which a statement adds items."""
    for node in ast.walk(statement):
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
            owner: ast.expr | None = node.value
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _FILLING:
            owner = node.func.value
        else:
            owner = None
        if isinstance(owner, ast.Name):
            yield owner.id


def hands(robot: Body | None) -> dict[str, str]:
    """Return the tool frames of a robot's arms, by arm."""
    return {name: str(arm.get("tool_frame", "")) for name, arm in _arms(_description(robot)).items()}


def joints_of(robot: Body | None, part: str) -> tuple[str, ...]:
    """Return the joints of the torso, the head or an arm."""
    description = _description(robot)
    found = description.get(part) or _arms(description).get(part) or {}
    joints = [*found.get("joints", ()), found.get("joint"), found.get("pan"), found.get("tilt")]
    return tuple(str(name) for name in joints if name)


def _description(robot: Body | None) -> dict[str, Any]:
    try:
        return tomllib.loads(robot.loaded.robot_description) if robot is not None else {}
    except tomllib.TOMLDecodeError:
        return {}


def _arms(description: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {name: arm for name, arm in description.get("arms", {}).items() if isinstance(arm, dict)}


def about(task: Node, *, body: str = "", arm: str = "") -> bool:
    """Return whether a motion's parameters contain an object and an arm."""
    given = values(task)
    own = str(given.get("arm") or given.get("gripper") or "")
    return (not body or body in objects_in(list(given.values()))) and (not arm or not own or own == arm)


def values(task: Node) -> dict[str, Plain]:
    """Return the parameters of a motion. The parameters of resolved motions contain inferred parameters, too."""
    inferred = [part.parameters for part in task.children if part.kind == "process-module"]
    return task.parameters | (inferred[0] if inferred else {}) | task.solution


def result(task: Node) -> Plain:
    """Return the result of a task."""
    return from_json(task.finished.result_json or "null") if task.finished is not None else None
