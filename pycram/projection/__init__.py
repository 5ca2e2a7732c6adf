"""Projection: an action is done for real in a forked copy of the process, to see how it would end (thesis 6.3; CRAM).

The copy goes on from this very moment, with the plan, its worlds and its random numbers, to the same bits as this
process would; other branches of the plan stand still in it. The outcome comes back; nothing else does. In this process
nothing runs meanwhile, so a plan that looks ahead takes the same order each time.
"""

from __future__ import annotations

import os
import pickle
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.foundation.names import export
from pycram.language.branch import name_of, run
from pycram.projection.child import Child, limit_memory, usable_cores, wait
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.locks import refuse_held
from pycram.scheduling.schedule import MISSED_SIGNALS_EVERY
from pycram.world import saved_state
from pycram.world.current import current, open_worlds
from pycram.world.object import Object
from pycram.world.saved_state import SavedState
from pycram.world.world import BulletWorld
from recorder import records
from recorder.recording import record
from recorder.records import format_error
from recorder.tracing import forking, interrupts, journal
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

__all__ = ["Candidate", "NotProjectable", "Outcome", "ProjectedError", "ProjectionDied", "project", "project_all"]

Result: TypeAlias = Any
Action: TypeAlias = Callable[..., Result]
#: An action without arguments, or one with them, as in ``(pick_up, milk, "left")``.
Candidate: TypeAlias = "Action | tuple[Any, ...]"


class NotProjectable(UsageError):
    """A projection was asked for where the process can't be copied.

    Attributes:
        cause: Why not, and what to do.
    """

    def __init__(self, cause: str) -> None:
        super().__init__(f"an action can't be projected here: {cause}")
        self.cause = cause


class ProjectionDied(PlanFailure):
    """The process that did a projected action ended without an answer.

    Attributes:
        action: Name of the action.
        cause: What ended it.
    """

    def __init__(self, action: str, cause: str) -> None:
        super().__init__(f"the projection of {action} {cause}")
        self.action = action
        self.cause = cause


class ProjectedError(PlanFailure):
    """A projected action failed with an error that can't leave its process.

    Attributes:
        error: The error, as text.
    """

    def __init__(self, error: str) -> None:
        super().__init__(error)
        self.error = error


export("pycram.projection", NotProjectable, ProjectionDied, ProjectedError)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a projected action ended.

    Attributes:
        action: Its name.
        succeeded: Whether it would succeed.
        result: What it would return, objects being those of this process; None if it can't leave its process.
        failure: What it would raise; a ProjectionDied if it crashed, took too long or needed too much memory; a
            ProjectedError if it can't leave its process.
        duration: Simulated time that it would take in the current world, in s.
        state: The current world's state at its end, for ``world.restore(outcome.state)``; None if there is none, or
            if something followed a trajectory then.
        recording: The file with all that it did; None if nothing is recorded.
        unsent: Text of a result that can't leave its process, as it can't be pickled; else "".
    """

    action: str
    succeeded: bool
    result: Result = None
    failure: BaseException | None = None
    duration: float = 0.0
    state: SavedState | None = None
    recording: Path | None = None
    unsent: str = ""

    def __bool__(self) -> bool:
        return self.succeeded

    def __record__(self) -> object:
        """Return what the projection's task has as its result."""
        return {
            "succeeded": self.succeeded,
            "result": self.result,
            "failure": None if self.failure is None else format_error(self.failure),
            "duration": self.duration,
            "recording": None if self.recording is None else str(self.recording),
        } | ({"unsent": self.unsent} if self.unsent else {})


