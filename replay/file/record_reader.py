"""A recording: its records by step, also of a file whose process was killed, or is still running.

No question costs more than a few chunks, however long the recording is; see :mod:`replay.file.index` and
:mod:`replay.file.chunks`.
"""

from __future__ import annotations

import contextlib
import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar, overload

from recorder.records import (
    TOPICS,
    UNKNOWN,
    Event,
    Fluent,
    Keyframe,
    Mutation,
    Output,
    Query,
    Refusal,
    Run,
    Subscription,
    Task,
)
from replay.errors import Damaged, LogClosed, MissingModels, NoSuchName, NoSuchStep, ReplayError, Unreadable
from replay.file.assets import Assets
from replay.file.chunks import KINDS, Chunks, Kinds, kinds_of
from replay.file.file_checks import check_ours, is_locked, open_file
from replay.file.index import Index
from replay.file.lifetimes import Lifetime, closes_world, lifetimes_of
from replay.file.newer import Newer, format_of, newer_of
from replay.file.repair import Losses, lost_before, range_text, write_sound

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from types import TracebackType
    from typing import Self

    from recorder.records import Record

__all__ = ["KINDS", "RecordReader"]

R = TypeVar("R", Run, Task, Mutation, Event, Subscription, Fluent, Query, Refusal, Keyframe, Output)


