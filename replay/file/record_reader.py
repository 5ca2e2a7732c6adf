"""A recording: its records by step. The process that recorded may have been killed, or may still be writing the file.

A call needs only a few chunks, even of a long recording. Unknown fields of newer releases are ignored. For unknown
kinds of records, only the envelope is read.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Final, Self, TypeVar, overload

from recorder import system
from recorder.errors import similar_files
from recorder.mcap_writer import MODELS_LIBRARY
from recorder.records import PACKAGE, TOPICS, UNKNOWN, Keyframe, Mutation, Record, format_number, unknown_definitions
from replay.errors import Damaged, LogClosed, MissingModels, NoSuchName, NoSuchStep, NotALog, ReplayError, Unreadable
from replay.file.assets import Assets
from replay.file.chunks import KINDS, Chunks, Kinds, kinds_of
from replay.file.index import Index
from replay.file.lifetimes import Lifetime, closes_world, lifetimes_of
from replay.file.mcap_format import MAGIC
from replay.file.repair import Losses, lost_before, range_text, write_sound

__all__ = ["KINDS", "RecordReader"]

R = TypeVar("R", bound=Record)

_MIN_MAGIC: Final = len(MAGIC) - 2  # minimum number of correct bytes among the first bytes of a file
_NONBLOCK: Final = getattr(os, "O_NONBLOCK", 0)  # with this flag, opening a pipe doesn't wait for a writer
_MAX_NAMES: Final = 4  # maximum number of names in messages
_FIRST: Final = [0, 1, 0]  # a recording of the first release is never newer
_MAX_DIGITS: Final = 9  # maximum number of digits of a valid number
_RELEASE: Final = re.compile(r"(\d{1,9})\.(\d{1,9})(?:\.(\d{1,9}))?")


class RecordReader:
    """The records of a recording. This class isn't thread-safe."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file = open_file(self.path)
        with contextlib.ExitStack() as undoing:
            undoing.callback(self._file.close)
            # time of the last write before this object opened the file, ns since the Unix epoch
            self.written_ns = os.fstat(self._file.fileno()).st_mtime_ns
            self._index = Index(self._file)
            check_ours(self.path, self._index)
            self._chunks = Chunks(self._index)
            self._steps = self._count()
            undoing.pop_all()
        self.assets = Assets(self.path, self._index)  # the attached files, by ``<sha256>/<file name>``
        self.lost_before = lost_before(self._index)  # steps that were already lost before a repair
        self._gaps: list[range] = []  # ranges of lost steps
        self._gaps_of = (-1, -1)  # number of damaged chunks and number of steps when the gaps were searched

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        if self._file.closed:
            return f"<{type(self).__name__} {self.path}: closed>"
        return f"<{type(self).__name__} {self.path}: {len(self)} steps{'' if self.complete else ', ' + self.problems}>"

    def close(self) -> None:
        """Close the file."""
        self.assets.close()
        self._chunks.close()
        self._index.close()

    def after_fork(self) -> None:
        """Open the file again in a forked child. A child must not share the parent's file position."""
        self.assets.close()
        descriptor = self._file.fileno()
        own = os.open(self.path, os.O_RDONLY | system.OPENED)
        os.lseek(own, os.lseek(descriptor, 0, os.SEEK_CUR), os.SEEK_SET)
        os.dup2(own, descriptor, inheritable=False)
        os.close(own)

    # --- the run and the file ---------------------------------------------------------------------------------------

    @property
    def metadata(self) -> Mapping[str, str]:
        """The metadata of the run: plan, versions, platform, arguments."""
        return {
            key if name == "pycram" else f"{name}.{key}": value
            for name, values in self._index.metadata.items()
            for key, value in values.items()
        }

    @property
    def closed(self) -> bool:
        """Whether the recorder has closed the file; a closed file no longer grows."""
        return self._index.closed

    @property
    def live(self) -> bool:
        """Whether a recorder is writing the file now; raise LogClosed if this object was closed."""
        if self._file.closed and not self.closed:
            raise LogClosed(self.path)
        return not self.closed and is_locked(self._file)

    @property
    def complete(self) -> bool:
        """Whether the recorder has closed the file, and no damage is known."""
        return not self.problems

    @property
    def problems(self) -> str:
        """All known losses and damage, as text; "" if there are none."""
        return "; ".join(filter(None, (self.incomplete, self.damage)))

    @property
    def incomplete(self) -> str:
        """Why the recording is incomplete: it wasn't closed, or lost records before a repair. "" if it is complete."""
        if self.closed:
            lost = ", ".join(map(range_text, self.lost_before))
            return f"steps {lost} were lost before it was repaired" if lost else ""
        writer = "it is still being written" if self.live else "its process was killed"
        cut = self._index.incomplete_bytes
        tail = f", its last {cut} bytes are incomplete" if cut else ""
        return f"it was not closed ({writer}){tail}"

    @property
    def damage(self) -> str:
        """All known damage, as text; "" if there is none."""
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
        """The newer release that wrote the recording; None for this release and older releases."""
        release = self._index.metadata.get("pycram", {}).get("pycram", "")
        if self.format <= format_number() and not _is_later(release):
            return None
        ours, definitions = f"{PACKAGE}.", self._index.definitions
        messages = {name.removeprefix(ours): data for name, data in definitions.items() if name.startswith(ours)}
        names = unknown_definitions(messages.values())
        kinds = tuple(name for name in names if name in messages)
        unknown_messages = {name for name in names if "." not in name}
        fields = tuple(name for name in names if "." in name and name.partition(".")[0] not in unknown_messages)
        return Newer(release, self.format, fields, kinds)

    @property
    def format(self) -> int:
        """The format number of the recording (:mod:`recorder.records`); 0 for old recordings without a number."""
        text = self._index.metadata.get("pycram", {}).get("format", "")
        return int(text) if text.isascii() and text.isdecimal() and len(text) <= _MAX_DIGITS else 0

    @cached_property
    def lifetimes(self) -> tuple[Lifetime, ...]:
        """The lifetimes of worlds in the order of their opening."""
        return lifetimes_of(self._chunks)

    def counts(self) -> dict[str, int]:
        """Return the number of records of each kind, according to the index. No record is decoded."""
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
        """Return the record of a step. Negative steps count from the end.

        Raises:
            NoSuchStep: There is no such step.
            Damaged: The record is lost.
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
        """Stream the records of types from ``start`` to ``stop`` (excluded). Records of other types aren't decoded.

        A type may also be given as a name, such as "query".

        Raises:
            NoSuchName: There is no type of records with this name.
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
            for record in self._chunks.records(number, kind):
                if start <= record.seq < end:
                    yield record
                elif not 0 <= record.seq < self._steps:
                    self._chunks.misplaced(number, record)

    @overload
    def backwards(self, start: int, kind: type[R], *, naming: str = "") -> Iterator[R]: ...
    @overload
    def backwards(self, start: int = -1, kind: Kinds | None = None, *, naming: str = "") -> Iterator[Record]: ...
    def backwards(self, start: int = -1, kind: Any = None, *, naming: str = "") -> Iterator[Any]:
        """Stream records backwards from a step to the first record. Negative steps count from the end.

        Only records of the given types with the text ``naming`` in a field are decoded.
        """
        first = start + self._steps if start < 0 else start
        for number in range(self.chunk_of(first), -1, -1):
            for record in self._chunks.records(number, kind, backwards=True, naming=naming):
                if record.seq <= first:
                    yield record

    def lifetime_at(self, world: str, step: int) -> Lifetime | None:
        """Return the world with a name at a step; None if no world had this name."""
        return next((lifetime for lifetime in self.lifetimes if lifetime.world == world and lifetime.has(step)), None)

    @overload
    def records_of(self, lifetime: Lifetime, kind: type[R], chunks: Sequence[int]) -> Iterator[R]: ...
    @overload
    def records_of(self, lifetime: Lifetime, kind: Kinds, chunks: Sequence[int]) -> Iterator[Record]: ...
    def records_of(self, lifetime: Lifetime, kind: Any, chunks: Sequence[int]) -> Iterator[Any]:
        """Stream the records of a world with given types in given chunks."""
        for number in chunks:
            for record in self._chunks.records(number, kind, lifetime.world):
                if lifetime.has(record.seq):
                    yield record

    def chunk_of(self, step: int) -> int:
        """Return the number of the chunk that may contain a step."""
        return self._chunks.chunk_of(step)

    def end_of(self, lifetime: Lifetime) -> Record | None:
        """Return the last change or keyframe of a world; None if the record is lost."""
        last = None
        for last in self.records_of(lifetime, (Mutation, Keyframe), lifetime.changes[-1:]):  # noqa: B007  the last record
            pass
        return last

    def final_step(self) -> int:
        """Return the last step before the worlds were closed at the end of the run."""
        closing = self._steps
        for record in self.backwards(-1, (Mutation, Keyframe)):
            if not closes_world(record):
                break
            closing = record.seq
        return max(closing - 1, 0)

    # --- completeness ----------------------------------------------------------------------------------------------

    def check_file(self) -> str:
        """Read the whole file once, and return :attr:`problems`."""
        last = -1
        for number in range(len(self._chunks)):
            for record in self._chunks.records(number):  # readers of records add all damage to problems
                if not last < record.seq < self._steps:
                    self._chunks.misplaced(number, record)
                last = record.seq
        for name in self.assets:
            with contextlib.suppress(Damaged):  # assets.damaged contains the damage
                _ = self.assets[name]
        if not self.damage:
            self._index.check()
        return self.problems

    def lost(self) -> list[range]:
        """Return the ranges of missing steps before the last step. Only damaged recordings are read for this."""
        intact = self._index.whole or (not self._index.closed and not self._index.damage)
        if intact and not self._chunks.damaged and not self._lost:
            return []
        if self._gaps_of != (len(self._chunks.damaged), self._steps):  # every state needs these gaps
            self._gaps.clear()
            expected = 0
            for record in self.records():
                if record.seq > expected:
                    self._gaps.append(range(expected, record.seq))
                expected = max(expected, record.seq + 1)
            self._gaps_of = len(self._chunks.damaged), self._steps
        return list(self._gaps)

    def write_sound(self, file: BinaryIO) -> Losses:
        """Write a sound copy of the readable part (:func:`replay.file.repair.write_sound`)."""
        self.check_file()
        return write_sound(file, self._index, self._chunks, self.assets, self.problems, self.missing())

    def write_packed(self, file: BinaryIO) -> None:
        """Write a copy of the recording and its models.

        Raises:
            MissingModels: The recording's models are missing.
            ReplayError: The recording isn't sound.
        """
        if cause := self.assets.missing(look=True):
            raise MissingModels(self.path, cause)
        if problems := self.check_file():
            raise ReplayError(f"{self.path}: it isn't sound ({problems}); use repair to copy the readable part")
        write_sound(file, self._index, self._chunks, self.assets, None, [])

    def missing(self) -> list[range]:
        """Return all ranges of missing steps, including those after the last record and before a repair."""
        gaps = self.lost()
        after = self._lost - sum(map(len, gaps))
        gaps += [range(self._steps, self._steps + after)] if after > 0 else []
        return list(dict.fromkeys([*gaps, *self.lost_before]))

    def refresh(self) -> bool:
        """Read the new records of a growing file; return whether the file has grown."""
        if not self._chunks.grow():
            return False
        self.__dict__.pop("lifetimes", None)
        self._steps = self._count()
        return True

    def _count(self) -> int:
        """Return the number of steps: the number of the last step plus 1."""
        for number in range(len(self._chunks) - 1, -1, -1):
            last = next(self._chunks.records(number, backwards=True), None)
            if last is not None:
                self._lost = abs(last.seq + 1 - sum(self.counts().values()))
                return last.seq + 1
        raise Unreadable(self.path, "has no record that can be read")


