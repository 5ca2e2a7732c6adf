"""``state``: moments within a stretch of simulation, and where links are."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def falling(tmp_path: Path) -> Path:
    """An apple falls from 1 m for half a second."""
    path = tmp_path / "falling.mcap"
    with recorder.record(path), BulletWorld(name="kitchen") as world:
        Object("apple", "apple", "apple.stl", [0, 0, 1])
        world.simulate(0.5)  # nothing moves without gravity
        world.set_gravity([0, 0, -10])
        world.simulate(0.5)
    return path


def test_a_moment_within_a_simulation_is_known_by_its_samples(
    falling: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with replay.open(falling) as log:
        state = log.state_at("0.71s")
        assert state.sampled is not None
        assert state.sampled.at == pytest.approx(0.7)
        assert state.world().seconds == pytest.approx(0.7)
        assert state.body("apple").position[2] == pytest.approx(1 - 5 * 0.2**2, abs=0.01)
        assert state.body("apple").velocity[2] == pytest.approx(-2, abs=0.05)
        assert state.step == log.step("0.71s")
        assert log.state_at(state.step).body("apple").position[2] == 1  # the step itself is before the stretch
        still = log.state_at("0.2s")
        assert still.sampled is not None
        assert still.sampled.at == still.sampled.start == 0
        for whole in ("0.5s", "1s", "last", 3):
            assert log.state_at(whole).sampled is None
    assert main(["state", str(falling), "0.71s", "apple"]) == 0
    assert "sampled at 0.700 s" in capsys.readouterr().out
    assert main(["state", str(falling), "0.71s", "--json"]) == 0
    sampled = json.loads(capsys.readouterr().out)["sampled"]
    assert (sampled["start"], sampled["asked"], sampled["end"]) == (0.5, 0.71, 1.0)
    assert main(["state", str(falling), "0.2s"]) == 0
    assert "as nothing had moved yet" in capsys.readouterr().out


def test_worlds_questions_and_pictures_are_of_the_moment_too(
    falling: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with replay.open(falling) as log:
        sampled = log.state_at("0.71s").body("apple").position
        end = log.state_at("1s").body("apple")
        with log.world_at("0.71s") as world:
            assert world.name == "kitchen@0.71s"
            assert tuple(world.get_object("apple").get_position()) == pytest.approx(sampled, abs=1e-12)
        with log.world_at("0.71s", exact=True) as world:
            apple = world.get_object("apple")
            assert world.sim_step == 170  # of 1/240 s
            assert apple.get_position()[2] < sampled[2]  # two steps later than the sample
            world.simulate_steps(240 - world.sim_step)
            assert tuple(apple.get_position()) == end.position  # to the last bit
        assert [log.ask(step, "stable(apple)").answer for step in ("0.2s", "0.71s")] == [True, False]
        assert log.render("0.71s", eye=(2, 0, 0.8), target=(0, 0, 0.8), size=(60, 60)).tobytes() != (
            log.render("0.51s", eye=(2, 0, 0.8), target=(0, 0, 0.8), size=(60, 60)).tobytes()
        )
    for verb in (["ask", "0.71s", "contact(apple, apple)"], ["render", "0.71s", "-o", str(tmp_path / "x.png")]):
        assert main([verb[0], str(falling), *verb[1:]]) == 0
        assert "sampled at 0.700 s" in capsys.readouterr().err
    script = tmp_path / "script.py"
    script.write_text("print(world.get_object('apple').get_position()[2])")
    assert main(["restore", str(falling), "0.71s", "--exact", "--script", str(script)]) == 0
    output = capsys.readouterr()
    assert float(output.out) < sampled[2]
    assert "simulated again up to that time" in output.err


def test_where_links_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld() as world:
        kitchen = Object("kitchen", "environment", "kitchen.urdf", [0, 1, 0])
        kitchen.set_joint_position("sink_area_left_upper_drawer_main_joint", 0.2)
        there = kitchen.get_link_position("sink_area_left_upper_drawer_handle")
        Object("apple", "apple", "apple.stl", [0, 0, 1], world=world)
    assert main(["state", str(path), "4", "kitchen", "--links", "--json"]) == 0
    ((_, bodies),) = json.loads(capsys.readouterr().out)["links"].items()
    assert set(bodies) == {"kitchen"}
    assert bodies["kitchen"]["sink_area_left_upper_drawer_handle"]["position"] == pytest.approx(there)
    assert main(["state", str(path), "4", "--links"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "sink_area_left_upper_drawer_handle " in line]
    assert f"{there[0]:.4f}" in line


def test_an_object_is_shown_as_it_was_when_its_world_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld() as world:
        Object("apple", "apple", "apple.stl", [0, 0, 1], world=world)
    assert main(["state", str(path), "last", "apple"]) == 0
    output = capsys.readouterr()
    assert "1.0000]" in output.out
    assert "no world is open after step 4; this is the state after step 2" in output.err
