"""Whether a recording agrees with itself; for this no world is needed.

Steps count without a gap and wall time never goes back; every task that starts ends once, and what it is part of is
there; every keyframe is what the records before it add up to; every attached file is what its name says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation, Run, Task
from replay.errors import Damaged
from replay.state.deviation import Deviation, first_deviation
from replay.state.fold import fold, take
from replay.state.json_data import state_data
from replay.state.state import State

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.records import Record
    from replay.file.log import Log
    from replay.state.fold import WorldBuilder
    from replay.state.json_data import Plain
    from replay.state.state import World

#: What may come after each phase of a task; a branch that is asked for may be cancelled before it starts.
_AFTER: Final[Mapping[Task.Phase | None, tuple[Task.Phase, ...]]] = {
    None: (Task.ASKED, Task.STARTED),
    Task.ASKED: (Task.STARTED, Task.FINISHED),
    Task.STARTED: (Task.FINISHED,),
}


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that isn't as it should be.

    Attributes:
        step: where; None if it is no step's.
        cause: in words.
        deviation: where exactly and by how much, if there is such.
        task: names of the task in which it is and of those around it, outermost first.
    """

    step: int | None
    cause: str
    deviation: Deviation | None = None
    task: tuple[str, ...] = ()


class Integrity:
    """Takes all records in their order and says of each whether it fits.

    Attributes:
        steps: how many were taken.
        tasks: how many there are.
        keyframes: how many were compared with what the records before them add up to.
    """

    def __init__(self) -> None:
        self.steps = 0
        self.tasks = 0
        self.keyframes = 0
        self._time = 0
        self._names: dict[int, tuple[str, int]] = {}
        self._phases: dict[int, Task.Phase] = {}
        self._running: dict[int, int] = {}
        self._worlds: dict[str, WorldBuilder] = {}

    def world(self, name: str) -> World:
        """What the records so far say of a world that they know."""
        return self._worlds[name].frozen()

    def task(self, number: int) -> tuple[str, ...]:
        """A task and what it is part of, outermost first."""
        names: list[str] = []
        while number in self._names and len(names) <= len(self._names):
            name, number = self._names[number]
            names.append(name)
        return tuple(reversed(names))

    def take(self, record: Record) -> Problem | None:
        """Takes the next record.

        Args:
            record: the record.

        Returns:
            What is wrong with it, or with what should have come before it.
        """
        step = record.seq
        if step != self.steps:
            lost = str(self.steps) if step == self.steps + 1 else f"{self.steps} to {step - 1}"
            return Problem(self.steps, f"step {lost} is not there: what followed from it can't be checked")
        self.steps += 1
        if record.wall_time_ns < self._time:
            return Problem(step, "its wall time lies before that of the step before")
        self._time = record.wall_time_ns
        if isinstance(record, Task):
            cause = self._take_task(record)
        elif isinstance(record, Run):
            cause = self._take_run(record)
        else:
            cause = "" if record.task in self._names or not record.task else f"its task {record.task} never started"
        if cause:
            return Problem(step, cause, task=self.task(record.task))
        if isinstance(record, Keyframe) and record.world in self._worlds:
            deviation = self._compare(record)
            if deviation is not None:
                return Problem(
                    step, "the keyframe isn't what the records before it add up to", deviation, self.task(record.task)
                )
        if isinstance(record, Mutation | Keyframe):
            try:
                take(self._worlds, record)
            except (ValueError, IndexError) as error:
                return Problem(step, f"the record makes no sense: {error}", task=self.task(record.task))
        return None

    def _take_task(self, record: Task) -> str:
        number, before = record.task, self._phases.get(record.task)
        if record.phase not in _AFTER.get(before, ()):
            told = "isn't there" if before is None else f"was {Task.Phase.Name(before).lower()} before"
            return f"task {number} is {Task.Phase.Name(record.phase).lower()}, but it {told}"
        if before is None:
            if record.parent and record.parent not in self._names:
                return f"what task {number} is part of never started"
            self.tasks += 1
            self._names[number] = record.name, record.parent
        self._phases[number] = record.phase
        if record.phase == Task.FINISHED:
            del self._running[number]
        else:
            self._running[number] = record.seq
        return ""

    def _take_run(self, record: Run) -> str:
        if record.phase == Run.FINISHED and self._running:
            number, start = next(iter(self._running.items()))
            return f"the run ends, but task {number} ({self._names[number][0]}), which started at step {start}, doesn't"
        return ""

    def _compare(self, frame: Keyframe) -> Deviation | None:
        """How a keyframe differs from what the records before it add up to."""
        self.keyframes += 1
        return first_deviation(
            _plain(fold([frame]).worlds[frame.world]), _plain(self._worlds[frame.world].frozen()), frame.world
        )


def _plain(world: World) -> Plain:
    """A world as plain data, bodies by name, attachments by their pairs."""
    told = state_data(State(0, {world.name: world}))["worlds"]
    assert isinstance(told, dict)  # noqa: S101  tells mypy
    facts = told[world.name]
    assert isinstance(facts, dict)  # noqa: S101  tells mypy
    held = facts.pop("attachments")
    assert isinstance(held, list)  # noqa: S101  tells mypy
    pairs: dict[str, Plain] = {f"{one['carrier']}, {one['body']}": one for one in held if isinstance(one, dict)}
    return facts | {"attachments": dict(sorted(pairs.items()))}


def files_problem(log: Log) -> Problem | None:
    """The first attached file that isn't what was attached.

    Args:
        log: the recording.
    """
    for name in log.assets:
        try:
            log.assets[name]
        except Damaged as error:
            return Problem(None, f"{error.where} is damaged: {error.cause}")
    return None
