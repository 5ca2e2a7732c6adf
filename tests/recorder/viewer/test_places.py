"""Considered places in the viewer: a coloured map on the floor, and the result of each sample."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import numpy as np
import pytest

from recorder.records import Argument, Candidate, Grid, Query, Spot, Task, to_json
from recorder.records.text import text_of
from recorder.viewer.rerun_stream import BLUE, GREEN, GREY, RED
from replay.cli.main import main
from tests.recorder.viewer.shown import Shown
from tests.recorder.viewer.test_conversion import write

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.records import Record

ENTITY = "/w/places/standing_places"


def asked(**changes: object) -> Query:
    """A query that considered six places of a map of 3 x 2 cells, and took the fourth."""
    touching = [Argument(name="pairs", json=to_json([{"body": "kitchen", "body_link": "sink"}]))]
    candidates = [
        Candidate(names=["a"], count=2, reason="Touching", data=touching),
        Candidate(names=["c"], count=1, reason="OutOfReach", data=[Argument(name="distance", json="0.2")]),
        Candidate(names=["d"], count=1),
    ]
    spots = [
        Spot(position=[x, 1.0, 0.0], yaw=0.5, score=1.0, candidate=candidate)
        for x, candidate in ((0.1, 0), (0.2, 0), (0.3, 1), (0.4, 2), (0.5, -1), (0.6, -1))
    ]
    scores = bytes([0, 255, 51, 0, 0, 102])
    grid = Grid(origin=[-1, 2, 0.5], resolution=0.5, width=3, height=2, scores=zlib.compress(scores), spots=spots)
    for name, value in changes.items():
        if name == "spot":
            grid.spots[0].CopyFrom(value)
        elif name == "origin":
            grid.origin[:] = value
        else:
            setattr(grid, name, value)
    return Query(world="w", name="standing_places", answer_json="1", candidates=candidates, chosen=2, grid=grid)


def shown(folder: Path, *records: Record) -> Shown:
    log = write(folder / "log.mcap", *records)
    assert main(["view", str(log), "--save", str(folder / "log.rrd")]) == 0
    return Shown(folder / "log.rrd")


def test_the_map_lies_where_the_places_are(tmp_path: Path) -> None:
    now = shown(tmp_path, asked()).at(f"{ENTITY}/map", 0)
    corners = np.array(now["Mesh3D:vertex_positions"]).reshape(-1, 4, 3)
    assert corners.min(axis=1)[:, :2] == pytest.approx(np.array([(-0.5, 2.0), (0.0, 2.0), (0.0, 2.5)]))
    assert corners.max(axis=1)[:, :2] == pytest.approx(np.array([(0.0, 2.5), (0.5, 2.5), (0.5, 3.0)]))
    assert corners[..., 2] == pytest.approx(0.505)
    colors = [value >> 8 for value in now["Mesh3D:vertex_colors"][::4]]
    best, worst, middle = ([(color >> shift) & 255 for shift in (16, 8, 0)] for color in colors)
    assert best == list(GREEN)
    assert abs(worst[2] - BLUE[2]) < abs(middle[2] - BLUE[2])


def test_each_sample_has_its_fate(tmp_path: Path) -> None:
    file = shown(tmp_path, asked())
    now = file.at(f"{ENTITY}/samples", 0)
    assert now["Points3D:labels"] == [
        "collides with kitchen",
        "collides with kitchen",
        "is out of reach",
        "taken",
        "not tried",
        "not tried",
    ]
    rgb = [(color >> 24, color >> 16 & 255, color >> 8 & 255) for color in now["Points3D:colors"]]
    assert rgb == [RED, RED, RED, GREEN, GREY, GREY]
    taken = file.at(f"{ENTITY}/taken", 0)
    assert taken["Arrows3D:origins"][0][:2] == pytest.approx([0.4, 1.0])
    assert taken["Arrows3D:labels"] == [
        "of 6 places 2 collide with kitchen, 1 is out of reach, 1 was taken, 2 were not tried"
    ]


def test_it_stays_until_a_motion_begins(tmp_path: Path) -> None:
    tasks = [
        Task(world="w", task=number, kind=kind, name="x", phase=Task.STARTED, status=Task.RUNNING)
        for number, kind in ((1, "attempt"), (2, "motion"))
    ]
    file = shown(tmp_path, asked(), *tasks)
    assert file.at(f"{ENTITY}/map", 1)
    assert not file.at(f"{ENTITY}/map", 2)


def test_lines_of_the_log_count_the_places() -> None:
    assert text_of(asked())[0].endswith(
        "; of 6 places 2 collide with kitchen, 1 is out of reach, 1 was taken, 2 were not tried"
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 1 << 30, "height": 1 << 30},
        {"width": -3},
        {"width": 4},
        {"scores": zlib.compress(bytes(6))[:-6]},
        {"scores": b"none"},
        {"resolution": float("nan")},
        {"resolution": 0.0},
        {"origin": [0.0, 0.0]},
        {"origin": [0.0, 0.0, float("inf")]},
        {"spot": Spot(position=[0.0, float("nan"), 0.0])},
        {"spot": Spot(position=[0.0])},
        {"spot": Spot(position=[0.0, 0.0, 0.0], yaw=float("inf"))},
    ],
)
def test_an_impossible_map_is_damage(
    changes: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write(tmp_path / "log.mcap", asked(**changes))
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd")]) == 3
    assert "step 0 is damaged: the content is inconsistent: invalid " in capsys.readouterr().err
    assert not (tmp_path / "log.rrd").exists()