def project(
    action: Action, *args: object, timeout: float | None = None, memory: float | None = None, **kwargs: object
) -> Outcome:
    """Do an action in a copy of this process, and return how it ends.

    Args:
        action: A function of the plan.
        args: Its arguments.
        timeout: Seconds by the clock after which the copy is ended; None for no limit.
        memory: Megabytes that the copy may need beside what it shares; None for no limit.
        kwargs: The action's keyword arguments.

    Raises:
        NotProjectable: A world has a window or runs in real time, threads of the plan's own run, or nothing can fork.
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
    """Do actions in copies of this process, as many at once as it has cores, and return how they end, in their order.

    Args:
        candidates: Actions, in the order of preference.
        until: "first" ends with the first candidate that succeeds, whoever ends earlier: its outcome is the last one
            then, and those after it are not waited for. "all" does all.
        timeout: Seconds by the clock for each; None for no limit.
        memory: Megabytes for each; None for no limit.

    Raises:
        NotProjectable: See :func:`project`.
        BadArgument: A candidate isn't callable, or an argument is wrong.
        LockHeld: The caller holds a lock.
    """
    if until not in ("first", "all"):
        raise BadArgument("until", until, '"first" or "all"')
    calls: list[tuple[Any, ...]] = [each if isinstance(each, tuple) else (each,) for each in candidates]
    names = [_name(call[0] if call else None) for call in calls]
    return _project_all([partial(call[0], *call[1:]) for call in calls], names, until, timeout, memory)


def _name(action: object) -> str:
    if not callable(action):
        raise BadArgument("action", action, "a function of the plan, or a tuple of one and its arguments")
    return name_of(action.func if isinstance(action, partial) else action)


def _limits(timeout: float | None, memory: float | None) -> tuple[float | None, int | None]:
    """Return the checked limits: seconds, and bytes."""
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
    _refuse_impossible()
    running: dict[int, tuple[_Projection, ExitStack]] = {}
    outcomes: dict[int, tuple[Outcome, _Projection, ExitStack]] = {}  # those that have ended, by candidate
    ended: list[Outcome] = []  # those on record
    cores = usable_cores()
    following, needed = 0, len(actions)
    with ExitStack() as ending:
        while following < needed or running:
            while following < needed and len(running) < cores:
                tasks = ending.enter_context(ExitStack())
                projection = _Projection(
                    actions[following], names[following], room, tasks, begun=following == len(ended)
                )
                running[following] = projection, tasks
                following += 1
            wait([projection.child for projection, _ in running.values()], _time_left(running, limit))
            if interrupts.is_pending():
                checkpoint()
            for number, (projection, tasks) in list(running.items()):
                outcome = projection.outcome(limit) if number < needed else None
                if outcome is None and number < needed:
                    continue
                del running[number]
                if outcome is None:  # an earlier candidate is good enough
                    tasks.close()
                    continue
                outcomes[number] = outcome, projection, tasks
                if until == "first" and outcome.succeeded:
                    needed = min(needed, number + 1)
            # On record is one after the other, in their order, whoever ends earlier and however many cores there are.
            while len(ended) in outcomes and len(ended) < needed:
                outcome, projection, tasks = outcomes.pop(len(ended))
                with tasks:
                    projection.end(outcome)
                ended.append(outcome)
                if len(ended) in running and len(ended) < needed:
                    running[len(ended)][0].begin()
    return ended


def _time_left(running: dict[int, tuple[_Projection, ExitStack]], limit: float | None) -> float:
    if limit is None:
        return MISSED_SIGNALS_EVERY
    first = min(projection.child.began for projection, _ in running.values()) + limit
    return min(max(0.0, first - time.monotonic()), MISSED_SIGNALS_EVERY)


def _refuse_impossible() -> None:
    refuse_held()
    cause = obstacle()
    if cause:
        raise NotProjectable(cause)


def obstacle() -> str:
    """Return why this process can't be copied at this moment, and what to do; "" if it can."""
    if not hasattr(os, "fork"):
        return "this system can't copy a process (os.fork)"
    for world in open_worlds():
        if world.mode == "GUI":
            return f"{world.name} has a window, which a copy can't have; open it with BulletWorld()"
        if world.realtime:
            return f"{world.name} runs in real time; call set_realtime(False) before"
    threads = [thread.name for thread in forking.others()]
    if threads:
        return (
            f"the copy would lack the thread{'s' if threads[1:] else ''} {', '.join(threads)}; branches of `with par` "
            "are copied, in_thread(...) has to end before"
        )
    return ""


_MAX_MEMORY: Final = 10**12  # bytes
_numbers: Final = threading.local()


