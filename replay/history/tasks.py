"""The tasks of a recording: failures and their root cause, the tasks around a record, the task tree, and a summary.

The root cause is the failure that explains the end of a plan: the task that raised the plan's exception or its nearest
cause, or else the plan's own code; the point of an interrupt; or the exception of a failed thread. If the plan
succeeded, the root cause is the last failure without a recovery, or else the last failure. To limit memory, only some
tasks are kept: failures, motions, and the last task of each kind and name.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from recorder.records import STEPS_PER_SECOND, Failure, Output, Query, Record, Run, Task, format_failure
from recorder.records.text import is_choice
from recorder.tasks import Node, Tree, decisive
from replay.errors import Damaged, Unreadable
from replay.file.record_reader import RecordReader

if TYPE_CHECKING:
    from replay.history.source import Line, ParsedException

_RUN_RECORDS: Final = 2  # number of run records in a run in which no thread fails
INTERRUPT: Final = "KeyboardInterrupt"  # the exception of an interrupted plan
_MAX_KEPT: Final = 5_000  # largest number of failures or motions; each takes about 3 kB


@dataclass(frozen=True, slots=True)
class Failures:
    """Failed, unfinished and successful tasks; successful parts of other tasks are left out."""

    origins: tuple[Node, ...]  # the last tasks in which failures began, in the order of their ends
    running: tuple[Node, ...]  # unfinished tasks, in the order of their starts
    successes: Mapping[tuple[str, str], Node]  # the last successful task of each kind and name
    motions: tuple[Node, ...] = ()  # the last finished motions, in the order of their ends
    forgotten: int = 0  # number of failures that were dropped
    first_motion: int | None = None  # step at which the first motion began; None if there was none

    @property
    def last_success(self) -> Node | None:
        """The last successful motion; if there is none, the last successful task."""
        motions = [task for (kind, _), task in self.successes.items() if kind == "motion"]
        return max(motions or self.successes.values(), key=lambda task: task.last_step, default=None)


def failures(log: RecordReader, stop: int | None = None) -> Failures:
    """Return the failures of a recording, or of the part before the step ``stop``."""
    running: dict[int, Node] = {}
    successes: dict[tuple[str, str], Node] = {}
    origins: deque[Node] = deque()
    motions: deque[Node] = deque(maxlen=_MAX_KEPT)
    forgotten, first_motion = 0, None
    for record in log.records(Task, stop=stop):
        if first_motion is None and record.kind == "motion":
            first_motion = record.seq
        number, parent = record.task, running.get(record.parent)
        if record.phase == Task.STARTED:
            running[number] = Node(record, parent)
            if parent is not None:
                parent.parts[number] = running[number]
        elif record.phase == Task.FINISHED:
            task = running.pop(number, None) or Node(record, parent)
            task.finished = record
            if task.is_origin:
                forgotten += _keep(origins, task)
            if task.kind == "motion":
                motions.append(task)
            if task.parent is not None and not task.failed:
                task.parent.parts.pop(number, None)
            if record.status == Task.SUCCEEDED:
                successes[record.kind, record.name] = task
    return Failures(tuple(origins), tuple(running.values()), successes, tuple(motions), forgotten, first_motion)


def _keep(origins: deque[Node], task: Node) -> int:
    """Add a task in which a failure began; return the number of tasks that were dropped."""
    origins.append(task)
    if len(origins) <= _MAX_KEPT:
        return 0
    outer = origins.popleft().outermost_failed
    if outer.parent is not None:
        outer.parent.parts.pop(outer.id, None)
    return 1


def failed_threads(log: RecordReader) -> tuple[Run, ...]:
    """Return the records of the plan's threads that failed while the plan continued."""
    if log.counts().get("run", 0) <= _RUN_RECORDS:
        return ()
    return tuple(record for record in log.records(Run) if record.phase == Run.THREAD_FAILED)


@dataclass(frozen=True, slots=True)
class RootCause:
    """The root cause of a failure."""

    #: The step of the task's end. If the plan's own code failed, the step is the last one before worlds were closed, or
    #: the end of the thread.
    step: int
    task: Node | None  # the task in which the failure began; None for the plan's own code
    failure: Failure | None = None  # failure of the plan or of a thread; None if both succeeded
    thread: str = ""  # name of the failed thread; "" if the plan failed
    exceptions: tuple[ParsedException, ...] = ()  # exceptions from the task's to the plan's, the causes first


