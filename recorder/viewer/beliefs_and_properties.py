"""Ghosts where robots wrongly believe objects, and curves of the watched properties: both need the folded worlds.

A ghost is a translucent copy of an object. A ghost is shown while the believed position is more than 1 cm from the
actual position. The curve of a property is the margin of its expression, which is negative while the expression doesn't
hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from recorder.geometry import Pose
from recorder.properties.expressions import BadProperty, NoValue, PropertyExpression, Scene
from recorder.properties.language import parse
from recorder.records import Belief, Check, Keyframe, Mutation, Query
from recorder.records.fold import FoldedWorld, apply, quaternion, vector
from recorder.viewer.marks import Marks, points_at
from recorder.viewer.rerun_stream import VIOLET, Columns, TimePoint
from recorder.viewer.scene import ViewerScene

if TYPE_CHECKING:
    from recorder.viewer.tables_and_plots import Plots

GHOSTS: Final = "beliefs"
_SOLID: Final = 0.45  # opacity of a ghost
_NEAR: Final = 0.01  # error in m below which a belief has no ghost


class FoldedWorlds:
    """Ghosts and curves of properties, from the folded states of all worlds."""

    def __init__(self, columns: Columns, scene: ViewerScene, plots: Plots) -> None:
        self._columns, self._scene, self._plots = columns, scene, plots
        self._worlds: dict[str, FoldedWorld] = {}
        self._properties: dict[str, PropertyExpression] = {}  # watched properties, by text
        self._quantities = Scene(self._worlds)
        self._ghosts: dict[tuple[str, str, str], tuple[Pose, Marks]] = {}  # ghosts by world, robot and object

    def watch(self, record: Check) -> None:
        """Begin the curve of a watched property. Contacts need the executor, so their properties have no curve."""
        with suppress(BadProperty):  # a newer release may have recorded the property
            statement = parse(record.property)
            if not statement.needs_geometry:
                self._properties.setdefault(record.property, statement.body)

    def show(self, record: Mutation | Keyframe | Query, now: TimePoint, time_of: Callable[[int], TimePoint]) -> None:
        """Fold a record. ``time_of`` returns the time of a simulated step within the record."""
        if isinstance(record, Mutation) and self._properties and record.world in self._worlds:
            for sample in record.effect.samples:
                self._worlds[record.world].apply_sample(sample)
                self._plot(time_of(sample.sim_step))
        apply(self._worlds, record)
        self._plot(now)
        if (world := self._worlds.get(record.world)) is not None and world.open:
            self._show_ghosts(world, now)

    def _plot(self, now: TimePoint) -> None:
        for text, expression in self._properties.items():
            with suppress(NoValue):
                truth = expression.truth(self._quantities)
                margin = truth.margin if math.isfinite(truth.margin) else 1.0 if truth.holds else -1.0
                self._plots.show_property(text, margin, now)

    def _show_ghosts(self, world: FoldedWorld, now: TimePoint) -> None:
        wrong: dict[tuple[str, str, str], Pose] = {
            (world.name, robot, name): (vector(belief.position), quaternion(belief.orientation))
            for (robot, name), belief in world.beliefs.items()
            if belief.source != Belief.HELD
            and name in world.bodies
            and math.dist(belief.position, world.bodies[name].position) > _NEAR
        }
        for key, (pose, marks) in list(self._ghosts.items()):
            if key[0] == world.name and wrong.get(key) != pose:
                marks.clear(now)
                del self._ghosts[key]
        for key in wrong.keys() - self._ghosts.keys():
            _, robot, name = key
            pose, marks = self._ghosts[key] = wrong[key], Marks(self._columns, self._scene)
            red, green, blue = (channel / 255 for channel in VIOLET)
            for shape, archetypes in self._scene.ghost(world.name, name, pose, (red, green, blue, _SOLID)):
                marks.add(world.name, (GHOSTS, robot, name, shape), now, *archetypes)
            label = points_at([pose[0]], VIOLET, [f"{robot} believes {name} here"])
            marks.add(world.name, (GHOSTS, robot, name), now, label)
