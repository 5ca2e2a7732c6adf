"""Rows of an entity's components, gathered and sent as columns: one call for many moments.

Every row stands on three time lines: ``step`` (the record's number), ``sim`` (simulated time) and ``wall`` (the clock).
Rows of one moment replace one another in the order in which they were added.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
import rerun as rr

from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    Maker: TypeAlias = Callable[[Sequence[tuple[Any, ...]]], Iterable[rr.ComponentColumn]]

_STEP_NS: Final = 1_000_000_000 / STEPS_PER_SECOND  # of a simulated step
_STEP: Final = "step"
_SIM: Final = "sim"
_WALL: Final = "wall"


class Moment(NamedTuple):
    """When something is so.

    Attributes:
        step: the record's number.
        sim: simulated time in ns.
        wall: ns since the Unix epoch.
    """

    step: int
    sim: int
    wall: int


def simulated(step: int) -> int:
    """Simulated time in ns.

    Args:
        step: a record's ``sim_step``.
    """
    return round(step * _STEP_NS)


class Series:
    """Rows of one kind that wait to be sent.

    Args:
        maker: makes columns of them.
    """

    __slots__ = ("maker", "moments", "rows")

    def __init__(self, maker: Maker) -> None:
        self.maker = maker
        self.moments: list[Moment] = []
        self.rows: list[tuple[Any, ...]] = []

    def add(self, moment: Moment, row: tuple[Any, ...]) -> None:
        """Adds a row.

        Args:
            moment: when.
            row: what the maker takes.
        """
        self.moments.append(moment)
        self.rows.append(row)

    def take(self) -> tuple[list[Moment], list[tuple[Any, ...]]]:
        """Takes all moments and rows away."""
        taken = self.moments, self.rows
        self.moments, self.rows = [], []
        return taken


class Columns:
    """What is to be sent; for one thread.

    Args:
        stream: where it goes.
        root: the entity that all others are below; "" for none.
    """

    def __init__(self, stream: rr.RecordingStream, root: str = "") -> None:
        self._stream = stream
        self._root = [root] if root else []
        self._series: dict[str, dict[Maker, Series]] = {}
        self._standing: set[str] = set()

    def path(self, *parts: str) -> str:
        """The path of an entity.

        Args:
            parts: its name and those of the ones above it, from the top; anything may stand in them.
        """
        return rr.new_entity_path([*self._root, *parts])

    def series(self, path: str, maker: Maker) -> Series:
        """Where rows of what comes often are added; always the same for the same.

        Args:
            path: of the entity.
            maker: makes columns of its rows.
        """
        makers = self._series.setdefault(path, {})
        if maker not in makers:
            makers[maker] = Series(maker)
        return makers[maker]

    def add(self, path: str, maker: Maker, moment: Moment, *row: Any) -> None:
        """Adds a row of what comes often.

        Args:
            path: of the entity.
            maker: makes columns of its rows.
            moment: when.
            row: what the maker takes.
        """
        self.series(path, maker).add(moment, row)

    def put(self, path: str, moment: Moment, *archetypes: rr.AsComponents) -> None:
        """Adds a row of what comes seldom.

        Args:
            path: of the entity.
            moment: when.
            archetypes: what it is from then on.
        """
        self._flush(path)  # rows of one entity keep their order
        self._send(path, [moment], _single(archetypes))

    def clear(self, path: str, moment: Moment) -> None:
        """Takes away what an entity shows; what is below it stays.

        Args:
            path: of the entity.
            moment: from when on.
        """
        self.put(path, moment, rr.Clear(recursive=False))

    def fix(self, path: str, archetype: rr.AsComponents) -> None:
        """Says what an entity is at all times.

        Args:
            path: of the entity.
            archetype: what it is.
        """
        self._stream.log(path, archetype, static=True)

    def stand(self, path: str, frame: str) -> None:
        """Says in which frame an entity stands, at all times.

        Args:
            path: of the entity.
            frame: name of the frame.
        """
        if path not in self._standing:
            self._standing.add(path)
            self.fix(path, rr.CoordinateFrame(frame))

    def flush(self) -> None:
        """Sends what waits."""
        for path in self._series:
            self._flush(path)

    def _flush(self, path: str) -> None:
        for series in self._series.get(path, {}).values():
            if series.rows:
                moments, rows = series.take()
                self._send(path, moments, series.maker(rows))

    def _send(self, path: str, moments: Sequence[Moment], columns: Iterable[rr.ComponentColumn]) -> None:
        times = np.fromiter(chain.from_iterable(moments), np.int64, 3 * len(moments)).reshape(-1, 3)
        lines = (
            rr.TimeColumn(_STEP, sequence=times[:, 0]),
            rr.TimeColumn(_SIM, duration=times[:, 1].astype("timedelta64[ns]")),
            rr.TimeColumn(_WALL, timestamp=times[:, 2].astype("datetime64[ns]")),
        )
        self._stream.send_columns(path, lines, columns)


def _single(archetypes: Iterable[rr.AsComponents]) -> list[rr.ComponentColumn]:
    """Columns with one row."""
    return [
        rr.ComponentColumn(batch.component_descriptor(), batch, lengths=[len(batch.as_arrow_array())])
        for archetype in archetypes
        for batch in archetype.as_component_batches()
    ]