class _Projection:
    """One action that is done in a child, as a task of this process."""

    def __init__(self, action: Action, name: str, memory: int | None, tasks: ExitStack, *, begun: bool) -> None:
        self._name = name
        self._memory = memory
        self._world = current()
        self._recording = _path()
        self._began = self._world.sim_step if self._world is not None else 0
        given = action.keywords if isinstance(action, partial) else {}
        self._task = Span("projection", name, parameters={**given, **({} if memory is None else {"memory": memory})})
        self._task_began = time.perf_counter_ns()
        self._begun = False
        tasks.push(self._interrupted)
        if begun:
            self.begin()
        with Uninterrupted():  # no child without its end
            self.child = Child(partial(_answer, action, self._task, self._recording, self.begin, memory))
            tasks.callback(self.child.kill)

    def outcome(self, limit: float | None) -> Outcome | None:
        """Return how it ended; None as long as it hasn't. What takes longer than the limit in s is ended."""
        if not self.child.ended:
            if limit is None or time.monotonic() < self.child.began + limit:
                return None
            self.child.kill()
            return self._died(f"took longer than {limit:g} s")
        if not self.child.received:
            return self._died(self.child.how)
        try:
            succeeded, result, failure, steps, state, unsent = _Unpickler(BytesIO(self.child.received)).load()
        except Exception as error:  # noqa: BLE001  of a class that the action has made, say
            return self._died(f"returned what this process doesn't know: {format_error(error)}")
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
        """Record its beginning, as its turn has come: not as the current task, as several run at once."""
        if not self._begun:
            self._begun = True
            self._task.start(self._task_began)

    def end(self, outcome: Outcome) -> None:
        """Record its end."""
        self.begin()
        self._task.result = outcome
        self._task.finish()

    def _interrupted(
        self, _: type[BaseException] | None, error: BaseException | None, __: TracebackType | None
    ) -> None:
        self._task.finish(error)


def _path() -> Path | None:
    """Return where the next projection is recorded: beside the recording that runs."""
    beside = next(iter(journal.paths()), None)
    if beside is None:
        return None
    number = 1
    taken = {*beside.parent.glob(f"{beside.stem}.projection-*"), *getattr(_numbers, "given", ())}
    while (path := beside.with_name(f"{beside.stem}.projection-{number}{beside.suffix}")) in taken:
        number += 1
    _numbers.given = {*getattr(_numbers, "given", ()), path}
    return path


# --- in the child -----------------------------------------------------------------------------------------------------


def _answer(action: Action, task: Span, recording: Path | None, begin: Callable[[], None], memory: int | None) -> bytes:
    """Do the action, and return its outcome."""
    failure: BaseException | None = None
    result: Result = None
    try:
        begin()  # here it runs, though it may not be its turn yet on the parent's record
        with task.entered(), _recorded(task.name, recording):
            if memory is not None:  # not before: a thread that can't begin is waited for without end
                limit_memory(memory)
            result = run(action)
    except BaseException as error:  # noqa: BLE001  told to the parent
        failure = error.with_traceback(None)
    world = current()
    steps = world.sim_step if world is not None else 0
    state = b""
    if world is not None and not world.trajectories.active:
        state = saved_state.save(world).command.SerializeToString()
    try:
        return _pickled((failure is None, result, failure, steps, state, ""))
    except Exception:  # noqa: BLE001  of a user's own types: then as text
        if failure is None:
            return _pickled((True, None, None, steps, state, _text(result)))
        return _pickled((False, None, ProjectedError(format_error(failure)), steps, state, ""))


def _text(result: Result) -> str:
    try:
        return repr(result)
    except Exception as error:  # noqa: BLE001  as above
        return f"<{type(result).__name__}, without a text: {format_error(error)}>"


def _recorded(name: str, recording: Path | None) -> AbstractContextManager[object]:
    return nullcontext() if recording is None else record(recording, name=name, arguments=(), output=True)


def _pickled(answer: object) -> bytes:
    file = BytesIO()
    _Pickler(file).dump(answer)
    _Unpickler(BytesIO(file.getvalue())).load()  # else the parent would find out
    return file.getvalue()


class _Pickler(pickle.Pickler):
    """Refers to objects and worlds by their names."""

    def persistent_id(self, value: object) -> tuple[str, ...] | None:
        if isinstance(value, Object):
            return value.world.name, value.name
        return (value.name,) if isinstance(value, BulletWorld) else None


class _Unpickler(pickle.Unpickler):
    """Finds objects and worlds by their names; one that isn't in this process is its name."""

    def persistent_load(self, names: tuple[str, ...]) -> object:
        world = next((each for each in open_worlds() if each.name == names[0]), None)
        if world is None or len(names) == 1:
            return world or names[0]
        return next(iter(world.get_objects_by_name(names[1])), names[1])