class RecordReader:
    """The records of a recording. Not for several threads at once.

    Attributes:
        path: the file.
        assets: the attached files by ``<sha256>/<file name>``.
        written_ns: when the file was last written to before it was opened, ns since the Unix epoch.
        lost_before: steps that were lost before the file was repaired.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file = open_file(self.path)
        try:
            self.written_ns = os.fstat(self._file.fileno()).st_mtime_ns
            self._index = Index(self._file)
            check_ours(self.path, self._index)
            self._chunks = Chunks(self._index)
            self._steps = self._count()
        except BaseException:
            self._file.close()
            raise
        self.assets = Assets(self.path, self._index)
        self.lost_before = lost_before(self._index)
        self._gaps: list[range] = []  # what is lost, when so many chunks were known to be damaged, of so many steps
        self._gaps_of = (-1, -1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        if self._file.closed:
            return f"<{type(self).__name__} {self.path}: closed>"
        return f"<{type(self).__name__} {self.path}: {len(self)} steps{'' if self.complete else ', ' + self.problems}>"

    def close(self) -> None:
        """Close the file."""
        self.assets.close()
        self._index.close()

    def after_fork(self) -> None:
        """Go on reading, in a forked child, from a file position of its own: the parent's would move."""
        self.assets.close()
        descriptor = self._file.fileno()
        own = os.open(self.path, os.O_RDONLY)
        os.lseek(own, os.lseek(descriptor, 0, os.SEEK_CUR), os.SEEK_SET)
        os.dup2(own, descriptor, inheritable=False)
        os.close(own)

    # --- the run and the file ---------------------------------------------------------------------------------------

    @property
    def metadata(self) -> Mapping[str, str]:
        """The run's metadata: plan, versions, platform, arguments."""
        return {
            key if name == "pycram" else f"{name}.{key}": value
            for name, values in self._index.metadata.items()
            for key, value in values.items()
        }

    @property
    def closed(self) -> bool:
        """Whether the recorder closed the file; then nothing will be added."""
        return self._index.closed

    @property
    def live(self) -> bool:
        """Whether a recorder is writing the file now.

        Raises:
            LogClosed: this object was closed, so that it can't be known.
        """
        if self._file.closed and not self.closed:
            raise LogClosed(self.path)
        return not self.closed and is_locked(self._file)

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the file, and no damage was found so far."""
        return not self.problems

    @property
    def problems(self) -> str:
        """What is known to be missing or damaged, in words; empty if nothing is."""
        return "; ".join(filter(None, (self.incomplete, self.damage)))

    @property
    def incomplete(self) -> str:
        """That the file was not closed, or lost records before it was repaired, in words; empty if neither is so."""
        if self.closed:
            lost = ", ".join(map(range_text, self.lost_before))
            return f"steps {lost} were lost before it was repaired" if lost else ""
        writer = "it is still being written" if self.live else "its process was killed"
        cut = self._index.incomplete_bytes
        tail = f", its last {cut} bytes are incomplete" if cut else ""
        return f"it was not closed ({writer}){tail}"

    @property
    def damage(self) -> str:
        """What is known to be damaged or lost, in words; empty if nothing is."""
        problems = ["the index at its end is damaged"] if self.closed and not self._index.whole else []
        problems += self._index.damage
        problems += [f"chunk {number} is damaged ({cause})" for number, cause in sorted(self._chunks.damaged.items())]
        problems += [f"the attached file {name} is damaged ({cause})" for name, cause in self.assets.damaged.items()]
        problems += [f"its models are missing ({cause})"] if (cause := self.assets.missing()) else []
        lost = self._lost - sum(map(len, self.lost_before))
        if lost > 0 and not self._chunks.damaged:
            problems.append(f"{lost} records are lost")
        return "; ".join(problems)

    @cached_property
    def newer(self) -> Newer | None:
        """What this release doesn't know of the recording, if a newer one wrote it."""
        return newer_of(self._index)

    @property
    def format(self) -> int:
        """The format of the recording, 0 if it doesn't tell; see :mod:`recorder.records.definition`."""
        return format_of(self._index)

    @cached_property
    def lifetimes(self) -> tuple[Lifetime, ...]:
        """The lifetimes of worlds in the order of their opening; a name that is taken again begins another one."""
        return lifetimes_of(self._chunks)

    def counts(self) -> dict[str, int]:
        """Return the number of records of each kind, from the file's own index; nothing is decoded."""
        counts: dict[str, int] = {}
        for channel, kind in kinds_of(self._index).items():
            count = self._index.counts.get(channel, 0)
            if count:
                name = TOPICS.get(kind, UNKNOWN).removeprefix("/")
                counts[name] = counts.get(name, 0) + count
        return counts

    # --- records ---------------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return self._steps

    def __getitem__(self, step: int) -> Record:
        """Return the record of a step; negative steps count from the end.

        Raises:
            NoSuchStep: there is none.
            Damaged: there was one, but it is lost.
        """
        number = step + self._steps if step < 0 else step
        if not 0 <= number < self._steps:
            raise NoSuchStep(step, self._steps)
        for record in self._chunks.records(self.chunk_of(number)):
            if record.seq == number:
                return record
        raise Damaged(self.path, f"step {number}", "it was lost")

    def __iter__(self) -> Iterator[Record]:
        return self.records()

    @overload
    def records(self, kind: type[R], start: int = 0, stop: int | None = None) -> Iterator[R]: ...
    @overload
    def records(self, kind: Kinds | str | None = None, start: int = 0, stop: int | None = None) -> Iterator[Record]: ...
    def records(self, kind: Any = None, start: int = 0, stop: int | None = None) -> Iterator[Any]:
        """Stream the records of one or several types from ``start`` to before ``stop``; no others are decoded.

        A type may be given by its name, as "query".

        Raises:
            NoSuchName: there is no such type.
        """
        if isinstance(kind, str):
            if kind not in KINDS:
                raise NoSuchName("kind of record", kind, KINDS)
            kind = KINDS[kind]
        return self._records(kind, start, stop)

    def _records(self, kind: Kinds | None, start: int, stop: int | None) -> Iterator[Record]:
        end = self._steps if stop is None else min(stop, self._steps)
        if start >= end:
            return
        for number in range(self.chunk_of(start), self.chunk_of(end - 1) + 1):
            for record in self._chunks.whole(number) if kind is None else self._chunks.records(number, kind):
                if start <= record.seq < end:
                    yield record
                elif not 0 <= record.seq < self._steps:
                    self._chunks.misplaced(number, record)

    @overload
    def backwards(self, start: int, kind: type[R], *, naming: str = "") -> Iterator[R]: ...
    @overload
    def backwards(self, start: int = -1, kind: Kinds | None = None, *, naming: str = "") -> Iterator[Record]: ...
    def backwards(self, start: int = -1, kind: Any = None, *, naming: str = "") -> Iterator[Any]:
        """Stream records from a step (negative ones count from the end) down to the first.

        Only those of one or several types, that have a text in one of their fields, are decoded.
        """
        first = start + self._steps if start < 0 else start
        for number in range(self.chunk_of(first), -1, -1):
            for record in self._chunks.records(number, kind, backwards=True, naming=naming):
                if record.seq <= first:
                    yield record

    def lifetime_at(self, world: str, step: int) -> Lifetime | None:
        """Return the world that a name meant at a step, or will mean first; None if there is none of that name."""
        return next((lifetime for lifetime in self.lifetimes if lifetime.world == world and lifetime.has(step)), None)

    @overload
    def records_of(self, lifetime: Lifetime, kind: type[R], chunks: Sequence[int]) -> Iterator[R]: ...
    @overload
    def records_of(self, lifetime: Lifetime, kind: Kinds, chunks: Sequence[int]) -> Iterator[Record]: ...
    def records_of(self, lifetime: Lifetime, kind: Any, chunks: Sequence[int]) -> Iterator[Any]:
        """Stream a world's records of one or several types in certain chunks."""
        for number in chunks:
            for record in self._chunks.records(number, kind, lifetime.world):
                if lifetime.has(record.seq):
                    yield record

    def chunk_of(self, step: int) -> int:
        """Return the number of the chunk that a step is in, if it is in any."""
        return self._chunks.chunk_of(step, self._steps)

    def end_of(self, lifetime: Lifetime) -> Record | None:
        """Return the last change of a world, or its last keyframe if that comes later; None if it is lost."""
        last = None
        for last in self.records_of(lifetime, (Mutation, Keyframe), lifetime.changes[-1:]):  # noqa: B007  the last one
            pass
        return last

    def final_step(self) -> int:
        """Return the last step before worlds were closed at the end: there is nothing to see after it."""
        closing = self._steps
        for record in self.backwards(-1, (Mutation, Keyframe)):
            if not closes_world(record):
                break
            closing = record.seq
        return max(closing - 1, 0)

    # --- completeness ----------------------------------------------------------------------------------------------

    def check(self) -> str:
        """Read everything once, and return :attr:`problems`."""
        last = -1
        for number in range(len(self._chunks)):
            for record in self._chunks.records(number):  # what is damaged is noted on the way
                if not last < record.seq < self._steps:
                    self._chunks.misplaced(number, record)
                last = record.seq
        for name in self.assets:
            with contextlib.suppress(Damaged):  # which is kept in assets.damaged
                _ = self.assets[name]
        if not self.damage:
            self._index.check()
        return self.problems

    def lost(self) -> list[range]:
        """Return the ranges of steps that are missing before the last one; only a damaged recording is read."""
        intact = self._index.whole or (not self._index.closed and not self._index.damage)
        if intact and not self._chunks.damaged and not self._lost:
            return []
        if self._gaps_of != (len(self._chunks.damaged), self._steps):  # each state of a damaged recording asks for them
            self._gaps.clear()
            expected = 0
            for record in self.records():
                if record.seq > expected:
                    self._gaps.append(range(expected, record.seq))
                expected = max(expected, record.seq + 1)
            self._gaps_of = len(self._chunks.damaged), self._steps
        return list(self._gaps)

    def write_sound(self, file: BinaryIO) -> Losses:
        """Write a sound copy of what can be read; see :func:`replay.file.repair.write_sound`."""
        self.check()
        return write_sound(file, self._index, self._chunks, self.assets, self.problems, self.missing())

    def write_packed(self, file: BinaryIO) -> None:
        """Write a copy that holds its models itself.

        Raises:
            MissingModels: they aren't there.
            ReplayError: the recording isn't sound.
        """
        if cause := self.assets.missing(look=True):
            raise MissingModels(self.path, cause)
        if problems := self.check():
            raise ReplayError(f"{self.path}: it isn't sound ({problems}); repair it, which packs what can be read")
        write_sound(file, self._index, self._chunks, self.assets, None, [])

    def missing(self) -> list[range]:
        """Return the ranges of steps that are missing, also those after the last one if their number is known.

        Those that were lost before the file was repaired are among them.
        """
        gaps = self.lost()
        after = self._lost - sum(map(len, gaps))
        gaps += [range(self._steps, self._steps + after)] if after > 0 else []
        return list(dict.fromkeys([*gaps, *self.lost_before]))

    def refresh(self) -> bool:
        """Look for records that were written since, if the file was not closed; return whether there are any."""
        last = len(self._chunks) - 1
        if not self._index.refresh():
            return False
        self._chunks.refresh(last)
        self.__dict__.pop("lifetimes", None)
        self._steps = self._count()
        return True

    def _count(self) -> int:
        """Return the number of steps: one more than the last one's."""
        for number in range(len(self._chunks) - 1, -1, -1):
            last = next(self._chunks.records(number, backwards=True), None)
            if last is not None:
                self._lost = abs(last.seq + 1 - sum(self.counts().values()))
                return last.seq + 1
        raise Unreadable(self.path, "has no record that can be read")
