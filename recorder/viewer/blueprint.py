"""The viewer's layout: the scene and the tasks over time to the left, to the right what is known of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun.blueprint as rrb

from recorder.frames import ROOT
from recorder.viewer.graph import GRAPH
from recorder.viewer.lanes import LANES
from recorder.viewer.lines import LOG
from recorder.viewer.plots import HEIGHTS, JOINTS
from recorder.viewer.questions import PAGE, PICTURE, QUERIES
from recorder.viewer.scene import COLLISION
from recorder.viewer.tables import RECORDS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Vector

_WORLD: Final = "world_1"  # what the first one is called by default
_FROM: Final = (-2.2, -2.1, 1.9)  # m, from where a world's middle is looked at


def blueprint(worlds: Mapping[str, Vector]) -> rrb.Blueprint:
    """The layout for a recording.

    Args:
        worlds: middles of its worlds, as far as they are known; the last one is in front.
    """
    names = list(worlds) or [_WORLD]
    scenes = [_scene(world, worlds.get(world, (0.0, 0.0, 0.0))) for world in names]
    log = [f"/{LOG}/**", *(f"/{world}/failures" for world in names)]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Tabs(*scenes, active_tab=len(scenes) - 1) if len(scenes) > 1 else scenes[0],
                rrb.StateTimelineView(origin=f"/tasks/{LANES}", name="Tasks over time"),
                row_shares=[5, 2],
            ),
            rrb.Vertical(
                rrb.Tabs(
                    rrb.GraphView(origin=f"/tasks/{GRAPH}", name="Task tree"),
                    rrb.TextDocumentView(origin=f"/{QUERIES}/{PAGE}", name="Query"),
                    rrb.Spatial2DView(origin=f"/{QUERIES}/{PICTURE}", name="What it saw"),
                ),
                rrb.Tabs(
                    rrb.TextLogView(origin="/", contents=log, name="Log"),
                    rrb.TimeSeriesView(origin=f"/plots/{HEIGHTS}", name="Heights"),
                    rrb.TimeSeriesView(origin=f"/plots/{JOINTS}", name="Joints"),
                    rrb.DataframeView(origin=f"/{RECORDS}", name="Records"),
                ),
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline="step", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scene(world: str, middle: Vector) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        contents=[f"/{world}/**"],
        name=world,
        eye_controls=rrb.EyeControls3D(
            position=[place + way for place, way in zip(middle, _FROM, strict=True)], look_target=middle
        ),
        spatial_information=rrb.SpatialInformation(target_frame=ROOT),
        overrides={f"/{world}/{COLLISION}": rrb.EntityBehavior(visible=False)},
    )
