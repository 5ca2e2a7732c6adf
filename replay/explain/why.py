"""Explain a failure: the failed task, its place in the plan, attempts, queries on which the plan relied, and changes.

All facts come from the recording. For answers to queries of the plan, the explanation lists objects that have moved
since then. For a failed action, the explanation lists the choices, their projections and the considered places.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from recorder import html
from recorder.geometry import Pose
from recorder.records import Failure, Plain, Query, Run, argument_values
from recorder.records.text import fates_text, foreseen, is_choice
from recorder.tasks import Node
from replay.compare import Difference, difference
from replay.errors import NoSuchName, NoSuchStep
from replay.explain.causes import decides, find, lacks_step
from replay.explain.causes.case import Cause, FailureCase, bodies_in, objects_in
from replay.explain.causes.trials import Proof
from replay.history.flow import Flow
from replay.history.source import Line, ParsedException
from replay.history.tasks import (
    Failures,
    RootCause,
    Summary,
    causing_tasks,
    choices,
    failed_threads,
    failures,
    root_cause,
    summary,
)
from replay.report import phrases
from replay.state.fold import state_at
from replay.state.json_data import mentions
from replay.state.state import Attachment, Body, State, World

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

_MAX_QUERIES: Final = 8
_FIRST, _LAST = 5, 20  # number of first and of last attempts that have the robot's state
_LISTED: Final = 3  # maximum number of first choices, and of last choices, that are listed
_MAX_IMAGINED: Final = 6
_MAX_PLACES: Final = 5  # maximum number of last queries for places that are listed
_MAX_SOURCES: Final = 6
_MAX_CAUSES: Final = 3  # maximum number of causes whose lines are followed
_OUTER: Final = 0.9  # rank of a caller's line after the called line
_DECIDED: Final = -1.0  # rank of a line that made a cause which decides
_MOVED: Final = 0.001  # objects that moved less since a query count as unmoved, m


@dataclass(frozen=True, slots=True)
class FailedAttempt:
    """An attempt at the failed task."""

    task: Node  # task in which this attempt failed first
    robot: Body | None  # the robot before the attempt; None without a robot, and for attempts in the middle of many


@dataclass(frozen=True, slots=True)
class RelevantQuery:
    """A query on which the plan relied."""

    query: Query
    moved: tuple[str, ...] = ()  # names of the query's bodies that moved before the failure
    removed: tuple[str, ...] = ()  # names of the query's bodies that were removed before the failure
    world: str = ""  # name of the query's world, if it isn't the world of the failure

    @property
    def holds(self) -> bool:
        """Whether the query's bodies were unchanged at the failure."""
        return not (self.moved or self.removed or self.world)


@dataclass(frozen=True, slots=True)
class ChangesSince:
    """The changes since a task succeeded."""

    task: Node
    difference: Difference  # difference between the states after the task and before the failure