def open_file(path: Path) -> BinaryIO:
    """Open an MCAP file. A few of the file's first bytes may be damaged.

    Raises:
        NotALog: The file doesn't exist, or isn't an MCAP file.
        Unreadable: The file is empty, or is cut off within its first bytes.
    """
    try:
        with contextlib.ExitStack() as undoing:
            file = undoing.enter_context(open(path, "rb", opener=lambda name, flags: os.open(name, flags | _NONBLOCK)))
            _check_start(path, file)
            undoing.pop_all()
    except OSError as error:
        near = similar_files(path) if isinstance(error, FileNotFoundError) else ""
        raise NotALog(path, f"{error.strerror or error}{near}") from error
    return file


def _check_start(path: Path, file: BinaryIO) -> None:
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        raise NotALog(path, "isn't a regular file; reading needs random access: write the recording to a file first")
    start = file.read(len(MAGIC))
    if len(start) < len(MAGIC) and MAGIC.startswith(start):
        raise Unreadable(path, "is cut off within its first bytes" if start else "is empty")
    file.seek(-min(len(start), len(MAGIC)), os.SEEK_END)
    if sum(a == b for a, b in zip(start, MAGIC, strict=False)) < _MIN_MAGIC and file.read() != MAGIC:
        raise NotALog(path, "isn't an MCAP file")


