"""The content of an .rrd file, for tests: values of components by entity and moment."""

from __future__ import annotations

import warnings
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

import recorder
from pycram.bullet_world import BulletWorld, Object
from recorder import geometry
from recorder.viewer.rerun_stream import STEP
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.geometry import Pose

LINES = (STEP, "sim", "wall")
_BLUEPRINT = ("/view/", "/container/", "/viewport", "/blueprint_panel", "/selection_panel", "/time_panel")


class Shown:
    """A file's rows.

    Attributes:
        rows: by entity: moments on the three time lines, values by component; in the order of their making.
        fixed: values by entity and component that hold at all times.
    """

    def __init__(self, file: Path) -> None:
        entities: dict[str, list[tuple[bytes, tuple[int, ...], dict[str, Any]]]] = defaultdict(list)
        fixed: list[tuple[bytes, str, dict[str, Any]]] = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RerunWarning)
            chunks = [chunk for chunk in RrdReader(file).stream() if not chunk.entity_path.startswith(_BLUEPRINT)]
        for chunk in chunks:
            table = chunk.to_record_batch()
            names = [name for name in table.schema.names if name not in (*LINES, "rerun.controls.RowId")]
            columns = {name: table.column(name).to_pylist() for name in names}
            ids = table.column("rerun.controls.RowId").to_pylist()
            times = [] if chunk.is_static else [table.column(line).cast("int64").to_pylist() for line in LINES]
            for row in range(chunk.num_rows):
                values = {name: column[row] for name, column in columns.items() if column[row] is not None}
                if chunk.is_static:
                    fixed.append((ids[row], chunk.entity_path, values))
                else:
                    entities[chunk.entity_path].append((ids[row], tuple(line[row] for line in times), values))
        self.rows = {
            entity: [(moment, values) for _, moment, values in sorted(rows, key=lambda row: row[0])]
            for entity, rows in entities.items()
        }

        self.fixed: dict[str, dict[str, Any]] = defaultdict(dict)
        for _, entity, values in sorted(fixed, key=lambda row: row[0]):
            self.fixed[entity] |= values

    def counts(self) -> Counter[tuple[str, str]]:
        """How many values each component of each entity has at its moments."""
        counts: Counter[tuple[str, str]] = Counter()
        for entity, rows in self.rows.items():
            for _, values in rows:
                counts.update((entity, name) for name in values)
        return counts

    def at(self, entity: str, step: int) -> dict[str, Any]:
        """An entity's components at a step: the last value of each, unless the entity was cleared since."""
        now: dict[str, Any] = {}
        for moment, values in sorted(self.rows.get(entity, []), key=lambda row: row[0][0]):
            if moment[0] > step:
                break
            if "Clear:is_recursive" in values:
                now = {}
            else:
                now |= values
        return {name: value for name, value in now.items() if value}

    def frames(self, step: int) -> dict[str, tuple[str, Pose]]:
        """Parent and pose of each frame at a step."""
        frames = {}
        for entity in self.rows:
            now = self.at(entity, step)
            if "Transform3D:child_frame" in now:
                pose = (tuple(now["Transform3D:translation"][0]), tuple(now["Transform3D:quaternion"][0]))
                frames[now["Transform3D:child_frame"][0]] = (now["Transform3D:parent_frame"][0], pose)
        return frames


def in_world(frames: dict[str, tuple[str, Pose]], name: str, root: str = "world") -> Pose:
    """The pose of a frame in the root."""
    pose = geometry.IDENTITY
    while name != root:
        name, up = frames[name]
        pose = geometry.multiply(up, pose)
    return pose


def looked_for(file: Path) -> set[str]:
    """What the views of any of a file's layouts ask for: paths of entities, and patterns of paths."""
    reader = RrdReader(file)
    tables = [
        chunk.to_record_batch()
        for layout in reader.blueprints()
        for chunk in reader.stream(store=layout)
        if chunk.entity_path.endswith("/ViewContents")
    ]
    queries = [row for table in tables for row in table.column("ViewContents:query").to_pylist()]
    return {path for row in queries for path in row}


def in_front(file: Path) -> set[str]:
    """Names of the views that any of a file's layouts puts in front of others."""
    reader = RrdReader(file)
    names, fronts = {}, set()
    for layout in reader.blueprints():
        for chunk in reader.stream(store=layout):
            table = chunk.to_record_batch()
            properties = {
                name: table.column(name).to_pylist()[-1] for name in table.schema.names if "Blueprint:" in name
            }
            if "ViewBlueprint:display_name" in properties:
                names[chunk.entity_path] = properties["ViewBlueprint:display_name"][0]
            fronts |= {f"/{view}" for view in properties.get("ContainerBlueprint:active_tab") or ()}
    return {names[front] for front in fronts}


def view(log: Path, file: Path) -> Shown:
    """What is shown of a recording."""
    assert main(["view", str(log), "--save", str(file)]) == 0
    return Shown(file)


def small(file: Path, x: float = 0.0) -> Path:
    """Records a world with a cup in it."""
    with recorder.record(file, overwrite=True), BulletWorld(name="w"):
        Object("cup", "cup", "cup.stl", [x, 0, 1])
    return file
