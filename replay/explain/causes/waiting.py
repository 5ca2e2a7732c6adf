"""A deadline was missed, or the plan was interrupted: the pending tasks, and possible ends of their waits."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby, islice
from typing import Final

from recorder.plan_lines import called_name, last_name, syntax_nodes
from recorder.records import STEPS_PER_SECOND, Fluent, Mutation, Plain, Refusal, Run, Task, argument_values, from_json
from recorder.tasks import Node, State, Tree
from replay.explain.causes import trials
from replay.explain.causes.case import Cause, CausingChange, FailureCase, objects_in
from replay.explain.causes.raised import answers
from replay.explain.causes.trials import Trial
from replay.history.source import Line
from replay.history.tasks import INTERRUPT
from replay.report import phrases

_NO_LEAF: Final = "timeout"  # the only parameter of a wait that isn't the name of a fluent
_MAX_CHANGES: Final = 5
_MAX_TASKS: Final = 10_000
_SETTERS: Final = ("set_value", "pulse")
_SIMULATED_TIME: Final = "simulated"  # value of ``clock`` for a timeout in simulated time
_MAX_TOOK: Final = 3
_NAMES: Final = {"SIGINT": "Ctrl-C", "": "Ctrl-C"}  # early releases didn't record the signal
_FOLLOWS: Final = re.compile(r"(pose|position|joint|holding|contact) of ")  # a fluent of the world; no plan sets it
_JOINTS: Final = re.compile(r"joint of (\S+) of ([^\s)]+)")
_MAX_NAMED: Final = 3  # maximum number of pending tasks that are named


@dataclass(frozen=True, slots=True)
class Fulfiller:
    """A line or task of the plan that could have made a fluent true."""

    line: Line | None  # the line that sets the fluent; None if only a record shows what set it
    task: Node | None  # the task that ran the line, or should have run it
    step: int | None = None  # step at which the task last set the fluent; None if it never did
    failed: Node | None = None  # the last failed motion in the task
    refused: Refusal | None = None  # the last refusal in the task
    sure: bool = True  # whether the line is known to set this fluent; otherwise it sets a fluent under another name

    def __str__(self) -> str:
        if self.failed is not None and self.failed is self.task:
            error = phrases.error(self.failed)
            return f"{phrases.node(self.failed)} could have set it, but failed at step {self.failed.last_step}: {error}"
        if self.line is not None:
            inside = f"{self.line.function} at " if self.line.function not in ("", "<module>") else ""
            sets = "sets it" if self.sure else "perhaps sets it"
            text = f"{inside}{phrases.place(self.line)} {sets}: {phrases.short(self.line.text)}"
        elif self.task is not None:
            text = f"{phrases.node(self.task)} could have set it"
        else:
            text = "the plan's own code could have set it"
        if self.task is not None:
            finished = self.task.finished is not None
            state = f"{self.task.status.word} at step {self.task.last_step}" if finished else "is still running"
            text += f"; {phrases.node(self.task)} {state}"
            text += f", and last set it at step {self.step}" if self.step is not None else " without setting it"
        if self.failed is not None:
            name, error = phrases.node(self.failed), phrases.error(self.failed)
            text += f", after {name} failed at step {self.failed.last_step}: {error}"
        if self.refused is not None:
            error = phrases.failure(self.refused.failure)
            text += f", after {phrases.refused(self.refused)} was refused at step {self.refused.seq}: {error}"
        shown = "no record shows that it was set" if self.step is None else f"it was last set there at step {self.step}"
        return text + (f"; {shown}" if self.task is None else "")


@dataclass(frozen=True, slots=True)
class PendingTask:
    """A task that was unfinished when its part of the plan was stopped."""

    task: Node  # the awaited object: a fluent, a motion, or another task
    began: bool  # whether the task began; if not, it waited for its turn or for parts of the robot
    line: Line | None  # the plan's line
    values: Mapping[str, Plain] = field(default_factory=dict)  # final values of awaited fluents, by name
    changed: tuple[int, ...] = ()  # the last steps that set the awaited fluents
    fulfillers: tuple[Fulfiller, ...] = ()  # lines and tasks that could have set the awaited fluents
    holders: tuple[Node, ...] = ()  # if this motion hadn't begun, the motions that were running
    excluded: str = ""  # limits of the awaited joint that exclude the condition, as text

    def __str__(self) -> str:
        if self.task.kind == "wait":
            branch = next((each.name for each in self.task.around() if each.kind == "branch"), "")
            return f"waiting for {self.task.name}" + (f" in {branch}" if branch else "")
        return f"{'in' if self.began else 'waiting for the turn of'} {phrases.node(self.task)}"

    def steps(self) -> Iterator[int | None]:
        """Yield the steps of the task's records; None for records that don't exist."""
        yield self.task.started.seq
        yield from self.changed
        for each in self.fulfillers:
            yield each.step
            yield from (task.last_step for task in (each.task, each.failed) if task is not None)
            yield each.refused.seq if each.refused is not None else None

    def details(self) -> Iterator[str]:
        """Yield why the task waited: fluents with their values and setters, or running motions."""
        if self.task.kind == "wait":
            values = ", ".join(f"{name} = {phrases.value(value)}" for name, value in self.values.items())
            changed = f"; it last changed at step {self.changed[-1]}" if self.changed else ""
            since = f"waited since step {self.task.started.seq}{phrases.at(self.line)}"
            yield f"{self.task.name}: {values}{changed}  [{since}]"
            yield from [self.excluded] if self.excluded else []
            yield from map(str, self.fulfillers)
            leaves = " or ".join(name for name in self.values or (self.task.name,) if not _FOLLOWS.match(name))
            if leaves and not (self.fulfillers or self.changed):
                yield f"no record shows a setter of {leaves}, and no line of the plan's source sets a fluent by name"
        elif self.holders:
            holders = [f"{phrases.node(task)} (since step {task.started.seq})" for task in self.holders]
            yield f"{phrases.node(self.task)} waited for {phrases.names(holders)}{phrases.at(self.line)}"


def _doing(pending: Sequence[PendingTask]) -> str:
    doing = [str(each) for each in pending[:_MAX_NAMED]]
    doing += [f"{len(pending) - _MAX_NAMED} more"] if len(pending) > _MAX_NAMED else []
    return " and ".join(doing) or "executing the plan's own code"


@dataclass(frozen=True, slots=True)
class SimulatedLine:
    """The simulated time that one line of the plan took."""

    line: Line | None
    seconds: float  # simulated time in s
    steps: tuple[int, ...]  # steps of the line's records

    def __str__(self) -> str:
        at = f"{phrases.place(self.line)} simulated" if self.line is not None else "the block simulated"
        calls = f" in {len(self.steps)} calls" if len(self.steps) > 1 else ""
        return f"{at} {phrases.number(self.seconds)} s{calls}"


@dataclass(frozen=True, slots=True)
class Timeout(Cause):
    """A part of the plan missed its deadline."""

    kind = "timeout"
    untestable = "no value that a fork can set ends the wait"
    seconds: float  # the limit in s; 0 in a deadlock
    clock: str  # clock of the limit: "wall" or "simulated"; "" in a deadlock
    pending: tuple[PendingTask, ...]  # the pending tasks at the deadline
    line: Line | None  # the plan's line that was stopped
    took: tuple[Node, ...] = ()  # the tasks that ended within the limit, the longest by the limit's clock first
    simulated: tuple[SimulatedLine, ...] = ()  # lines with the longest simulations, if the limit is in simulated time
    joints: tuple[tuple[float, CausingChange], ...] = ()  # positions and last changes of joints, awaited in a deadlock

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Timeout]:
        """Yield the missed deadline of a timeout, or of a wait after which the plan raised the failure."""
        if case.task is not None and case.task.kind == "timeout" and case.failure.type == "TimedOut":
            tree = _tree(case, case.task.last_step + 1)
            scope = tree.nodes[case.task.id]
            doing = tuple(_pending(case, node, tree, case.step) for node in _stopped(tree, scope))
            seconds, clock = _limit(case.task.parameters.get("seconds")), str(case.task.parameters.get("clock"))
            took = sorted(_ended(scope), key=lambda node: -_duration(node, clock))[:_MAX_TOOK]
            simulated = _longest_simulated(case, scope) if clock == _SIMULATED_TIME else ()
            stop = next((error for error in case.traced if error.type == "Cancelled" and error.lines), None)
            line = case.line(stop.lines) if stop is not None else None  # the deadline stopped this line
            yield _with_steps(case, Timeout((), seconds, clock, doing, line, tuple(took), simulated))
            return
        if case.failure.type == "DeadlockedBranches":
            tree = _tree(case, case.step + 1)
            waits = _stopped(tree, tree.nodes[case.task.id] if case.task is not None else None)
            pending = tuple(_pending(case, node, tree, case.step) for node in waits if node.kind == "wait")
            moved = tuple(_awaited_joints(case))
            deadlock = _with_steps(case, Timeout((), 0.0, "", pending, None, joints=moved))
            yield from [deadlock] if pending or moved else []
            return
        for wait in list(answers(case))[-1:]:
            if isinstance(wait, Task) and from_json(wait.result_json) is False:
                tree = _tree(case, case.step + 1)
                node = tree.nodes[wait.task]
                seconds, single = _limit(node.parameters.get("timeout")), _pending(case, node, tree, wait.seq)
                yield _with_steps(case, Timeout((), seconds, "wall", (single,), case.line_of(node.started)))

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials with a longer limit, and with other values of the awaited fluents."""
        limited = case.task if case.task is not None and case.task.kind == "timeout" else self.pending[0].task
        if not self.pending or not all(each.excluded for each in self.pending):  # else, more time doesn't help
            yield from trials.longer(limited.started, self.seconds)  # a deadlock has no limit
        for each in self.pending:
            if each.task.kind == "wait" and not each.excluded:
                for trial in trials.fulfilled(each.task.started, each.values):
                    yield replace(trial, partial=len(self.pending) > 1)

    def _words(self) -> Iterator[str]:
        simulated = " of simulated time" if self.clock == _SIMULATED_TIME else ""
        limit = (
            f"after {self.seconds:g} s{simulated} the plan was still" if self.clock else "in a deadlock, the plan was"
        )
        yield f"{limit} {_doing(self.pending)}{phrases.at(self.line)}"
        yield from (line for pending in self.pending for line in pending.details())
        for position, change in self.joints:
            now = phrases.number(position)
            yield f"a branch waits for {change.joint} of {change.body}, which is at {now}; {change.row}"
        if self.took and not any(pending.task.kind == "wait" for pending in self.pending):
            times = ((task, round(_duration(task, self.clock) * 1e9)) for task in self.took)
            took = [f"{phrases.node(task)} {phrases.seconds(time_ns)}" for task, time_ns in times if time_ns]
            if took:
                yield f"before the deadline: {', '.join(took)}"
            for error, tasks in groupby((task for task in self.took if task.failed), phrases.error):
                yield f"{phrases.names([phrases.node(task) for task in tasks])} failed: {error}"
        yield from map(str, self.simulated)