def check_ours(path: Path, index: Index) -> None:
    """Raise an error if none of a file's channels belongs to a recording.

    Raises:
        NotALog: The file belongs to another program.
        Unreadable: Another release wrote the file, or the file is too damaged.
    """
    if kinds_of(index):
        return
    names = sorted(name for name in index.schemas.values() if name.startswith("pycram."))
    if names:
        raise Unreadable(
            path, f"was recorded by a release ({names[0]}) whose recordings this release can't read; use that release"
        )
    if index.library == MODELS_LIBRARY:
        raise NotALog(path, "contains the shared models of a sweep, and isn't a recording")
    if not index.library.startswith("pycram") and (index.channels or (index.closed and index.whole)):
        raise NotALog(path, "is an MCAP file, but not a recording of PyCRAM")
    raise Unreadable(path, "has no record that can be read")


def is_locked(file: BinaryIO) -> bool:
    """Return whether a recorder holds a lock of the file."""
    try:
        system.lock(file.fileno(), shared=True)
    except BlockingIOError:
        return True
    except OSError:  # the system or the file system doesn't support locks
        return False
    system.unlock(file.fileno())
    return False


@dataclass(frozen=True, slots=True)
class Newer:
    """A newer release that wrote a recording."""

    release: str  # version of the release
    format: int  # format number (:mod:`recorder.records`)
    fields: tuple[str, ...]  # unknown fields and enum values in known messages, such as ``Mutation.force``
    kinds: tuple[str, ...]  # unknown kinds of records

    def __str__(self) -> str:
        text = f"written by PyCRAM {self.release or 'of an unknown version'}, which is newer than this release"
        if self.fields:
            be = "is" if len(self.fields) == 1 else "are"
            text += f"; {_counted(self.fields, 'field')} unknown here {be} ignored {_listed(self.fields)}"
        if self.kinds:
            text += f"; for {_counted(self.kinds, 'kind')} of records only the envelope is read {_listed(self.kinds)}"
        return text


def _counted(names: Sequence[str], word: str) -> str:
    return f"{len(names)} {word}{'' if len(names) == 1 else 's'}"


def _listed(names: Sequence[str]) -> str:
    more = ", ..." if len(names) > _MAX_NAMES else ""
    return f"({', '.join(names[:_MAX_NAMES])}{more})"


def _is_later(release: str) -> bool:
    """Return whether a release is known to be later than this release."""
    other = _RELEASE.match(release)
    if other is None or _numbers(other) <= _FIRST:
        return False
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415  slow to import

    try:
        own = _RELEASE.match(version("pycram"))
    except PackageNotFoundError:
        return False
    return own is not None and _numbers(other) > _numbers(own)


def _numbers(release: re.Match[str]) -> list[int]:
    return [int(part or 0) for part in release.groups()]
