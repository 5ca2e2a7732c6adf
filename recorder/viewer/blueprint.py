"""The viewer's layout: scene and tasks over time to the left; to the right task tree, query, log, curves and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun.blueprint as rrb
from rerun import new_entity_path

from recorder.records.motion import ROOT
from recorder.viewer.marks import FAILURES
from recorder.viewer.queries import PAGE, PICTURE, QUERIES
from recorder.viewer.scene import COLLISION
from recorder.viewer.tables_and_plots import HEIGHTS, JOINTS, KINDS, LOG, RECORDS
from recorder.viewer.tasks import GRAPH, LANES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Vector

ORIGIN: Final = (0.0, 0.0, 0.0)
_WORLD: Final = "world_1"  # what the first one is called by default
_EYE: Final = (-2.6, -2.6, 2.3)  # m, from a world's centre


def blueprint(worlds: Mapping[str, Vector], front: str = "") -> rrb.Blueprint:
    """The layout for a recording, by the centres of its known worlds in m, with the tab of ``front`` open."""
    left, right = _scenes("", worlds, front), _details("", worlds)
    return _whole(rrb.Horizontal(left, right, column_shares=[3, 2]))


def side_by_side(recordings: Mapping[str, Mapping[str, Vector]], fronts: Mapping[str, str]) -> rrb.Blueprint:
    """The layout for recordings that are compared; as :func:`blueprint`, by the root of each recording's entities."""
    columns = [
        rrb.Vertical(_scenes(root, worlds, fronts[root]), _details(root, worlds), row_shares=[3, 2], name=root)
        for root, worlds in recordings.items()
    ]
    return _whole(rrb.Horizontal(*columns))


def _whole(views: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline="step", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scenes(root: str, worlds: Mapping[str, Vector], front: str) -> rrb.Container:
    """The scenes, and the tasks over time."""
    named = sorted((worlds or {_WORLD: ORIGIN}).items(), key=lambda world: world[0] != front)
    scenes = [_scene(root, world, centre) for world, centre in named]
    timeline = rrb.StateTimelineView(origin=f"{_path(root)}/{LANES}", name="Tasks over time")
    return rrb.Vertical(rrb.Tabs(*scenes, active_tab=0), timeline, row_shares=[5, 2])


def _details(root: str, worlds: Mapping[str, Vector]) -> rrb.Container:
    """The task tree and queries, and below them log, curves and tables."""
    top = _path(root)
    log = [f"{top}/{LOG}/**", *(f"{_path(root, world)}/{FAILURES}" for world in worlds)]
    return rrb.Vertical(
        rrb.Tabs(
            rrb.GraphView(origin=f"{top}/tasks/{GRAPH}", name="Task tree"),
            rrb.TextDocumentView(origin=f"{top}/{QUERIES}/{PAGE}", name="Query"),
            rrb.Spatial2DView(origin=f"{top}/{QUERIES}/{PICTURE}", name="What it saw"),
        ),
        rrb.Tabs(
            rrb.TextLogView(origin="/", contents=log, name="Log"),
            rrb.TimeSeriesView(origin=f"{top}/plots/{HEIGHTS}", name="Heights"),
            rrb.TimeSeriesView(
                origin=f"{top}/plots/{JOINTS}", name="Joints", plot_legend=rrb.PlotLegend(visible=False)
            ),
            rrb.Tabs(
                *(rrb.DataframeView(origin=f"{top}/{RECORDS}/{kind}", name=kind) for kind in KINDS), name="Records"
            ),
        ),
    )


def _scene(root: str, world: str, centre: Vector) -> rrb.Spatial3DView:
    path = _path(root, world)
    x, y, z = (middle + offset for middle, offset in zip(centre, _EYE, strict=True))
    return rrb.Spatial3DView(
        origin="/",
        contents=[f"{path}/**"],
        name=f"{root} {world}".strip(),
        eye_controls=rrb.EyeControls3D(position=(x, y, z), look_target=centre),
        spatial_information=rrb.SpatialInformation(target_frame=f"{root}/{ROOT}" if root else ROOT),
        overrides={f"{path}/{COLLISION}": rrb.EntityBehavior(visible=False)},
    )


def _path(*parts: str) -> str:
    """The path of an entity; worlds and recordings can be called anything."""
    named = [part for part in parts if part]
    return new_entity_path(named) if named else ""
