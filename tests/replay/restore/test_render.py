"""Pictures of any step, without a viewer."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.world.world import open_worlds
from recorder.records import Query
from replay.cli.main import main
from tests.conftest import furnish

if TYPE_CHECKING:
    from pathlib import Path

SMALL = (80, 60)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A red bowl appears at step 2, moves aside at step 3."""
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld():
        bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 0], color=[1, 0, 0, 1])
        bowl.set_position([0, 5, 0])
    return path


def red(picture: Image.Image) -> np.ndarray:
    pixels = np.asarray(picture).astype(int)
    reddish: np.ndarray = (pixels[..., 0] > 80) & (pixels[..., 1] < 60) & (pixels[..., 2] < 60)
    return reddish


def test_a_picture_shows_the_step_from_the_viewpoint(file: Path) -> None:
    with replay.open(file) as log:
        there = red(log.render(2, eye=(-1, 0, 0.3), target=(0, 0, 0), size=SMALL))
        assert there.mean() > 0.005
        rows, columns = np.nonzero(there)
        assert rows.mean() == pytest.approx(30, abs=3)  # in the middle of the picture
        assert columns.mean() == pytest.approx(40, abs=3)
        assert red(log.render(3, eye=(-1, 0, 0.3), target=(0, 0, 0), size=SMALL)).mean() == 0
        left = red(log.render(2, eye=(-1, 0, 0.3), target=(0, -0.2, 0), size=SMALL))
        assert np.nonzero(left)[1].mean() < 30
        wide = log.render(2, size=(100, 50))
    assert wide.size == (100, 50)
    assert red(wide).any()  # by default it looks at what there is
    assert not open_worlds()


def test_a_film_shows_each_moment_as_a_picture_of_its_own_does(tmp_path: Path) -> None:
    path = tmp_path / "moves.mcap"
    with recorder.record(path), BulletWorld():
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0], color=[1, 0, 0, 1])  # it stands
        milk = Object("milk", "milk", "milk.stl", [0.1, 0.3, 0.1])  # it moves behind the bowl, and in front of it
        for position in ([0.1, 0, 0.05], [-0.15, 0, 0.05]):
            milk.set_position(position)
        Object("cup", "cup", "cup.stl", [0, -0.2, 0])  # it comes later
    with replay.open(path) as log:
        steps = range(3, 7)
        seen = {"eye": (-1, 0.1, 0.6), "target": (0, 0, 0), "size": (160, 120)}
        film = [np.asarray(picture).astype(int) for picture in log.film(steps, **seen)]
        alone = [np.asarray(log.render(step, **seen)).astype(int) for step in steps]
        chosen = [*log.film(steps, size=SMALL)]
    for moment, own in zip(film, alone, strict=True):
        assert (np.abs(moment - own).max(axis=2) > 2).mean() < 0.001
    changed = [(np.abs(one - other).max(axis=2) > 20).mean() for one, other in itertools.pairwise(film)]
    assert min(changed) > 0.003
    assert all(red(picture).any() for picture in chosen)  # its own viewpoint shows the scene at each moment


@pytest.mark.parametrize("walls", [0, 1, 2])
def test_a_picture_is_not_taken_from_behind_a_wall(tmp_path: Path, walls: int) -> None:
    wall = tmp_path / "wall.urdf"
    shape = '<geometry><box size="0.02 6 6"/></geometry>'
    wall.write_text(f'<robot name="wall"><link name="wall"><visual>{shape}</visual></link></robot>')
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld():
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0], color=[1, 0, 0, 1])
        for number in range(walls):  # before the robot's back; then also beside its right
            turn = [0, 0, number * 2**-0.5, 1 - number * (1 - 2**-0.5)]
            Object(f"wall_{number}", "environment", str(wall), [[-0.3, 0, 0], [0, -0.3, 0]][number], turn)
    with replay.open(path) as log:
        assert red(log.render(2 + walls, size=SMALL)).any()


def slab(folder: Path, name: str, size: str) -> str:
    shape = f'<geometry><box size="{size}"/></geometry>'
    file = folder / f"{name}.urdf"
    file.write_text(f'<robot name="{name}"><link name="{name}"><visual>{shape}</visual></link></robot>')
    return str(file)


@pytest.fixture
def closed(tmp_path: Path) -> Path:
    """A red bowl in a small cupboard, and a green one beside it, at step 9; then the world is closed."""
    path = tmp_path / "closed.mcap"
    with recorder.record(path), BulletWorld(name="kitchen"):
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0], color=[1, 0, 0, 1])
        for axis, size in enumerate(("0.02 0.3 0.3", "0.3 0.02 0.3", "0.3 0.3 0.02")):
            for side in (-0.15, 0.15):
                position = [side if axis == each else 0.0 for each in range(3)]
                Object(f"side_{axis}_{side}", "environment", slab(tmp_path, f"side_{axis}", size), position)
        Object("other", "bowl", "bowl.stl", [-1, 0, 0], color=[0, 1, 0, 1])
    return path