@dataclass(frozen=True, slots=True, repr=False)
class Why:
    """The explanation of a failure."""

    run: Summary  # summary of the whole run
    step: int  # step of the failure
    failure: Failure | None  # failure of the plan or task; None without a failure
    causes: tuple[Cause, ...] = ()  # the causes that explain most come first
    branches: tuple[FailedBranch, ...] = ()  # other failures in the same block
    thread: str = ""  # name of the failed thread; "" if the plan itself failed
    exceptions: tuple[ParsedException, ...] = ()  # exceptions from the failed task to the plan's failure, causes first
    task: Node | None = None  # task in which the failure began; None for the plan's own code
    call_stack: tuple[Line, ...] = ()  # the plan's lines that led to the task, outermost first
    #: Local variables of the plan's functions at the failure, by file and line: names, and values as text.
    variables: Mapping[tuple[str, int], Mapping[str, str]] = field(default_factory=dict)
    world: World | None = None  # the world of the failure; None without an open world
    is_default: bool = True  # whether ``pycram-replay`` uses this world by default
    bodies: tuple[InvolvedBody, ...] = ()  # the robot, and the bodies of the task
    removed: tuple[str, ...] = ()  # names of the task's bodies that were removed before the failure
    attempts: tuple[FailedAttempt, ...] = ()  # attempts at the task with the same objects, including this one
    other_failures: int = 0  # number of other tasks that failed earlier
    forgotten: int = 0  # number of earlier failures that the explanation leaves out
    choices: tuple[Query, ...] = ()  # the choices of the failed motion's process module
    tried: TriedAction | None = None  # the failed action that contains the task
    queries: tuple[RelevantQuery, ...] = ()  # the queries on which the plan relied
    earlier_queries: int = 0  # number of further queries about these bodies
    since_same_success: ChangesSince | None = None  # changes since the last success of the same kind of task
    since_last_success: ChangesSince | None = None  # changes since the last success of any task
    unfinished: tuple[Node, ...] = ()  # the innermost unfinished tasks of a recording that was cut off
    endless: tuple[Node, ...] = ()  # the innermost tasks whose ends may be among lost records
    failed_threads: tuple[Run, ...] = ()  # records of other failed threads of the plan
    case: FailureCase | None = field(default=None, compare=False)  # facts around the failure, which show the causes
    sources: tuple[Line, ...] = ()  # lines of the plan's source that flow into the failure, the most probable first
    proofs: tuple[Proof, ...] = ()  # verdict on each cause that was tested in forks
    path: str = ""  # path of the recording in printed commands

    def __repr__(self) -> str:
        return f"<Why: {next(self._lines())}>"

    def __str__(self) -> str:
        return self.text

    @property
    def text(self) -> str:
        """The explanation as ``pycram-replay why`` prints it."""
        return "\n".join(self._lines(self.path))

    def _repr_html_(self) -> str:
        return html.report(self._lines())

    def _lines(self, path: str = "") -> Iterator[str]:
        from replay.explain import why_report  # noqa: PLC0415  that module imports this one

        return why_report.lines(self, path)

    @property
    def is_python_error(self) -> bool:
        """Whether the plan's code is wrong, and not the state of the world."""
        return self.task is None and self.failure is not None and hasattr(builtins, self.failure.type)

    @property
    def warning(self) -> Query | None:
        """The plan's last query about bodies of the failure that was answered by no, if they haven't changed since."""
        # id of the process module in which the failure began
        within = self.task.id if self.task is not None and self.task.kind == "process-module" else None
        named = {self.world.robot if self.world is not None else "", *(self.case.mentioned if self.case else ())}
        no = (each.query for each in reversed(self.queries) if each.holds and each.query.answer_json == "false")
        about = ((each, set(objects_in(list(argument_values(each.arguments).values())))) for each in no)
        return next((query for query, bodies in about if query.task != within and bodies <= named), None)


def why(log: RecordReader, step: int | None = None) -> Why:
    """Explain the failed task around a step, or the last failed task before it. The default is the root cause.

    Raises:
        NoSuchStep: There is no such step, or no task had failed.
    """
    failed = failures(log)
    run = summary(log)
    if step is not None:
        task = _failed_at(log, failed, step)
        cause = RootCause(task.last_step, task)
        return replace(_task_failure(log, run, task, cause), variables=_variables(cause))
    root = root_cause(log, failed)
    open_tasks = tuple(task for task in failed.running if not any(part in failed.running for part in task.children))
    lost = max((gap.start for gap in log.missing()), default=-1) if open_tasks else -1
    unfinished = tuple(task for task in open_tasks if task.started.seq > lost)
    endless = tuple(task for task in open_tasks if task.started.seq < lost)
    if root is None:
        step = log.final_step()
        cut = FailureCase(log, step, Failure(), None, failed, state_at(log, step), None)
        causes = find(cut) if run.outcome == "cut off" and not endless else ()
        return Why(run, step, None, causes, unfinished=unfinished, endless=endless, case=cut, path=str(log.path))
    if root.task is None:
        explained = _plan_failure(log, run, failures(log, root.step) if root.thread else failed, root)
    else:
        explained = _task_failure(log, run, root.task, root, unfinished)
    explained = replace(explained, variables=_variables(root), endless=endless)
    threads = tuple(record for record in failed_threads(log) if record.failure != root.failure)
    return replace(explained, failed_threads=threads, sources=tuple(_sources(explained)))


