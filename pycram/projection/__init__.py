"""Projection: a forked copy of the process executes an action, and returns the outcome (thesis 6.3; CRAM).

The copy continues from this moment with the plan, its worlds and its random numbers, so it gets exactly the results
that this process would get. Other branches of the plan don't run in the copy. This process waits for the outcome.
"""

from __future__ import annotations

import pickle
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from pycram.foundation import checks
from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.language.branch import name_of, run
from pycram.projection.child import (
    Child,
    ChildPool,
    ChildResult,
    can_limit_memory,
    limit_memory,
    obstacle,
    usable_cores,
)
from pycram.scheduling.schedule import refuse_held
from pycram.world import saved_state
from pycram.world.object import Object
from pycram.world.saved_state import SavedState
from pycram.world.world import BulletWorld, current_world, open_worlds
from recorder import html, records
from recorder.recording import record
from recorder.records import format_error
from recorder.records.tracebacks import result_or
from recorder.tracing import journal
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.span import Span

__all__ = ["Candidate", "NotProjectable", "Outcome", "ProjectedError", "ProjectionDied", "project", "project_all"]

Result: TypeAlias = Any
Action: TypeAlias = Callable[..., Result]
_MAX_MEMORY: Final = 10**12  # bytes
_given: Final[set[Path]] = set()  # files that projections of this process record into
_projected: ContextVar[bool] = ContextVar("pycram_projected", default=False)

#: An action, or a tuple of an action and its arguments, as in ``(pick_up, milk, "left")``.
Candidate: TypeAlias = "Action | tuple[Any, ...]"


class NotProjectable(UsageError):
    """The process can't be copied, so an action can't be projected."""

    def __init__(self, cause: str) -> None:
        super().__init__(f"an action can't be projected here: {cause}")
        self.cause = cause  # why the process can't be copied, and a remedy


class ProjectionDied(PlanFailure):
    """The process of a projected action ended without an answer."""

    def __init__(self, action: str, cause: str) -> None:
        super().__init__(f"the projection of {action} {cause}")
        self.action = action  # name of the action
        self.cause = cause  # why the process ended


class ProjectedError(PlanFailure):
    """A projected action failed with an error that can't be sent to this process."""

    def __init__(self, error: str) -> None:
        super().__init__(error)
        self.error = error  # the error, as text


export("pycram.projection", NotProjectable, ProjectionDied, ProjectedError)


@dataclass(frozen=True, slots=True, repr=False)
class Outcome:
    """The result of a projected action."""

    action: str  # name of the action
    succeeded: bool
    #: The action's return value, in which objects belong to this process; None if the value can't be pickled.
    result: Result = None
    #: The action's error: ProjectionDied after a crash or at a limit, ProjectedError if the error can't be pickled.
    failure: BaseException | None = None
    duration: float = 0.0  # seconds of simulated time that passed in the current world
    #: The current world's final state, for ``world.restore``; None without a world, or if a body followed a trajectory.
    state: SavedState | None = None
    recording: Path | None = None  # None if there is no recording
    unsent: str = ""  # text of a return value that can't be pickled

    def __bool__(self) -> bool:
        return self.succeeded

    def __repr__(self) -> str:
        return f"<Outcome {self._summary()}>"

    def _repr_html_(self) -> str:
        recording = [f"recording: {self.recording}"] if self.recording is not None else []
        return html.page(self._summary(), html.text(recording))

    def _summary(self) -> str:
        failed = f": {format_error(self.failure)}" if self.failure is not None else ""
        ended = "succeeded" if self.succeeded else f"failed{failed}"
        return " ".join(f"{self.action} {ended}, after {self.duration:.3f} s of simulated time".split())

    def __record__(self) -> object:
        """Return the outcome in the form in which the projection's task is recorded."""
        return {
            "succeeded": self.succeeded,
            "result": self.result,
            "failure": None if self.failure is None else format_error(self.failure),
            "duration": self.duration,
            "recording": None if self.recording is None else str(self.recording),
        } | ({"unsent": self.unsent} if self.unsent else {})


def is_projected() -> bool:
    """Return whether this process is a copy that projects an action."""
    return _projected.get()


def project(
    action: Action, *args: object, timeout: float | None = None, memory: float | None = None, **kwargs: object
) -> Outcome:
    """Run an action in a copy of this process, and return its outcome.

    Args:
        timeout: Seconds of wall-clock time after which the copy is killed; None for no limit.
        memory: Megabytes of additional memory for the copy; None for no limit.

    Raises:
        NotProjectable: A world has a window or runs in real time, the plan has other threads, or the system can't fork.
        BadArgument: The action isn't callable, or a limit is wrong.
        LockHeld: The caller holds a lock.
    """
    names = [_name(action)]
    (outcome,) = _project_all([partial(action, *args, **kwargs)], names, "all", timeout, memory)
    return outcome


