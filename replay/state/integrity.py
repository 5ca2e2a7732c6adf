"""Checks whether a recording is consistent; for this no world is needed.

Steps have no gap and time never decreases; every task that starts ends once, as what it began, and its parent exists;
what began in the thread of the task around it, or is a branch, ends before that does; what failed has its failure, and
nothing else has; causes came before what they caused; every keyframe equals the fold of the records before it, and
names the same models, loaded in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Envelope, Event, Keyframe, Mutation, Query, Run, Task
from replay.state.deviation import Deviation, first_deviation
from replay.state.fold import apply, fold
from replay.state.json_data import message_data, world_data
from replay.state.task_integrity import TaskIntegrity

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.records import Plain, Record
    from replay.state.fold import WorldBuilder
    from replay.state.state import World


@dataclass(frozen=True, slots=True)
class Problem:
    """An inconsistency.

    Attributes:
        step: where; None if it belongs to no step.
        cause: in words.
        deviation: the first wrong value, if there is one.
        task: names of the task in which it is and of those around it, outermost first.
    """

    step: int | None
    cause: str
    deviation: Deviation | None = None
    task: tuple[str, ...] = ()


class Integrity:
    """Checks records one after the other.

    Args:
        lost: steps that are known to be missing; what they changed isn't known after them.
        newer: whether a newer release made the recording, whose tasks may have phases that aren't known here.

    Attributes:
        steps: number of records checked.
        keyframes: number of keyframes that were compared with the fold of the records before them.
        tasks: what is known of them.
        resumed: whether records were missing before the last one; then no world is known any more.
    """

    def __init__(self, lost: Iterable[range] = (), *, newer: bool = False) -> None:
        self._lost = tuple(lost)
        self.steps = self._next = 0
        self.keyframes = 0
        self.tasks = TaskIntegrity(newer=newer)
        self.resumed = False
        self._time = self._monotonic = 0
        self._events: set[int] = set()
        self._worlds: dict[str, WorldBuilder] = {}

    def world(self, name: str) -> World:
        """Return the state of a known world after the records so far."""
        return self._worlds[name].build()

    def knows(self, world: str) -> bool:
        """Return whether the state of a world is known: it was opened, or had a keyframe, behind what is missing."""
        return world in self._worlds

    def check(self, record: Record) -> Problem | None:
        """Take the next record; return the problem with it, or with what should have come before it."""
        step, expected = record.seq, self._next
        self.resumed = step > expected and any(expected in gap and step - 1 in gap for gap in self._lost)
        if self.resumed:
            self.tasks.resume()
            self._worlds.clear()
        elif step != expected:
            lost = str(expected) if step == expected + 1 else f"{expected} to {step - 1}"
            return Problem(expected, f"step {lost} is missing: what followed from it can't be checked")
        self._next = step + 1
        self.steps += 1
        cause = self._check_envelope(record) or self._check_task(record)
        deviation = None
        if isinstance(record, Keyframe) and self.knows(record.world) and not cause:
            deviation = self._compare(record)
            cause = "" if deviation is None else "the keyframe differs from the fold of the records before it"
        if isinstance(record, Mutation | Keyframe | Query) and not cause:
            cause = self._apply(record)
        return Problem(step, cause, deviation, self.tasks.path(record.task)) if cause else None

    def _check_envelope(self, record: Record) -> str:
        before = self._time, self._monotonic
        self._time, self._monotonic = record.wall_time_ns, record.monotonic_ns
        if record.wall_time_ns < before[0]:
            return "its wall time is before that of the previous step"
        if record.monotonic_ns < before[1]:
            return "its monotonic time is before that of the previous step"
        if record.cause and record.cause not in self._events and not self.tasks.partial:
            return f"its cause, step {record.cause}, is no event before it"
        if isinstance(record, Event | Envelope):
            self._events.add(record.seq)
        return ""

    def _check_task(self, record: Record) -> str:
        if not isinstance(record, Task) and not self.tasks.knows(record.task):
            return f"its task {record.task} never started"
        if not isinstance(record, Task):
            return self.tasks.check_run(record) if isinstance(record, Run) else ""
        return self.tasks.check(record)

    def _apply(self, record: Mutation | Keyframe | Query) -> str:
        """Bring its world to after a change; one that isn't known is left out behind missing records."""
        opens = not isinstance(record, Mutation) or record.HasField("open_world")
        if not opens and self.tasks.partial and not self.knows(record.world):
            return ""
        try:
            apply(self._worlds, record)
        except (ValueError, IndexError) as error:
            return f"the record makes no sense: {error}"
        return ""

    def _compare(self, frame: Keyframe) -> Deviation | None:
        """Return how a keyframe differs from what the records before it add up to."""
        self.keyframes += 1
        loaded: list[Plain] = [body.body for body in frame.loaded]
        states: list[Plain] = [body.body for body in frame.bodies]
        if loaded != states:
            return Deviation("bodies", states, loaded)
        return first_deviation(
            _plain(fold([frame]).worlds[frame.world]), _plain(self._worlds[frame.world].build()), frame.world
        )


def _plain(world: World) -> Plain:
    """Return a world as JSON data, bodies by name and as they were loaded, attachments by their pairs."""
    data = world_data(world)
    held = data.pop("attachments")
    assert isinstance(held, list)  # noqa: S101  for mypy
    pairs: dict[str, Plain] = {f"{each['carrier']}, {each['body']}": each for each in held if isinstance(each, dict)}
    loaded: list[Plain] = [
        # the color is that of now, which the body's state has
        {key: value for key, value in message_data(body.loaded).items() if key != "color"}
        for body in world.bodies.values()
    ]
    return data | {"attachments": dict(sorted(pairs.items())), "loaded": loaded}