def _sources(why: Why) -> Iterator[Line]:
    """Yield the lines whose values flow into the failure and into the changes that caused it."""
    case = why.case
    stack = [line for error in why.exceptions[-1:] for line in error.lines] if why.task is None else why.call_stack
    if case is None:
        return
    traced = [
        (_DECIDED * decides(case, cause), causing_tasks(case.log, case.log[step]).call_stack)
        for cause in why.causes[:_MAX_CAUSES]
        for step in cause.steps
        if step < why.step
    ]
    lacks = lacks_step(case, why.causes)
    if stack and (lacks or why.task is None or why.failure is None or why.failure.type == "PropertyViolated"):
        traced += [(0.0, (line,)) for line in case.skipped(stack[-1].file)]
    starts: dict[str, dict[int, float]] = {}
    for rank, lines in sorted([(0.0, tuple(stack)), *traced], key=lambda each: each[0]):
        for depth, line in enumerate(reversed(lines)):
            starts.setdefault(line.file, {}).setdefault(line.number, rank + _OUTER * depth)
    failed = None if lacks or not stack else stack[-1]
    for file, ranks in starts.items():
        flow = Flow(case.source.text(file))
        numbers = flow.lines(ranks, failed.number if failed is not None and failed.file == file else 0)
        for number in numbers[:_MAX_SOURCES]:
            found = case.source.line(file, number)
            if found is not None and (number in ranks or not (stack and case.source.is_ahead(found, stack[0]))):
                yield found


def _variables(cause: RootCause) -> dict[tuple[str, int], dict[str, str]]:
    """Return the local variables at a failure, by file and line of their frames.

    Each frame is only in the first record of an error. The record of a branch has only the branch's own frames.
    """
    tasks = cause.task.around() if cause.task is not None else ()
    variables: dict[tuple[str, int], dict[str, str]] = {}
    for failure in (*(task.failure for task in tasks), cause.failure):
        for frame in failure.frames if failure is not None else ():
            values = {each.name: each.value for each in frame.variables}
            variables.setdefault((frame.file, frame.line), values)
    return variables


def _failed_at(log: RecordReader, failed: Failures, step: int) -> Node:
    """Return the failed task around a step, or else the last task that failed before."""
    within = log[step].task
    until = [task for task in failed.origins if task.finished is not None and task.finished.seq <= step]
    of_step = [task for task in failed.origins if within and any(each.id == within for each in task.around())]
    if not of_step and not until:
        raise NoSuchStep(step, len(log), "no task had failed up to this step")
    return (of_step or until)[-1]


def _task_failure(
    log: RecordReader, run: Summary, task: Node, cause: RootCause, unfinished: tuple[Node, ...] = ()
) -> Why:
    motion, end = task.motion, task.last_step
    start = motion.started.seq
    before = failures(log, end + 1)
    objects = list(bodies_in(motion.parameters))
    alike = [attempt for attempt in before.origins if _is_alike(log, attempt.motion, motion, objects)]
    before_it = [attempt for attempt in alike if attempt.motion is not motion and attempt.motion.started.seq < start]
    same = before.successes.get((motion.kind, motion.name))
    window = max((each.last_step for each in (*before_it[-1:], same) if each is not None), default=0)
    queries, earlier = _queries(log, window, end, objects, {each.id for each in task.around()})
    state = state_at(log, end)
    world = _world(state, objects, queries)
    failure = task.failure or cause.failure or Failure()
    case = FailureCase(log, end, failure, task, before, state, world, cause.exceptions)
    names = _names_of_world(objects, world)
    return replace(
        _explained(case, run, cause, names, queries, earlier),
        failure=cause.failure or task.failure,
        branches=tuple(branches(case)),
        task=task,
        call_stack=next(filter(None, (case.source.call_stack(each.started) for each in task.around())), ()),
        removed=tuple(name for name in names if world is not None and name not in world.bodies),
        attempts=tuple(_attempts(log, alike, world)),
        other_failures=len(before.origins) - len(alike),
        choices=tuple(choices(log, task)),
        tried=tried(log, task),
        since_same_success=_since(log, same, state),
        unfinished=unfinished,
    )