@dataclass(frozen=True, slots=True)
class EndedWait(Cause):
    """A wait ended immediately, because its fluent was False, which is a value."""

    kind = "ended-wait"
    fluent: str
    line: Line | None  # the plan's line that waited

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[EndedWait]:
        """Yield the last wait that ended in this way."""
        for task in islice(case.log.backwards(case.step, Task), _MAX_TASKS):
            began = (task.kind, task.phase) == ("wait", Task.STARTED)
            if began and argument_values(task.parameters).get(task.name) is False:
                yield EndedWait(case.steps(task.seq), task.name, case.line_of(task))
                return

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial in which the fluent has no value, so that the wait lasts until a value is set."""
        earlier = next(case.log.backwards(self.steps[0] - 1, (Task, Mutation, Fluent)), None)  # before the warning
        if earlier is not None and not _FOLLOWS.match(self.fluent):
            yield Trial(earlier.seq, f"{self.fluent} has no value", (f"{trials.FLUENT}{self.fluent}=null",))

    def _words(self) -> Iterator[str]:
        wait = f"the wait for {self.fluent} ended immediately at step {self.steps[0]}{phrases.at(self.line)}"
        yield f"{wait}: the fluent was False, which is a value"


@dataclass(frozen=True, slots=True)
class Interruption(Cause):
    """The plan was interrupted, or its process ended."""

    kind = "interrupted"
    by: str  # "Ctrl-C", "SIGTERM"; "" if the process ended without closing its recording
    pending: tuple[PendingTask, ...]  # the pending tasks
    line: Line | None  # the plan's line that was stopped

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Interruption]:
        """Yield the interrupt of a plan, and the pending tasks."""
        end = case.log[-1]
        closed = isinstance(end, Run) and end.phase == Run.FINISHED
        if case.failure.type != (INTERRUPT if closed else ""):  # failures before the interrupt have other causes
            return
        by = _NAMES.get(end.interrupted_by, end.interrupted_by) if isinstance(end, Run) and closed else ""
        tree = _tree(case, len(case.log))
        doing = tuple(_pending(case, node, tree, case.step) for node in (_interrupted(tree) if by else _stopped(tree)))
        error = next(reversed(case.traced), None)
        line = case.line(error.lines) if error is not None and error.lines else None
        yield Interruption(case.steps(*(step for each in doing for step in each.steps())), by, doing, line)

    def _words(self) -> Iterator[str]:
        by = f"interrupted by {self.by}" if self.by else "its process ended without closing the recording"
        yield f"{by} while {_doing(self.pending)}{phrases.at(self.line)}"
        yield from (line for pending in self.pending for line in pending.details())


# --- pending tasks ---------------------------------------------------------------------------------------------------


def _interrupted(tree: Tree) -> list[Node]:
    """Return the innermost tasks that the interrupt ended or cancelled."""
    hit = [node for _, node in tree.walk() if node.error is not None and node.error[0] == INTERRUPT]
    found: list[Node] = []
    for node in hit:
        cancelled = [part for part in _stopped(tree, node) if part.status is State.CANCELLED]
        if not any(child in hit for child in node.children):
            found += cancelled or [node]
    return found


def _tree(case: FailureCase, stop: int) -> Tree:
    """Return the tasks before a step; if there are many, only the last ones."""
    tree = Tree(limit=_MAX_TASKS)
    for record in case.log.records(Task, stop=stop):
        tree.apply(record)
    return tree


def _stopped(tree: Tree, root: Node | None = None) -> list[Node]:
    """Return the innermost cancelled or unfinished tasks in a tree or below a task."""
    nodes = [node for _, node in (root.walk() if root is not None else tree.walk())]

    def is_open(node: Node) -> bool:
        return node is not root and node.status in (State.CANCELLED, State.RUNNING, State.CREATED)

    return [node for node in nodes if is_open(node) and not any(is_open(child) for child in node.children)]


def _pending(case: FailureCase, node: Node, tree: Tree, step: int) -> PendingTask:
    """Return a pending task at a step. ``tree`` contains the tasks that ran in parallel."""
    line = case.line_of(node.asked or node.started)
    motion = node.motion if node.motion.kind == "motion" else node
    if node.kind == "wait":
        leaves = {name: value for name, value in node.parameters.items() if name != _NO_LEAF}
        values, changed = _values(case, leaves, node.started.seq, step)
        fulfillers = tuple(_fulfillers(case, leaves, tree, step))
        return PendingTask(node, True, line, values, changed, fulfillers, excluded=_excluded(case, node.name))
    inner = [child for child in node.children if child.kind == "process-module"]
    if motion.kind != "motion" or inner or node.kind == "process-module":
        return PendingTask(node, node.start is not None, line)

    def ran(other: Node) -> bool:
        begun = other.started.seq < step and any(child.kind == "process-module" for child in other.children)
        return begun and (other.finished is None or other.last_step > node.started.seq)

    others = (each for _, each in tree.walk() if each.kind == "motion" and each is not motion)
    return PendingTask(node, False, line, holders=tuple(filter(ran, others)))


def _excluded(case: FailureCase, condition: str) -> str:
    """Return the limits of a joint that exclude a condition such as ``joint of ELBOW of pr2 > 4``."""
    compared = trials.COMPARED.fullmatch(condition)
    joint = trials.JOINT.fullmatch(compared[1]) if compared else None
    limits = case.limits(joint[2], joint[1]) if joint else None
    try:
        wanted = float(compared[3]) if compared else 0.0
    except ValueError:
        return ""
    if limits is None or compared is None or joint is None:
        return ""
    below, above = wanted < limits[0], wanted > limits[1]
    if not {">": above, "<": below}.get(compared[2][0], above or below):
        return ""
    span = f"{phrases.number(limits[0])} to {phrases.number(limits[1])}"
    return f"{joint[1]} of {joint[2]} goes from {span}, so it never becomes true"


def _awaited_joints(case: FailureCase) -> Iterator[tuple[float, CausingChange]]:
    """Yield the positions of the joints that the message of a deadlock names, with their last changes."""
    for joint, name in dict.fromkeys(_JOINTS.findall(case.failure.message)):
        body = case.world.bodies.get(name) if case.world is not None else None
        change = case.changed(f"{name}.{joint}")
        if body is not None and change is not None and joint in body.joints:
            yield body.joints[joint], change


def _values(
    case: FailureCase, leaves: Mapping[str, Plain], start: int, step: int
) -> tuple[dict[str, Plain], tuple[int, ...]]:
    """Return the values of fluents at a step, and the last steps that set them, searched from ``start``."""
    values, changed = dict(leaves), []
    for record in case.log.records(Fluent, start, step + 1):
        if record.name in leaves:
            values[record.name] = from_json(record.after_json)
            changed.append(record.seq)
    return values, tuple(changed[-_MAX_CHANGES:])


def _fulfillers(case: FailureCase, leaves: Mapping[str, Plain], tree: Tree, step: int) -> Iterator[Fulfiller]:
    """Yield the setters of the fluents in the plan's source; if there are none, the recorded setters."""
    found = False
    records = [record for record in case.log.records(Fluent, stop=step + 1) if record.name in leaves]
    last = {record.name: record for record in records}
    at = {(each.name, line.number, line.text): each.seq for each in records for line in case.source.call_stack(each)}
    for name in leaves:
        if _FOLLOWS.match(name):
            continue
        record = last.get(name)
        lines = ((file, line) for file in case.source.files for line in _setters(case.source.text(file), name))
        for file, (number, sure) in lines:
            line = case.source.line(file, number)
            task = _task_of(tree, line.function, step) if line is not None else None
            failed = _failed_in(case, task)
            done = record.seq if record is not None and task is not None and _is_in(record.task, task) else None
            done = at.get((name, number, line.text)) if line is not None and task is None else done
            found = True
            yield Fulfiller(line, task, done, failed, _refused_in(case, task, step), sure)
    if found:
        return
    for record in last.values():
        task = tree.nodes.get(record.task)
        if not record.source:
            yield Fulfiller(case.line_of(task.started) if task is not None else None, task, record.seq)
    for name in leaves:
        failed = _failed_about(case, name, step)
        if failed is not None:
            yield Fulfiller(case.line_of(failed.started), failed, None, failed)


