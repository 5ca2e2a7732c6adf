"""Verifies what of a recording can be verified without an engine: that its file is sound, and its records consistent.

:mod:`replay.restore.verify` adds that its changes, made again, have the recorded effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Keyframe, Mutation, Task
from replay.state.integrity import Integrity, Problem
from replay.state.task_integrity import TaskDepths

if TYPE_CHECKING:
    from collections.abc import Callable

    from replay.file.record_reader import RecordReader
    from replay.state.deviation import Deviation


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying a recording.

    Attributes:
        steps: how many were checked.
        tasks: how many of them start a task.
        unfinished: how many tasks had not ended when the recording did.
        keyframes: how many were compared with the records before them.
        files: how many are attached.
        changes: how many were made again.
        worlds: in how many worlds.
        late: names of worlds that began before the recording: their physics are not compared.
        dragged: names of worlds in which somebody dragged something by hand: from there on, their physics are not
            compared either.
        environment: how this environment differs from the one it was recorded in, in words.
        largest: the largest deviation that the environment or the engine's rounding may explain.
        problem: the first problem; None for a sound recording.
        damage: what of the file is damaged or lost, in words; or "". That a recording which wasn't closed lacks its
            end is no damage.
        incomplete: that it wasn't closed, or lost records before it was repaired, in words; or "".
        unknown: names of worlds that a newer release changed in ways that this one can't: from there on, their physics
            are not compared.
        static: whether nothing was made again.
    """

    steps: int
    tasks: int
    unfinished: int
    keyframes: int
    files: int
    changes: int
    worlds: int
    late: tuple[str, ...] = ()
    dragged: tuple[str, ...] = ()
    environment: tuple[str, ...] = ()
    largest: Deviation | None = None
    problem: Problem | None = None
    damage: str = ""
    incomplete: str = ""
    unknown: tuple[str, ...] = ()
    static: bool = False

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong with what there is."""
        return self.problem is None and not self.damage

    @property
    def exact(self) -> bool:
        """Whether all that was made again came out the same to the last bit."""
        return self.sound and self.largest is None and not (self.static or self.late or self.dragged or self.unknown)


def verify_static(log: RecordReader, progress: Callable[[int], None] | None = None) -> Verification:
    """Verify all that needs no engine, up to the first problem; ``progress`` is called with each step."""
    return Verifier(log).run(progress)


class Verifier:
    """Verifies a recording; :meth:`check` is called with each change and keyframe, when it is consistent."""

    static = True

    def __init__(self, log: RecordReader) -> None:
        self.log = log
        self.integrity = Integrity(log.lost_before, newer=log.newer is not None)
        self.changes = 0
        self.worlds: set[tuple[str, int]] = set()
        self.late: dict[str, None] = {}
        self.dragged: dict[str, None] = {}
        self.unknown: dict[str, None] = {}
        self.environment: tuple[str, ...] = ()
        self.largest: Deviation | None = None
        self.damage: list[str] = []  # found on the way, beside the file's
        self._depths = TaskDepths()

    def run(self, progress: Callable[[int], None] | None) -> Verification:
        """Run every check that any verb does, and compare the records."""
        self.log.check()
        problem = self._first_problem(progress)
        return Verification(
            self.integrity.steps,
            self.integrity.tasks.tasks,
            self.integrity.tasks.unfinished,
            self.integrity.keyframes,
            len(self.log.assets),
            self.changes,
            len(self.worlds),
            tuple(self.late),
            tuple(self.dragged),
            self.environment,
            self.largest,
            problem,
            "; ".join(filter(None, (self.log.damage, *self.damage))),
            self.log.incomplete,
            tuple(self.unknown),
            self.static,
        )

    def _first_problem(self, progress: Callable[[int], None] | None) -> Problem | None:
        for record in self.log.records():
            if progress is not None:
                progress(record.seq)
            if isinstance(record, Task) and (cause := self._depths.too_deep(record)):
                self.damage.append(f"step {record.seq}: {cause}")
                return None
            problem = self.integrity.check(record)
            if self.integrity.resumed:
                self.forget()
            if problem is None and isinstance(record, Keyframe | Mutation) and self.integrity.knows(record.world):
                problem = self.check(record)
            if problem is not None:
                return problem
        return None

    def forget(self) -> None:
        """Forget all worlds: records are missing."""

    def check(self, record: Keyframe | Mutation) -> Problem | None:  # noqa: ARG002  for those that do
        """Return the problem with a change or keyframe; without an engine there is none."""
        return None
