"""Trajectories as tables: what was planned, and what was driven."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from pyarrow import parquet

import recorder
from pycram.bullet_world import BulletWorld, Object
from replay.cli.main import main
from tests.smooth_motions import move, smooth

if TYPE_CHECKING:
    from collections.abc import Mapping

CABINET = Path(__file__).parents[1] / "golden" / "cabinet.urdf"
DRAWER = "drawer_joint"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drawer opens in 0.5 s; then the cabinet, a robot here, drives for 1 s and is stopped after 0.5 s."""
    file = tmp_path_factory.mktemp("export") / "run.mcap"
    with recorder.record(file), BulletWorld(name="lab") as world:
        cabinet = Object("cabinet", "robot", CABINET, [1, 0, 1], [0, 0, 0.6, 0.8])
        world.simulate(0.1)
        move(cabinet, {DRAWER: 0.2}, 0.5)
        yaw = 1.2870022175866
        number = world.begin_trajectory(cabinet, smooth((), [1, 0, yaw], [2, 0, yaw], 1.0))
        world.simulate(0.5)
        world.stop_trajectory(number)
        world.simulate(0.5)
    return file


def table(log: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, str]]:
    assert main(["export", str(log), "--trajectories"]) == 0
    return list(csv.DictReader(io.StringIO(capsys.readouterr().out)))


def of(rows: list[dict[str, str]], **wanted: str) -> list[Mapping[str, float]]:
    """Those rows, their numbers as numbers."""
    chosen = [row for row in rows if all(row[name] == value for name, value in wanted.items())]
    numbers = ("time", "seconds", "position", "velocity")
    return [{name: float(row[name] or "nan") for name in numbers} for row in chosen]


def test_what_was_planned_and_what_was_driven(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = table(log, capsys)
    planned = of(rows, trajectory="1", joint=DRAWER, source="planned")
    driven = of(rows, trajectory="1", joint=DRAWER, source="driven")
    assert [row["time"] for row in planned][:: len(planned) - 1] == [0, 0.5]
    assert planned[0]["seconds"] == 0.1
    assert [row["position"] for row in planned][:: len(planned) - 1] == [0, pytest.approx(0.2)]
    assert [row["seconds"] for row in driven] == pytest.approx([0.1 + n / 30 for n in range(1, 16)])
    for row in driven:
        share = row["time"] / 0.5
        assert row["position"] == pytest.approx(0.2 * share**3 * (10 - 15 * share + 6 * share**2), abs=2e-3)
    middle = driven[len(driven) // 2]
    assert middle["velocity"] == pytest.approx(0.75, abs=0.03)


def test_a_base_that_was_stopped(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = table(log, capsys)
    driven = of(rows, trajectory="2", joint="x", source="driven")
    assert max(row["time"] for row in driven) == 0.575
    assert driven[-1]["time"] == 0.575
    assert 1.5 < driven[-1]["position"] < 1.7
    yaws = {round(row["position"], 6) for row in of(rows, trajectory="2", joint="yaw")}
    assert yaws == {1.287002}
    assert {row["velocity"] for row in rows if row["joint"] == "x" and row["source"] == "driven"} == {""}


def test_parquet_and_json_have_the_same(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = table(log, capsys)
    file = tmp_path / "trajectories.parquet"
    assert main(["export", str(log), "--trajectories", "-o", str(file)]) == 0
    assert capsys.readouterr().out == f"{file}: {len(rows)} rows\n"
    stored = parquet.read_table(file).to_pylist()
    assert [repr(row["position"]) for row in stored] == [row["position"] for row in rows]
    assert main(["export", str(log), "--trajectories", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == stored


@pytest.mark.parametrize(
    ("arguments", "text"),
    [(["--format", "parquet"], "-o FILE.parquet"), (["-o", "/nowhere/x.csv"], "/nowhere/x.csv: can't be written")],
)
def test_where_no_table_can_be_written(
    log: Path, arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(log), "--trajectories", *arguments]) == 2
    assert text in capsys.readouterr().err


def test_a_recording_without_motions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "still.mcap"), BulletWorld():
        pass
    assert main(["export", str(tmp_path / "still.mcap"), "--trajectories"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "world,trajectory,body,joint,source,time,seconds,position,velocity\n"
    assert "nothing followed a trajectory" in printed.err


def test_the_state_tells_what_is_followed(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["state", str(log), "0.85s", "cabinet"]) == 0
    assert "follows trajectory 2 at 0.2" in capsys.readouterr().out