def _failed_about(case: FailureCase, name: str, step: int) -> Node | None:
    """Return the last failed motion with an object or parameter whose name the fluent's name contains."""
    words = set(name.replace("(", " ").replace(")", " ").split())
    for motion in reversed(case.failed.motions):
        if motion.last_step <= step and motion.failed:
            given = {*objects_in(list(motion.parameters.values())), *map(str, motion.parameters.values())}
            if words & given:
                return motion
    return None


@lru_cache(maxsize=64)
def _setters(text: str, name: str) -> tuple[tuple[int, bool], ...]:
    """Return the numbers of the lines that set a fluent, and whether the variable shows that it is this fluent.

    A variable that holds another fluent is left out. Other variables may be parameters for any fluent.
    """
    nodes = syntax_nodes(text)
    named: dict[str, set[str]] = defaultdict(set)  # names of the fluents in each variable
    for node in nodes:
        for target in node.targets if isinstance(node, ast.Assign) else ():
            for variable, value in _assigned(target, node.value):  # type: ignore[attr-defined]
                if isinstance(value, ast.Call) and called_name(value) == "Fluent":
                    given = [*value.args[1:2], *(each.value for each in value.keywords if each.arg == "name")]
                    named[variable] |= {str(each.value) for each in given if isinstance(each, ast.Constant)}
    calls = (node.func for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute))
    setters = [(call.lineno, named.get(last_name(call.value))) for call in calls if call.attr in _SETTERS]
    sure = [(line, True) for line, fluents in setters if fluents and name in fluents]
    return tuple(sure or [(line, False) for line, fluents in setters if not fluents])


