"""Rerun streams, to a viewer or into an ``.rrd`` file: rows of components, buffered and sent as columns.

Every row stands on three time lines: ``step`` (the record's number), ``sim`` (simulated time) and ``wall`` (the clock).
Rows of one time point replace one another in the order in which they were added. Colours of marks, log lines and tasks
can be read on the viewer's dark ground and on its light one.
"""

from __future__ import annotations

import contextlib
import os
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
import rerun as rr

from recorder.records import STEPS_PER_SECOND
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    ColumnMaker: TypeAlias = Callable[[Sequence[tuple[Any, ...]]], Iterable[rr.ComponentColumn]]


APPLICATION: Final = "pycram"  # viewers remember a layout for each application
_WRITE_TIMEOUT: Final = 60.0  # s for rows to get into a file
_SWITCH: Final = "RERUN"  # the variable that silences programs which log to viewers


@contextlib.contextmanager
def stream_to_viewer(connect: Callable[[rr.RecordingStream], None] | None = None) -> Iterator[rr.RecordingStream]:
    """Open a stream for rows, even if the environment has viewers switched off, as this one was requested.

    ``connect`` gives the stream its sink, before a Ctrl-C is raised.
    """
    switched = os.environ.pop(_SWITCH, None)
    try:
        with Uninterrupted():  # one that Ctrl-C leaves half made or without a sink makes the library complain on stderr
            stream = rr.RecordingStream(APPLICATION)
            if connect is not None:
                connect(stream)
        yield stream
    finally:
        if switched is not None:
            os.environ[_SWITCH] = switched


@contextlib.contextmanager
def stream_to_file(file: Path) -> Iterator[rr.RecordingStream]:
    """Open a stream into a file, replaced and complete at the block's end; raise OSError if it can't be written."""
    with stream_to_viewer(lambda stream: stream.save(file)) as stream:
        yield stream
        try:
            stream.flush(timeout_sec=_WRITE_TIMEOUT)
        except RuntimeError as error:  # the library has one type for all, and a message with the cause
            raise OSError(str(error)) from error
        stream.disconnect()


class TimePoint(NamedTuple):
    """A point on the three time lines."""

    step: int  # the record's number
    sim: int  # simulated time in ns
    wall: int  # ns since the Unix epoch


def sim_ns(sim_step: int) -> int:
    """Simulated time in ns."""
    return round(sim_step * 1e9 / STEPS_PER_SECOND)


class Series:
    """Buffered rows of one entity that become the same columns."""

    __slots__ = ("maker", "rows", "times")

    def __init__(self, maker: ColumnMaker) -> None:
        self.maker = maker
        self.times: list[TimePoint] = []
        self.rows: list[tuple[Any, ...]] = []

    def add(self, time: TimePoint, row: tuple[Any, ...]) -> None:
        """Adds a row, as the maker takes it."""
        self.times.append(time)
        self.rows.append(row)


class Columns:
    """Buffers of all entities of a stream, below a root entity if one is named; for one thread."""

    def __init__(self, stream: rr.RecordingStream, root: str = "") -> None:
        self._stream = stream
        self._root = [root] if root else []
        self._series: dict[str, dict[ColumnMaker, Series]] = {}
        self._in_frames: set[str] = set()

    def path(self, *parts: str) -> str:
        """Path of an entity from the names of its ancestors and its own, which may hold any characters."""
        return rr.new_entity_path([*self._root, *parts])

    def series(self, path: str, maker: ColumnMaker) -> Series:
        """The buffer for rows that come often; always the same object for the same entity and maker."""
        makers = self._series.setdefault(path, {})
        if maker not in makers:
            makers[maker] = Series(maker)
        return makers[maker]

    def send(self, path: str, time: TimePoint, *archetypes: rr.AsComponents) -> None:
        """Sends one row at once: what the entity is from that time on."""
        self._flush(path)  # rows of one entity keep their order
        batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
        columns = [
            rr.ComponentColumn(batch.component_descriptor(), batch, lengths=[len(batch.as_arrow_array())])
            for batch in batches
        ]
        self._send(path, [time], columns)

    def clear(self, path: str, time: TimePoint) -> None:
        """Removes what an entity shows from that time on; entities below it stay."""
        self.send(path, time, rr.Clear(recursive=False))

    def send_static(self, path: str, archetype: rr.AsComponents) -> None:
        """Sends what an entity is at all times."""
        self._stream.log(path, archetype, static=True)

    def set_frame(self, path: str, frame: str) -> None:
        """Places an entity in a coordinate frame, at all times."""
        if path not in self._in_frames:
            self._in_frames.add(path)
            self.send_static(path, rr.CoordinateFrame(frame))

    def flush(self) -> None:
        """Sends all buffered rows."""
        for path in self._series:
            self._flush(path)

    def _flush(self, path: str) -> None:
        for series in self._series.get(path, {}).values():
            if series.rows:
                times, rows = series.times, series.rows
                series.times, series.rows = [], []
                self._send(path, times, series.maker(rows))

    def _send(self, path: str, times: Sequence[TimePoint], columns: Iterable[rr.ComponentColumn]) -> None:
        indexes = np.fromiter(chain.from_iterable(times), np.int64, 3 * len(times)).reshape(-1, 3)
        time_columns = (
            rr.TimeColumn("step", sequence=indexes[:, 0]),
            rr.TimeColumn("sim", duration=indexes[:, 1].astype("timedelta64[ns]")),
            rr.TimeColumn("wall", timestamp=indexes[:, 2].astype("datetime64[ns]")),
        )
        self._stream.send_columns(path, time_columns, columns)


Color: TypeAlias = tuple[int, int, int]
"""RGB 0..255."""

BLUE: Final[Color] = (75, 145, 245)
GREEN: Final[Color] = (45, 165, 95)
RED: Final[Color] = (242, 82, 72)
YELLOW: Final[Color] = (205, 150, 0)
GREY: Final[Color] = (140, 140, 140)
