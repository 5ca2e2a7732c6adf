"""If a recording has several worlds, the view of the active world is in front."""

from __future__ import annotations

import itertools
import tempfile
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder.records import Mutation
from recorder.viewer.translator import Translator
from replay.cli.main import main
from tests.recorder.viewer.shown import in_front, small

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.recorder.viewer.conftest import Headless


@pytest.fixture
def two_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plan that tries something in another world, and goes on in its own."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # what isn't kept beside it is this test's alone
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="scratch"), BulletWorld(name="kitchen"):
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1], color=[1, 0, 0, 1])
        cup.set_position([1, 0, 1])
        with BulletWorld(name="try"):
            milk = Object("milk", "milk", "milk.stl", [0, 0, 1], color=[0, 0, 1, 1])
            milk.set_position([0.1, 0, 1])
        cup.set_position([0, 0, 1])
    return log


def moved(log: replay.Recording, body: str) -> int:
    """The first step at which a body was moved."""
    return next(record.seq for record in log.records(Mutation) if record.move_body.body == body)


@pytest.mark.slow
def test_the_first_tab_is_the_world_that_is_looked_at(tmp_path: Path, two_worlds: Path) -> None:
    with replay.open(two_worlds) as log:
        steps = {"kitchen": moved(log, "cup"), "try": moved(log, "milk")}
    file = tmp_path / "log.rrd"
    assert main(["view", str(two_worlds), "--save", str(file)]) == 0
    assert in_front(file) == {"kitchen"}, "where the plan began to do something"
    for world, step in steps.items():
        for beside in ([], [str(small(tmp_path / "beside.mcap"))]):
            assert main(["view", str(two_worlds), *beside, "--at", str(step), "--save", str(file)]) == 0
            assert in_front(file) == {world if not beside else f"log {world}", *(["beside w"] if beside else [])}
    assert main(["view", str(two_worlds), "--at", "0", "--save", str(file)]) == 0
    assert in_front(file) == {"kitchen"}, "a step before all worlds"


@pytest.mark.slow
def test_a_cached_file_opens_with_the_recording_s_first_world(two_worlds: Path) -> None:
    from replay.view import cached  # noqa: PLC0415

    with replay.open(two_worlds) as log:
        for step, world in [(moved(log, "milk"), "try"), (None, "kitchen"), (moved(log, "cup"), "kitchen")]:
            file = cached(log, step)
            assert in_front(file) == {world}
            assert (file == two_worlds.with_name("log.mcap.rrd")) == (world == "kitchen")


def test_live_the_first_tab_is_the_world_that_the_plan_acts_in(two_worlds: Path) -> None:
    with BulletWorld(name="later"), recorder.record(two_worlds.with_name("later.mcap")):
        Object("cup", "cup", "cup.stl", [0, 0, 1]).set_position([1, 0, 1])
    translator = Translator(rr.RecordingStream("test"))
    fronts = []
    for file in (two_worlds, two_worlds.with_name("later.mcap")):
        with replay.open(file) as log:
            for record in log:
                translator.show(record)
                fronts.append(translator.worlds.front)
    assert [world for world, _ in itertools.groupby(fronts)] == ["", "kitchen", "later"]


@pytest.mark.slow
def test_the_viewer_opens_with_the_world_of_the_step(
    tmp_path: Path, two_worlds: Path, headless: Headless, until: Callable[..., None]
) -> None:
    with replay.open(two_worlds) as log:
        step = moved(log, "milk")
    assert main(["view", str(two_worlds), "--at", str(step), "--connect", headless.url]) == 0
    until(headless.has_loaded, "it is loaded")

    def blue() -> bool:
        red, _, blue = np.asarray(headless.picture(tmp_path / "seen.png", "try"), dtype=int).transpose(2, 0, 1)
        assert not (red > blue + 60).any(), "the other world's"
        return bool((blue > red + 60).any())

    until(blue, "the milk is seen")