def root_cause(log: RecordReader, failed: Failures | None = None) -> RootCause | None:
    """Return the root cause; None if there are no failures."""
    failed = failed if failed is not None else failures(log)
    end = uncaught_failure(log)
    if end is None:
        task = decisive(failed.origins)
        return RootCause(task.last_step, task) if task is not None else None
    thread = end.thread if end.phase == Run.THREAD_FAILED else ""
    from replay.history.source import ParsedException, PlanSource, parse_traceback  # noqa: PLC0415  slow to import

    parsed = parse_traceback(end.failure.traceback, PlanSource(log))
    last = parsed.pop() if parsed else ParsedException("", "", ())  # the record contains the failure's message
    exceptions = (*parsed, ParsedException(end.failure.type, end.failure.message, last.lines, last.own))
    earlier = [task for task in failed.origins if task.last_step < end.seq]  # later tasks may fail with the same error
    if end.failure.type == INTERRUPT:  # failures of earlier tasks didn't end the plan
        exceptions = exceptions[-1:]
        earlier = [task for task in earlier if task.error is not None and task.error[0] == INTERRUPT]
    origin = _origin(earlier, exceptions)
    if origin is None:
        return RootCause(end.seq if thread else log.final_step(), None, end.failure, thread, exceptions)
    task, first = origin
    return RootCause(task.last_step, task, end.failure, thread, exceptions[first:])


def uncaught_failure(log: RecordReader) -> Run | None:
    """Return the record of the plan's uncaught failure, or of the last failed thread."""
    end = log[-1]
    if isinstance(end, Run) and end.HasField("failure"):
        return end
    return next(reversed(failed_threads(log)), None)


def _origin(origins: Sequence[Node], exceptions: Sequence[ParsedException]) -> tuple[Node, int] | None:
    """Return the task that raised the failure or its nearest cause, and the index of the exception.

    The plan has handled earlier exceptions, even if Python's traceback contains them. If several tasks of a block
    failed, return the task whose error became the error of the block.
    """
    for number in range(len(exceptions) - 1, -1, -1):
        error = exceptions[number].type, exceptions[number].message
        raising = [task for task in origins if any(outer.error == error for outer in task.around())]
        if raising:
            return next((task for task in reversed(raising) if task.error == error), raising[-1]), number
    return None


@dataclass(frozen=True, slots=True)
class CausingTask:
    """A task around a record."""

    started: Task  # the record of its start
    call_stack: tuple[Line, ...]  # the plan's lines that led to the task, outermost first; empty if they are unknown


@dataclass(frozen=True, slots=True)
class CausingTasks:
    """The tasks around a record, and the lines of the plan that led to the record."""

    tasks: tuple[CausingTask, ...]  # the tasks around the record, innermost first; empty outside of tasks
    #: The plan's lines that led to the record, outermost first: the lines of the record, or of the innermost task with
    #: lines.
    call_stack: tuple[Line, ...]


def causing_tasks(log: RecordReader, record: Record) -> CausingTasks:
    """Return the tasks that enclose a record. The record of a task counts as inside the task."""
    from replay.history.source import PlanSource  # noqa: PLC0415  as above

    source = PlanSource(log)
    tasks = []
    number = record.task
    for started in log.backwards(record.seq, Task) if number else ():
        if started.phase == Task.STARTED and started.task == number:  # parents start before their children
            tasks.append(CausingTask(started, source.call_stack(started)))
            number = started.parent
            if not number:
                break
    stacks = [source.call_stack(record), *(task.call_stack for task in tasks)]
    return CausingTasks(tuple(tasks), next(filter(None, stacks), ()))


def choices(log: RecordReader, failed: Node, stop: int | None = None) -> Iterator[Query]:
    """Yield the choices of the motion around a failed task, and of the motion's parts."""
    motion = failed.motion
    ids = {node.id for _, node in motion.walk()}
    end = motion.last_step + 1
    for query in log.records(Query, motion.started.seq, end if stop is None else min(stop, end)):
        if is_choice(query) and query.task in ids:
            yield query


