"""Curves: the heights of things, and the joints of robots and furniture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import rerun as rr

from recorder.records import Keyframe

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from recorder.records import BodyState, Mutation
    from recorder.viewer.columns import Columns, Moment, Series
    from recorder.viewer.scene import Scene

HEIGHTS: Final = "heights"
JOINTS: Final = "joints"
_STEPS: Final = rr.components.InterpolationMode.StepAfter  # a value holds until the next record


class Plots:
    """All curves.

    Args:
        columns: where it goes.
        scene: whose bodies they tell of.
    """

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._last: dict[tuple[str, str, str], tuple[Moment, float]] = {}
        self._series: dict[tuple[str, str, str], Series] = {}

    def show(self, record: Mutation | Keyframe, moments: Mapping[int, Moment]) -> None:
        """Shows what a record changed; the scene has shown it before."""
        there = self._scene.bodies.get(record.world, {})
        for step, state in _states(record):
            body = there.get(state.body)
            if body is None:
                continue
            now = moments[step]
            if state.position and not body.loaded.fixed_base:
                self._add(record.world, state.body, "", state.position[2], now)
            if state.joints:
                for joint, value in zip(state.joints, state.joint_positions, strict=True):
                    self._add(record.world, state.body, joint, value, now)

    def _add(self, world: str, body: str, joint: str, value: float, now: Moment) -> None:
        """Adds a value that has changed; what never changes has no curve."""
        key = (world, body, joint)
        last = self._last.get(key)
        if last is not None and last[1] == value:
            return
        self._last[key] = (now, value)
        if last is None:
            return
        series = self._series.get(key)
        if series is None:
            path = self._columns.path("plots", *((JOINTS, world, body, joint) if joint else (HEIGHTS, world, body)))
            self._columns.fix(path, rr.SeriesLines(interpolation_mode=_STEPS))
            series = self._series[key] = self._columns.series(path, _scalars)
            series.add(last[0], (last[1],))
        series.add(now, (value,))


def _states(record: Mutation | Keyframe) -> Iterator[tuple[int, BodyState]]:
    if isinstance(record, Keyframe):
        yield from ((record.sim_step, state) for state in record.bodies)
        return
    for sample in record.effect.samples:
        yield from ((sample.sim_step, state) for state in sample.bodies)
    yield from ((record.sim_step, state) for state in record.effect.bodies)


def _scalars(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    return rr.Scalars.columns(scalars=[value for (value,) in rows])