@pytest.mark.slow
def test_what_hides_a_thing_from_all_sides_is_cut_away(closed: Path) -> None:
    with replay.open(closed) as log:
        inside = log.render(9, target="bowl", size=SMALL)
        assert red(inside).mean() > 0.005
        assert inside.info["cut"]
        assert not log.render(9, target="other", size=SMALL).info["cut"]  # free sight of it
        assert not log.render(9, eye=(1, 1, 1), target="bowl", size=SMALL).info["cut"]  # a viewpoint that was asked for
        both = log.render(9, target=["bowl", "other"], size=(160, 120))
        greenish = np.asarray(both).astype(int)
        assert red(both).any()
        assert ((greenish[..., 1] > 80) & (greenish[..., 0] < 60)).any()


def test_a_picture_from_a_side(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld():
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0], color=[1, 0, 0, 1])
        Object("roof", "environment", slab(tmp_path, "roof", "2 2 0.02"), [0, 0, 0.3])
    with replay.open(path) as log:
        assert log.render(3, eye="above", target="bowl", size=SMALL).info["cut"] == ("roof.roof",)
        for side in ("left", "right", "front", "behind"):
            picture = log.render(3, eye=side, target="bowl", size=SMALL)
            assert red(picture).any()
            assert not picture.info["cut"]


@pytest.mark.slow
def test_after_the_end_of_its_worlds_a_plan_shows_its_last_step(
    closed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "x.png"
    assert main(["render", str(closed), "last", "--to", "bowl", "-o", str(target), "--size", "80x60"]) == 0
    output = capsys.readouterr()
    assert "the picture shows the world after step 9" in output.err
    assert "would hide the scene" in output.err
    assert red(Image.open(target)).any()


@pytest.mark.slow
@pytest.mark.parametrize("target", ["spoon", "cup", "kitchen.sink_area_left_upper_drawer_handle"])
def test_a_thing_is_seen_in_a_drawer_behind_the_robot_and_at_a_wall(tmp_path: Path, target: str) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld() as world:
        furnish(world)
        Object("cup", "cup", "cup.stl", [-0.05, 0.7, 0.06])  # behind the robot
        Object("wall", "environment", slab(tmp_path, "wall", "0.1 4 2.5"), [-0.2, 0.7, 1.25])
        world.get_object("spoon").set_color([1, 0, 0, 1])
        world.get_object("cup").set_color([1, 0, 0, 1])
    with replay.open(path) as log:
        picture = log.render("last", target=target, size=(160, 120))
        if "." not in target:
            assert red(picture).mean() > 0.002


@pytest.mark.slow
def test_the_robots_camera_sees_what_the_plan_looked_at(scene_log: Path) -> None:
    with replay.open(scene_log) as log:
        step = next(record.seq for record in log.records(Query))  # it looks at the milk
        picture = np.asarray(log.render(step, camera="wide_stereo_optical_frame", size=(160, 120))).astype(int)
    middle = picture[45:75, 60:100]
    blue = (middle[..., 2] > middle[..., 0] + 40).any()  # the print on the carton
    assert blue


def test_impossible_pictures_are_refused(file: Path, scene_log: Path) -> None:
    with replay.open(file) as log:
        with pytest.raises(replay.NoSuchName, match="robot"):
            log.render(2, camera="head")
        with pytest.raises(replay.ReplayError, match="no direction"):
            log.render(2, eye=(0, 0, 1), target=(0, 0, 1))
        with pytest.raises(replay.ReplayError, match="3 finite numbers"):
            log.render(2, eye=(0, float("nan"), 1))
        with pytest.raises(replay.ReplayError, match="pixels"):
            log.render(2, size=(0, 10))
        with pytest.raises(replay.NotRestored):
            log.render(0)
        with pytest.raises(replay.NoSuchName, match="did you mean bowl"):
            log.render(2, target="bowll")
        with pytest.raises(replay.NoSuchName, match="left"):
            log.render(2, eye="lefft")
    with replay.open(scene_log) as log, pytest.raises(replay.NoSuchName, match="did you mean wide_stereo"):
        log.render(-3, camera="wide_stereo_optical")


@pytest.mark.slow
def test_render_writes_a_picture(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "x.png"
    asked = ["render", str(file), "2", "-o", str(target), "--from", "-1,0,0.3", "--to", "-.1,0,0", "--size", "80x60"]
    assert main(asked) == 0
    assert capsys.readouterr().out == f"{target}\n"
    assert red(Image.open(target)).any()
    assert main([*asked, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"step": 2, "file": str(target), "width": 80, "height": 60, "cut": []}
    assert main(["render", str(file), "2", "3", "-o", str(tmp_path / "film"), "--size", "80x60"]) == 0
    pictures = [tmp_path / "film" / f"run_{step}.png" for step in (2, 3)]
    assert capsys.readouterr().out.splitlines() == [str(picture) for picture in pictures]
    for picture in pictures:
        with Image.open(picture) as written:
            assert written.size == SMALL
    for wrong in (
        ["--size", "big"],
        ["--from", "1,2"],
        ["--camera", "head", "--to", "0,0,0"],
        ["-o", "/no/such/x.png"],
    ):
        assert main(["render", str(file), "2", "-o", str(target), *wrong]) == 2
        output = capsys.readouterr()
        assert not output.out
        assert output.err.startswith("pycram-replay: ")