def _plan_failure(log: RecordReader, run: Summary, failed: Failures, cause: RootCause) -> Why:
    state, last = state_at(log, cause.step), failed.last_success
    window = last.started.seq if last is not None else 0
    queries, earlier = _queries(log, window, cause.step if cause.thread else len(log), (), ())
    objects = list(dict.fromkeys(body for query in queries for body in bodies_in(argument_values(query.arguments))))
    world = _world(state, objects, queries)
    case = FailureCase(log, cause.step, cause.failure or Failure(), None, failed, state, world, cause.exceptions)
    return _explained(case, run, cause, _names_of_world(objects, world), queries, earlier)


def _explained(
    case: FailureCase, run: Summary, cause: RootCause, names: Iterable[str], queries: Sequence[Query], earlier: int
) -> Why:
    """Return the parts that explanations of tasks' failures and of the plan's own failures have in common."""
    world = case.world
    return Why(
        run,
        case.step,
        cause.failure,
        causes=find(case),
        case=case,
        thread=cause.thread,
        exceptions=cause.exceptions,
        world=world,
        is_default=world is None or world is case.state.world(),
        bodies=tuple(bodies(case, names)),
        other_failures=len(case.failed.origins),
        forgotten=case.failed.forgotten,
        queries=tuple(_with_changes(case.log, query, world) for query in queries),
        earlier_queries=earlier,
        since_last_success=_since(case.log, case.failed.last_success, case.state),
        path=str(case.log.path),
    )


# --- attempts --------------------------------------------------------------------------------------------------------


def _is_alike(log: RecordReader, task: Node, failed: Node, objects: Iterable[tuple[str, str]]) -> bool:
    """Return whether a task is another attempt: it has a common body in the same world."""
    if (task.kind, task.name) != (failed.kind, failed.name):
        return False
    own = set(bodies_in(task.parameters))
    now, then = failed.started.seq, task.started.seq
    worlds = {world for _, world in own.intersection(objects)}
    return not objects or not own or any(log.lifetime_at(each, now) == log.lifetime_at(each, then) for each in worlds)


def _attempts(log: RecordReader, tasks: Sequence[Node], world: World | None) -> Iterator[FailedAttempt]:
    for number, task in enumerate(tasks):
        robot = None
        if world is not None and (number < _FIRST or number >= len(tasks) - _LAST):
            then = state_at(log, max(task.motion.started.seq - 1, 0)).worlds.get(world.name)
            robot = then.bodies.get(then.robot) if then is not None else None
        yield FailedAttempt(task, robot)


# --- queries ---------------------------------------------------------------------------------------------------------


def _queries(
    log: RecordReader, start: int, stop: int, objects: Iterable[tuple[str, str]], tasks: Iterable[int]
) -> tuple[list[Query], int]:
    """Return the last distinct queries about bodies or of tasks, and the number of earlier queries.

    Process modules' choices are left out, because plans don't rely on them.
    """
    asked: set[int] = set()  # only hashes are kept, because there may be very many queries
    queries: list[Query] = []
    names, ids = {name for name, _ in objects}, set(tasks)
    for query in log.backwards(stop - 1, Query) if stop > start else ():
        if query.seq < start:
            break
        if not is_choice(query) and (not names or query.task in ids or any(mentions(query, name) for name in names)):
            question = hash((query.name, query.world, *((each.name, each.json) for each in query.arguments)))
            if question not in asked and len(queries) < _MAX_QUERIES:
                queries.append(query)
            asked.add(question)
    return queries[::-1], len(asked) - len(queries)


def _with_changes(log: RecordReader, query: Query, world: World | None) -> RelevantQuery:
    """Return a query, with the changes of its bodies until the failure."""
    then = state_at(log, query.seq).worlds.get(query.world)
    if then is None or world is None:
        return RelevantQuery(query)
    if then.title != world.title:
        return RelevantQuery(query, world=then.title)
    moved, removed = [], []
    for name, _ in dict.fromkeys(bodies_in(argument_values(query.arguments))):
        before, after = then.bodies.get(name), world.bodies.get(name)
        if before is not None and after is None:
            removed.append(name)
        elif before is not None and after is not None and math.dist(before.position, after.position) > _MOVED:
            moved.append(name)
    return RelevantQuery(query, tuple(moved), tuple(removed))


# --- the world at the failure ----------------------------------------------------------------------------------------