def project_all(
    candidates: Sequence[Candidate],
    until: Literal["first", "all"] = "first",
    *,
    timeout: float | None = None,
    memory: float | None = None,
) -> list[Outcome]:
    """Run actions in copies of this process, in parallel on all cores, and return their outcomes in order.

    Args:
        candidates: Actions; preferred actions come first.
        until: With "first", the outcomes end with the first candidate in order that succeeds; later candidates are
            killed. With "all", all candidates run until they end.
        timeout: Seconds of wall-clock time for each candidate; None for no limit.
        memory: Megabytes of additional memory for each candidate; None for no limit.

    Raises:
        BadArgument: A candidate isn't callable, or an argument is wrong. :func:`project` describes other errors.
    """
    if until not in ("first", "all"):
        raise BadArgument("until", until, '"first" or "all"')
    calls: list[tuple[Any, ...]] = [each if isinstance(each, tuple) else (each,) for each in candidates]
    names = [_name(call[0] if call else None) for call in calls]
    return _project_all([partial(call[0], *call[1:]) for call in calls], names, until, timeout, memory)


def _name(action: object) -> str:
    if not callable(action):
        raise BadArgument("action", action, "a function of the plan, or a tuple of a function and its arguments")
    return name_of(action.func if isinstance(action, partial) else action)


def _limits(timeout: float | None, memory: float | None) -> tuple[float | None, int | None]:
    """Check the limits, and return them in seconds and in bytes."""
    seconds = None if timeout is None else checks.number("timeout", timeout)
    if seconds is not None and seconds <= 0:
        raise BadArgument("timeout", timeout, "seconds, more than 0")
    room = None if memory is None else round(checks.number("memory", memory) * 1e6)
    if room is not None and not 0 < room < _MAX_MEMORY:
        raise BadArgument("memory", memory, f"megabytes, more than 0 and up to {_MAX_MEMORY / 1e6:g}")
    return seconds, room


def _project_all(
    actions: Sequence[Action], names: Sequence[str], until: str, timeout: float | None, memory: float | None
) -> list[Outcome]:
    limit, room = _limits(timeout, memory)
    refuse_held()
    if cause := obstacle():
        raise NotProjectable(cause)
    if room is not None and not can_limit_memory():
        raise NotProjectable("this system can't limit the memory of a copy; leave out the argument memory")
    projections: dict[int, _Projection] = {}
    outcomes: dict[int, Outcome] = {}  # outcomes of the candidates that have ended
    recorded: list[Outcome] = []
    needed = len(actions)
    waiting = deque(range(needed))
    pool: ChildPool[int] = ChildPool(usable_cores(), limit)
    with ExitStack() as ending:

        def start(number: int) -> Child:
            tasks = ending.enter_context(ExitStack())
            begun = number == len(recorded)
            projections[number] = _Projection(actions[number], names[number], room, tasks, begun=begun)
            return projections[number].start()

        with closing(pool.run(waiting, start)) as results:
            for number, result in results:
                outcomes[number] = outcome = projections[number].outcome(result, limit)
                if until == "first" and outcome.succeeded:  # outcomes of candidates after this one aren't returned
                    needed = number + 1
                    waiting.clear()
                    for later in range(needed, len(actions)):
                        if pool.is_running(later):
                            pool.kill(later)
                            projections[later].tasks.close()
                # Candidates are recorded in their order, so the recording doesn't depend on the number of cores.
                while len(recorded) in outcomes and len(recorded) < needed:
                    following = len(recorded)
                    with projections[following].tasks:
                        projections[following].end(outcomes[following])
                    recorded.append(outcomes[following])
                    if pool.is_running(following + 1) and following + 1 < needed:
                        projections[following + 1].begin()
    return recorded


