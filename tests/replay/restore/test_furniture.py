"""Furniture in recordings: a world that is restored has the surfaces and containers that the plan had."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder.records import Mutation

RESOURCES = Path(__file__).parents[3] / "resources"
CORRECTIONS = '[surfaces.table]\nname = "desk"\nsize = [0.5, 0.5]\n'


@pytest.mark.parametrize("exact", [False, True])
def test_a_restored_world_has_the_corrections_that_lay_beside_the_urdf(tmp_path: Path, exact: bool) -> None:
    urdf = tmp_path / "table.urdf"
    shutil.copy(RESOURCES / urdf.name, urdf)
    (tmp_path / "table.furniture.toml").write_text(CORRECTIONS)
    with recorder.record(tmp_path / "run.mcap"), BulletWorld() as world:
        live = Object("table", "environment", urdf, [1, 0, 0], world=world)
        expected, pose = dict(live.surfaces), live.surface_pose("desk")
    for file in (urdf, tmp_path / "table.furniture.toml"):
        file.unlink()
    with replay.open(tmp_path / "run.mcap") as log:
        loaded = max(record.seq for record in log.records(Mutation) if record.HasField("load_body"))
        world = log.world_at(loaded, exact=exact)
    with world:
        table = world.get_object("table")
        assert dict(table.surfaces) == expected
        assert table.surface_pose("desk") == pose