def _world(state: State, objects: Iterable[tuple[str, str]], queries: Iterable[Query]) -> World | None:
    """Return the world to which a failure belongs."""
    opened = {name: world for name, world in state.worlds.items() if world.open}
    for name in (*(world for _, world in objects), *(query.world for query in queries)):
        if name in opened:
            return opened[name]
    return max(opened.values(), key=lambda world: bool(world.robot), default=None)


def _names_of_world(objects: Iterable[tuple[str, str]], world: World | None) -> list[str]:
    return [name for name, owner in objects if world is not None and owner == world.name]


def _since(log: RecordReader, task: Node | None, now: State) -> ChangesSince | None:
    if task is None or task.finished is None:
        return None
    return ChangesSince(task, difference(state_at(log, min(task.finished.seq, now.step)), now))


@dataclass(frozen=True, slots=True)
class TriedAction:
    """The attempts that a failed action made."""

    action: Node
    attempts: tuple[Node, ...]  # attempts at the action's choices; their parameters are the chosen values
    imagined: tuple[Node, ...]  # projections of choices, in order
    places: tuple[Query, ...]  # queries for places, of the action and its parts
    spent: bool  # whether the action has used up its budget of attempts
    last: str  # why the search for choices ended; "" if all choices were tried

    def lines(self) -> Iterator[str]:
        """Yield the choices of the action with their outcomes, and why the action ended."""
        left_out = len(self.attempts) - 2 * _LISTED
        for number, attempt in enumerate(self.attempts):
            if left_out > 0 and number == _LISTED:
                yield f"... {left_out} more ..."
            if left_out <= 0 or not _LISTED <= number < _LISTED + left_out:
                yield f"step {attempt.started.seq}: {_choice(attempt)}"
                error = attempt.error
                yield f"    {phrases.one_line(': '.join(filter(None, error)))}" if error else "    it hasn't ended"
        for projection in self.imagined[-_MAX_IMAGINED:]:
            outcome = foreseen(projection.finished) if projection.finished is not None else "it hasn't ended"
            yield f"step {projection.started.seq}: imagined, {_choice(projection)}"
            yield f"    {outcome}"
        for query in self.places:
            yield f"step {query.seq}: {phrases.question(query)}"
            yield f"    {fates_text(query) or 'its map had no places left'}"
        if self.last:
            yield f"there was no further choice: {phrases.one_line(self.last)}"
        elif self.spent:
            yield "the budget of attempts was spent"
        elif self.attempts:
            yield "there were no further choices"


def tried(log: RecordReader, failed: Node) -> TriedAction | None:
    """Return the attempts of the outermost failed action around a failed task; None if there is none."""
    actions = [task for task in failed.around() if task.kind == "action" and task.failed]
    if not actions:
        return None
    action = actions[-1]
    handling = [task for task in action.children if task.kind == "failure-handling" and "action" in task.parameters]
    parts = [part for task in handling for part in task.children]
    imagined = [part for part in (*action.children, *parts) if part.kind == "projection"]
    ids = {node.id for _, node in action.walk()}
    queries = log.records(Query, action.started.seq, action.last_step + 1)
    asked = [query for query in queries if query.HasField("grid") and query.task in ids]
    data = {} if action.failure is None else argument_values(action.failure.data)
    last = data.get("last")
    if isinstance(last, dict):  # an exception
        last = last.get("repr") or next(iter(last.values()), "")
    attempts = tuple(part for part in parts if part.kind == "attempt")
    places, error = tuple(asked[-_MAX_PLACES:]), "" if last is None else str(last)
    return TriedAction(action, attempts, tuple(imagined), places, data.get("spent") is True, error)


def _choice(task: Node) -> str:
    """Return the chosen slots and values. A place is identified by its position."""
    chosen = []
    for slot, value in task.parameters.items():
        if isinstance(value, dict) and isinstance(value.get("position"), list):
            chosen.append(f"{slot}={phrases.vector(value['position'])}")  # type: ignore[arg-type]
        elif value is not None:
            chosen.append(f"{slot}={phrases.value(value)}")
    return ", ".join(chosen) or "the given arguments"


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
        """Yield the body as text. For fixed bodies, the text contains only the named links and joints."""
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
            names = [each.body for each in self.holds]
            held = [name + (f" in the {self.hands[name]} gripper" if name in self.hands else "") for name in names]
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
