"""Curves over time: the heights of bodies, and the joints of robots and furniture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import rerun as rr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records.frames import BodyMotion
    from recorder.viewer.columns import Columns, Series, TimePoint
    from recorder.viewer.scene import SceneBody

HEIGHTS: Final = "heights"
JOINTS: Final = "joints"
_STEPS: Final = rr.components.InterpolationMode.StepAfter  # a value holds until the next record


class Plots:
    """A curve for each body's height (m) and for each joint (rad or m) that ever changes."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._last: dict[tuple[str, str, str], tuple[TimePoint, float]] = {}
        self._series: dict[tuple[str, str, str], Series] = {}

    def show(self, world: str, body: SceneBody, motion: BodyMotion, now: TimePoint) -> None:
        """Adds the values that a motion changed; the body is at its end already."""
        for joint, value in motion.joints.items():
            self._add((world, motion.body, joint), value, now)
        if not body.loaded.fixed_base:
            self._add((world, motion.body, ""), body.pose[0][2], now)

    def _add(self, key: tuple[str, str, str], value: float, now: TimePoint) -> None:
        last = self._last.get(key)
        if last is not None and last[1] == value:
            return
        self._last[key] = (now, value)
        if last is None:  # a curve begins with the first change
            return
        series = self._series.get(key)
        if series is None:
            world, body, joint = key
            path = self._columns.path("plots", *((JOINTS, world, body, joint) if joint else (HEIGHTS, world, body)))
            self._columns.send_static(path, rr.SeriesLines(interpolation_mode=_STEPS))
            series = self._series[key] = self._columns.series(path, _scalars)
            series.add(last[0], (last[1],))
        series.add(now, (value,))


def _scalars(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    return rr.Scalars.columns(scalars=[value for (value,) in rows])
