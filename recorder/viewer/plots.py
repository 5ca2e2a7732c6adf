"""Curves: the heights of things, and the joints of robots and furniture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import rerun as rr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records.frames import Moved
    from recorder.viewer.columns import Columns, Moment, Series
    from recorder.viewer.scene import Body

HEIGHTS: Final = "heights"
JOINTS: Final = "joints"
_STEPS: Final = rr.components.InterpolationMode.StepAfter  # a value holds until the next record


class Plots:
    """All curves.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._last: dict[tuple[str, str, str], tuple[Moment, float]] = {}
        self._series: dict[tuple[str, str, str], Series] = {}

    def show(self, world: str, body: Body, moved: Moved, now: Moment) -> None:
        """Shows what was told of a body.

        Args:
            world: name of the world.
            body: the body.
            moved: what was told.
            now: when.
        """
        for joint, value in moved.joints.items():
            self._add((world, moved.body, joint), value, now)
        if not body.loaded.fixed_base:
            self._add((world, moved.body, ""), body.pose[0][2], now)

    def _add(self, key: tuple[str, str, str], value: float, now: Moment) -> None:
        """Adds a value that has changed; what never changes has no curve."""
        last = self._last.get(key)
        if last is not None and last[1] == value:
            return
        self._last[key] = (now, value)
        if last is None:
            return
        series = self._series.get(key)
        if series is None:
            world, body, joint = key
            path = self._columns.path("plots", *((JOINTS, world, body, joint) if joint else (HEIGHTS, world, body)))
            self._columns.fix(path, rr.SeriesLines(interpolation_mode=_STEPS))
            series = self._series[key] = self._columns.series(path, _scalars)
            series.add(last[0], (last[1],))
        series.add(now, (value,))


def _scalars(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    return rr.Scalars.columns(scalars=[value for (value,) in rows])