def _assigned(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(target, ast.Tuple | ast.List) and isinstance(value, ast.Tuple | ast.List):
        for each, of in zip(target.elts, value.elts, strict=False):
            yield from _assigned(each, of)
    else:
        yield last_name(target), value


def _task_of(tree: Tree, function: str, step: int) -> Node | None:
    """Return the last branch that runs a function of the plan."""
    named = [node for _, node in tree.walk() if node.kind == "branch" and node.name.rpartition(".")[2] == function]
    return next((node for node in reversed(named) if node.created.wall_ns and node.started.seq <= step), None)


def _failed_in(case: FailureCase, task: Node | None) -> Node | None:
    if task is None:
        return None
    inside = (motion for motion in reversed(case.failed.motions) if motion.failed)
    return next((motion for motion in inside if any(each.id == task.id for each in motion.around())), None)


def _refused_in(case: FailureCase, task: Node | None, step: int) -> Refusal | None:
    if task is None or not case.log.counts().get("refusal"):
        return None
    refusals = case.log.records(Refusal, task.started.seq, step + 1)
    return next((each for each in reversed(list(refusals)) if _is_in(each.task, task)), None)


def _is_in(number: int, task: Node) -> bool:
    return any(node.id == number for _, node in task.walk())


# --- deadlines -------------------------------------------------------------------------------------------------------


def _ended(scope: Node) -> Iterator[Node]:
    """Yield the tasks that ended within a scope; also those in unfinished blocks."""
    for node in scope.children:
        if node.status in (State.SUCCEEDED, State.FAILED):
            yield node
        else:
            yield from _ended(node)


def _duration(node: Node, clock: str) -> float:
    """Return the duration of a task by a clock in s."""
    if clock == _SIMULATED_TIME and node.start is not None and node.end is not None:
        return node.end.sim_seconds - node.start.sim_seconds
    return node.seconds or 0.0


def _longest_simulated(case: FailureCase, scope: Node) -> tuple[SimulatedLine, ...]:
    lines: dict[Line | None, list[Mutation]] = defaultdict(list)
    for record in case.log.records(Mutation, scope.started.seq, scope.last_step):
        if record.HasField("simulate") and case.is_here(record):
            lines[case.line_of(record)].append(record)
    found = []
    for line, records in lines.items():
        seconds = sum(record.simulate.steps for record in records) / STEPS_PER_SECOND
        found.append(SimulatedLine(line, seconds, tuple(record.seq for record in records)))
    return tuple(sorted(found, key=lambda each: -each.seconds)[:_MAX_TOOK])


def _limit(seconds: object) -> float:
    return float(seconds) if isinstance(seconds, int | float) else 0.0


def _with_steps(case: FailureCase, found: Timeout) -> Timeout:
    shown = [*(step for each in found.pending for step in each.steps()), *(node.last_step for node in found.took)]
    steps = case.steps(*shown, *(each.steps[-1] for each in found.simulated), *(change for _, change in found.joints))
    return replace(found, steps=steps)
