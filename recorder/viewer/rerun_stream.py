"""Rerun streams, to a viewer or into an ``.rrd`` file; streams buffer rows of components, and send columns.

Every row is on three time lines: ``step number`` (of the record), ``sim`` (simulated time) and ``wall`` (the clock). A
later row at the same time replaces an earlier row. All colours are readable on the viewer's dark and light backgrounds.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
import rerun as rr

from recorder.records import STEPS_PER_SECOND
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    ColumnMaker: TypeAlias = Callable[[Sequence[tuple[Any, ...]]], Iterable[rr.ComponentColumn]]

STEP: Final = "step number"  # time line of the records' numbers; the log's column is as wide as this name
APPLICATION: Final = "pycram"  # viewers remember the user's layout under this name
_WRITE_TIMEOUT: Final = 60.0  # timeout in s for writing the rows of a file
_SWITCH: Final = "RERUN"  # environment variable that turns viewers off


@contextlib.contextmanager
def stream_to_viewer(connect: Callable[[rr.RecordingStream], None] | None = None) -> Iterator[rr.RecordingStream]:
    """Open a stream for rows, even if the environment variable ``RERUN`` turns viewers off.

    ``connect`` sets the sink of the stream. Until the stream has a sink, Ctrl-C is deferred.
    """
    switched = os.environ.pop(_SWITCH, None)
    try:
        with Uninterrupted():  # otherwise, after a Ctrl-C, the library would complain about a stream without a sink
            stream = rr.RecordingStream(APPLICATION)
            if connect is not None:
                connect(stream)
        yield stream
    finally:
        if switched is not None:
            os.environ[_SWITCH] = switched


@contextlib.contextmanager
def stream_to_file(file: Path) -> Iterator[rr.RecordingStream]:
    """Open a stream that replaces a file. The file is complete at the end of the block, or OSError is raised."""
    with stream_to_viewer(lambda stream: stream.save(file)) as stream:
        yield stream
        try:
            stream.flush(timeout_sec=_WRITE_TIMEOUT)
        except RuntimeError as error:  # the library raises RuntimeError for every error
            raise OSError(str(error)) from error
        stream.disconnect()


class TimePoint(NamedTuple):
    """A point on the three time lines."""

    step: int
    sim: int  # simulated time, ns
    wall: int  # wall-clock time, ns since the Unix epoch


def up_to(step: int) -> str:
    """Return the name of the time line that ends at a step."""
    return f"up to step {step}"


def sim_ns(sim_step: int) -> int:
    """Return the simulated time in ns."""
    return round(sim_step * 1e9 / STEPS_PER_SECOND)


class Series:
    """Buffered rows of an entity, which are sent as columns."""

    def __init__(self, maker: ColumnMaker) -> None:
        self.maker = maker
        self.times: list[TimePoint] = []
        self.rows: list[tuple[Any, ...]] = []

    def add(self, time: TimePoint, row: tuple[Any, ...]) -> None:
        """Add a row, in the form that the maker of components expects."""
        self.times.append(time)
        self.rows.append(row)


class Columns:
    """Buffers of all entities of a stream, below an optional root entity. This class isn't thread-safe.

    Rows up to the step ``until`` are also on a fourth time line, which ends there (:func:`up_to`).
    """

    def __init__(self, stream: rr.RecordingStream, root: str = "", until: int | None = None) -> None:
        self._stream = stream
        self._until = until
        self._root = [root] if root else []
        self._series: dict[str, dict[ColumnMaker, Series]] = {}
        self._in_frames: set[str] = set()

    def path(self, *parts: str) -> str:
        """Return the path of an entity. ``parts`` are names of its ancestors and the entity, with any characters."""
        return rr.new_entity_path([*self._root, *parts])

    def series(self, path: str, maker: ColumnMaker) -> Series:
        """Return the buffer for rows of an entity that come often, by the maker of their components."""
        makers = self._series.setdefault(path, {})
        if maker not in makers:
            makers[maker] = Series(maker)
        return makers[maker]

    def send(self, path: str, time: TimePoint, *archetypes: rr.AsComponents) -> None:
        """Send a row immediately. From then on, the entity has these components."""
        self._flush(path)  # rows of an entity must stay in order
        columns = [
            rr.ComponentColumn(batch.component_descriptor(), batch, lengths=[len(batch.as_arrow_array())])
            for archetype in archetypes
            for batch in archetype.as_component_batches()
        ]
        self._send(path, [time], columns)

    def clear(self, path: str, time: TimePoint) -> None:
        """Clear an entity from a time on. Entities below this entity aren't cleared."""
        self.send(path, time, rr.Clear(recursive=False))

    def send_static(self, path: str, archetype: rr.AsComponents) -> None:
        """Send an entity's components for all times."""
        self._stream.log(path, archetype, static=True)

    def set_frame(self, path: str, frame: str) -> None:
        """Put an entity into a coordinate frame for all times."""
        if path not in self._in_frames:
            self._in_frames.add(path)
            self.send_static(path, rr.CoordinateFrame(frame))

    def flush(self) -> None:
        """Send all buffered rows."""
        for path in self._series:
            self._flush(path)

    def _flush(self, path: str) -> None:
        for series in self._series.get(path, {}).values():
            if series.rows:
                times, rows = series.times, series.rows
                series.times, series.rows = [], []
                late = [self._until is not None and time.step > self._until for time in times]
                for part in sorted({*late}):  # a call can send rows only to the same time lines
                    chosen = [number for number, is_late in enumerate(late) if is_late == part]
                    self._send(path, [times[each] for each in chosen], series.maker([rows[each] for each in chosen]))

    def _send(self, path: str, times: Sequence[TimePoint], columns: Iterable[rr.ComponentColumn]) -> None:
        indexes = np.fromiter(chain.from_iterable(times), np.int64, 3 * len(times)).reshape(-1, 3)
        time_columns = [
            rr.TimeColumn(STEP, sequence=indexes[:, 0]),
            rr.TimeColumn("sim", duration=indexes[:, 1].astype("timedelta64[ns]")),
            rr.TimeColumn("wall", timestamp=indexes[:, 2].astype("datetime64[ns]")),
        ]
        if self._until is not None and times[0].step <= self._until:
            time_columns.append(rr.TimeColumn(up_to(self._until), sequence=indexes[:, 0]))
        self._stream.send_columns(path, time_columns, columns)


Color: TypeAlias = tuple[int, int, int]  # RGB 0..255

BLUE: Final[Color] = (75, 145, 245)
GREEN: Final[Color] = (45, 165, 95)
RED: Final[Color] = (242, 82, 72)
YELLOW: Final[Color] = (205, 150, 0)
VIOLET: Final[Color] = (160, 105, 235)
GREY: Final[Color] = (140, 140, 140)