class _Projection:
    """An action that runs in a child process; in this process it is a task."""

    def __init__(self, action: Action, name: str, memory: int | None, tasks: ExitStack, *, begun: bool) -> None:
        self._action = action
        self._name = name
        self._memory = memory
        self._world = current_world()
        self._recording = _path()
        self._began = self._world.sim_step if self._world is not None else 0
        given = action.keywords if isinstance(action, partial) else {}
        self._task = Span("projection", name, parameters={**given, **({} if memory is None else {"memory": memory})})
        self._task_began = time.perf_counter_ns()
        self._begun = False
        self.tasks = tasks
        tasks.push(lambda _, error, __: self._task.finish(error))  # after an interrupt
        if begun:
            self.begin()

    def start(self) -> Child:
        with Uninterrupted():  # each child needs a callback of its own
            child = Child(partial(_answer, self._action, self._task, self._recording, self.begin, self._memory))
            self.tasks.callback(child.kill)
        return child

    def outcome(self, ended: ChildResult, limit: float | None) -> Outcome:
        if ended.late:
            return self._died(f"took longer than {limit:g} s")
        if not ended.answer:
            return self._died(ended.how)
        try:
            succeeded, result, failure, steps, state, unsent = _Unpickler(BytesIO(ended.answer)).load()
        except Exception as error:  # noqa: BLE001  unpickling may call code of the plan's classes
            return self._died(f"returned a value that this process can't load: {format_error(error)}")
        if isinstance(failure, MemoryError) and self._memory is not None:
            return self._died(f"needed more than {self._memory / 1e6:g} MB")
        saved = None
        if self._world is not None and state:
            command = records.Restore.FromString(state)
            names = {body.body for body in command.bodies}
            saved = SavedState(self._world, tuple(o for o in self._world.objects if o.name in names), command)
        duration = (steps - self._began) / records.STEPS_PER_SECOND
        return Outcome(self._name, succeeded, result, failure, duration, saved, self._recording, unsent)

    def _died(self, cause: str) -> Outcome:
        return Outcome(self._name, False, failure=ProjectionDied(self._name, cause), recording=self._recording)

    def begin(self) -> None:
        """Record the start of the task once. The task isn't the current task, because projections run in parallel."""
        if not self._begun:
            self._begun = True
            self._task.start(self._task_began)

    def end(self, outcome: Outcome) -> None:
        self.begin()
        self._task.result = outcome
        self._task.finish()


def _path() -> Path | None:
    beside = next(iter(journal.paths()), None)
    if beside is None:
        return None
    number = 1
    taken = {*beside.parent.glob(f"{beside.stem}.projection-*"), *_given}
    while (path := beside.with_name(f"{beside.stem}.projection-{number}{beside.suffix}")) in taken:
        number += 1
    _given.add(path)
    return path


def _answer(action: Action, task: Span, recording: Path | None, begin: Callable[[], None], memory: int | None) -> bytes:
    failure: BaseException | None = None
    result: Result = None
    _projected.set(True)
    try:
        begin()  # the start of a parallel projection may not be recorded yet
        with (
            task.entered(),
            nullcontext() if recording is None else record(recording, name=task.name, arguments=(), output=True),
        ):
            if memory is not None:  # imported now: Python waits forever for a thread that can't start
                limit_memory(memory)
            result = run(action)
    except BaseException as error:  # noqa: BLE001  the data that is sent to the parent
        failure = error.with_traceback(None)
    world = current_world()
    steps = world.sim_step if world is not None else 0
    state = b""
    if world is not None and not world.trajectories.active:
        state = saved_state.save(world).command.SerializeToString()
    try:
        return _pickled((failure is None, result, failure, steps, state, ""))
    except Exception:  # noqa: BLE001  pickling calls code of the plan's classes; the answer then contains a text
        if failure is None:
            kind = type(result).__name__
            text = result_or(partial(repr, result), lambda error: f"<{kind}, without a text: {format_error(error)}>")
            return _pickled((True, None, None, steps, state, text))
        return _pickled((False, None, ProjectedError(format_error(failure)), steps, state, ""))


def _pickled(answer: object) -> bytes:
    file = BytesIO()
    _Pickler(file).dump(answer)
    _Unpickler(BytesIO(file.getvalue())).load()  # errors of unpickling must be raised here, not in the parent
    return file.getvalue()


class _Pickler(pickle.Pickler):
    """Replaces each object or world by its name."""

    def persistent_id(self, value: object) -> tuple[str, ...] | None:
        if isinstance(value, Object):
            return value.world.name, value.name
        return (value.name,) if isinstance(value, BulletWorld) else None


class _Unpickler(pickle.Unpickler):
    """Replaces names by objects or worlds of this process; a name without an object stays."""

    def persistent_load(self, names: tuple[str, ...]) -> object:
        world = next((each for each in open_worlds() if each.name == names[0]), None)
        if world is None or len(names) == 1:
            return world or names[0]
        return next(iter(world.get_objects_by_name(names[1])), names[1])