def tree(log: RecordReader, stop: int | None = None) -> Tree:
    """Return the task tree of a recording, by default at the end. If tasks are nested too deep, Damaged is raised."""
    from replay.state.integrity import too_deep  # noqa: PLC0415  a summary doesn't need the tree

    folded = Tree()
    depths: dict[int, int] = {}
    for record in log.records((Task, Output), stop=stop):
        if isinstance(record, Output):
            folded.output.setdefault(record.task, []).append(record)
        elif isinstance(record, Task):
            if cause := too_deep(record, depths):
                raise Damaged(log.path, f"step {record.seq}", cause)
            folded.apply(record)
    if stop is None and uncaught_failure(log) is not None:
        broken = root_cause(log)  # the plan's failure explains more than a task's failure
        folded.began = broken.task.id if broken is not None and broken.task is not None else 0
    failed = folded.failure_path()
    if failed:
        for choice in choices(log, failed[-1], stop):
            folded.nodes[choice.task].choices.append(choice)
    return folded


#: Size in bytes up to which a recording is read completely. Of larger recordings, only both ends are read.
MAX_CHECKED: Final = 16 << 20


@dataclass(frozen=True, slots=True)
class WorldTime:
    """A world and its clock."""

    world: str
    lifetime: int  # number of the world's lifetime, from 1
    seconds: float  # simulated time at the last change, s


@dataclass(frozen=True, slots=True)
class Summary:
    """A summary of a recording."""

    plan: str
    started: datetime  # wall-clock time of the first record, UTC
    seconds: float  # time from the first to the last record, s
    worlds: tuple[WorldTime, ...]  # the worlds in the order of their opening
    outcome: str  # "succeeded", "failed", "interrupted", "running", "cut off", or "lost" if the end is damaged
    failure: str  # failure of the plan, such as "Type: message"; "" without a failure
    #: Names and failures of threads of the plan that failed while the plan continued.
    threads: tuple[tuple[str, str], ...]
    records: int  # number of steps
    counts: Mapping[str, int]  # number of records of each kind
    attachments: int
    size: int  # size of the file in bytes
    problems: str  # missing or damaged parts, as text; "" if there are none
    checked: bool  # whether the whole file was read
    metadata: Mapping[str, str]  # metadata of the run
    start: Run | None  # the first record, with the plan's arguments; None if the record is lost


def summary(log: RecordReader) -> Summary:
    """Summarise a recording; raise Unreadable if all records are damaged."""
    size = log.path.stat().st_size
    checked = size <= MAX_CHECKED
    problems = log.check_file() if checked else log.problems
    first, last = next(log.records(), None), next(log.backwards(), None)
    if first is None or last is None:
        raise Unreadable(log.path, f"has no record that can be read: {problems}")
    end = last if isinstance(last, Run) and last.phase == Run.FINISHED else None
    is_lost = end is None and any(gap.start >= len(log) for gap in log.missing())
    unfinished = "running" if log.live else "lost" if is_lost else "cut off"
    failed = "interrupted" if end is not None and end.failure.type == INTERRUPT else "failed"
    outcome = unfinished if end is None else "succeeded" if end.succeeded else failed
    elapsed_ns = last.monotonic_ns - first.monotonic_ns  # this is correct even if the wall clock jumped
    if not last.monotonic_ns:  # old recordings lack this steady clock
        elapsed_ns = last.wall_time_ns - first.wall_time_ns
    ends = [(lifetime, log.end_of(lifetime)) for lifetime in log.lifetimes]
    steps = [(lifetime, end.sim_step if end is not None else 0) for lifetime, end in ends]
    return Summary(
        plan=log.metadata.get("plan", ""),
        started=datetime.fromtimestamp(first.wall_time_ns / 1e9, UTC),
        seconds=elapsed_ns / 1e9,
        worlds=tuple(WorldTime(each.world, each.number, step / STEPS_PER_SECOND) for each, step in steps),
        outcome=outcome,
        failure=format_failure(end.failure) if end is not None and end.HasField("failure") else "",
        threads=tuple((record.thread, format_failure(record.failure)) for record in failed_threads(log)),
        records=len(log),
        counts=log.counts(),
        attachments=len(log.assets),
        size=size,
        problems=problems,
        checked=checked,
        metadata=log.metadata,
        start=first if isinstance(first, Run) else None,
    )
