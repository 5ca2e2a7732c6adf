"""A world's name that is taken again is another world: nothing mixes the two up."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder import mcap_sink
from recorder.mcap_sink import McapSink
from recorder.records import Mutation
from replay.cli.main import main
from replay.compare import difference
from replay.errors import NoSuchName
from replay.file.lifetimes import title
from replay.history.tasks import summary

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def old_register(sink: McapSink, topic: str, world: str = "", lifetime: int = 0) -> int:
    """As recorders did before channels said which world of a name they are for."""
    metadata = {"world": world} if world else {}
    channel = sink._writer.add_channel(topic, "protobuf", sink._schemas[topic], metadata)
    sink._channels[topic, world, lifetime] = channel
    return channel


def tell_apart(monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    if how == "shared channels":
        monkeypatch.setattr(mcap_sink, "_MAX_CHANNELS", 0)
    elif how == "old channels":
        monkeypatch.setattr(McapSink, "_register", old_register)
        monkeypatch.setattr(McapSink, "_lifetime", lambda *_: 0)


@pytest.fixture(scope="module", params=["own channels", "shared channels", "old channels"])
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """lab (2 s), then hall (still open), then another lab (0.5 s); 120 changes in each lab, past keyframes."""
    path = tmp_path_factory.mktemp("lives") / "x.mcap"
    with pytest.MonkeyPatch.context() as patch:
        tell_apart(patch, request.param)
        with recorder.record(path):
            lab(height=9, seconds=2, ends=True)
            hall = BulletWorld(name="hall")
            Object("ball", "ball", "apple.stl", [5, 5, 1])
            again = lab(height=5, seconds=0.5, ends=False)
    again.exit()
    hall.exit()
    return path


@pytest.fixture
def log(file: Path) -> Iterator[replay.Recording]:
    with replay.open(file) as log:
        yield log


def lab(*, height: float, seconds: float, ends: bool) -> BulletWorld:
    world = BulletWorld(name="lab")
    world.set_gravity([0, 0, -9.8])
    ball = Object("ball", "ball", "apple.stl", [0, 0, height])
    for turn in range(120):
        ball.set_position([0, 0, height + turn / 1000])
    for _ in range(2):
        world.simulate(seconds / 2)
    if ends:
        world.exit()
    return world


def openings(log: replay.Recording) -> list[int]:
    return [record.seq for record in log.records(Mutation) if record.HasField("open_world")]


def test_lifetimes_are_in_the_order_of_their_opening(log: replay.Recording) -> None:
    first, _, second = openings(log)
    assert [(lifetime.world, lifetime.number) for lifetime in log.lifetimes] == [("lab", 1), ("hall", 1), ("lab", 2)]
    early, _, late = log.lifetimes
    assert not late.has(second - 1)
    assert late.has(second)
    assert early.has(first)
    assert early.has(second - 1)
    assert not early.has(second)


def test_a_world_s_name_means_its_latest_lifetime(log: replay.Recording) -> None:
    """Also where its name is older than another world's."""
    state = log.state_at("last")
    assert [(world.name, world.lifetime) for world in state.worlds.values()] == [("hall", 1), ("lab", 2)]
    assert (state.world().name, state.world().lifetime) == ("lab", 2)
    assert state.body("ball").position[:2] == (0, 0)
    with log.world_at("last") as world:
        assert world.name.startswith("lab@")


@pytest.mark.parametrize(
    ("time", "lifetime", "sim_step"), [("0s", 1, 0), ("0.5s", 1, 120), ("1s", 1, 240), ("2s", 1, 480)]
)
def test_a_simulated_time_is_looked_up_in_the_first_world_that_reaches_it(
    log: replay.Recording, time: str, lifetime: int, sim_step: int
) -> None:
    world = log.state_at(time).world("lab")
    assert (world.lifetime, world.sim_step, world.open) == (lifetime, sim_step, True)


def test_a_simulated_time_that_no_world_reached_is_no_step(log: replay.Recording) -> None:
    with pytest.raises(replay.NoSuchStep, match=r"the clock of lab ends at 2\.000s"):
        log.step("2.1s")


def test_the_summary_has_the_clock_of_each_lifetime(log: replay.Recording, capsys: pytest.CaptureFixture[str]) -> None:
    assert [(each.world, each.lifetime, each.seconds) for each in summary(log).worlds] == [
        ("lab", 1, 2.0),
        ("hall", 1, 0.0),
        ("lab", 2, 0.5),
    ]
    assert main(["info", str(log.path)]) == 0
    assert "lab (2nd of that name): 0.500 s simulated" in capsys.readouterr().out


def test_a_difference_compares_equal_lifetimes_only(log: replay.Recording) -> None:
    first, hall, _ = openings(log)
    delta = difference(log.state_at(hall - 2), log.state_at("last"))
    assert delta.closed == ("lab",)
    assert delta.opened == ("hall", "lab (2nd of that name)")
    assert not delta.changed
    assert difference(log.state_at(first + 2), log.state_at(hall - 2)).changed


def test_a_printed_state_names_the_lifetime(log: replay.Recording, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["state", str(log.path), "last"]) == 0
    assert "lab (2nd of that name): 0.500 s simulated" in capsys.readouterr().out
    assert main(["state", str(log.path), "last", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["worlds"]["lab"]["life"] == 2


def test_a_log_line_names_the_lifetime(log: replay.Recording, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", str(log.path), "--text", "load body ball"]) == 0
    worlds = [line.split(" mutation ")[1].split(": ")[0] for line in capsys.readouterr().out.splitlines()]
    assert worlds == ["lab", "hall", "lab (2nd of that name)"]


def test_a_later_lifetime_is_executed_again_by_itself(log: replay.Recording) -> None:
    recorded = log.state_at("last").world("lab")
    with log.world_at("last", "lab", exact=True) as world:
        assert world.sim_step == 120
        assert tuple(world.get_object("ball").get_position()) == recorded.body("ball").position


def test_ordinals() -> None:
    titles = [title("lab", number) for number in (1, 2, 3, 4, 11, 21, 112)]
    assert titles[0] == "lab"
    assert [text.split("(")[1].split()[0] for text in titles[1:]] == ["2nd", "3rd", "4th", "11th", "21st", "112th"]


def test_after_the_last_world_has_ended_it_is_as_it_was_before(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"):
        with BulletWorld(name="hall"), BulletWorld(name="lab"):
            Object("ball", "ball", "apple.stl", [1, 2, 3])
        with BulletWorld(name="kitchen"):
            cup = Object("cup", "cup", "cup.stl")
            cup.set_position([4, 5, 6])
    with replay.open(tmp_path / "x.mcap") as log:
        end = log.state_at("last")
        assert not any(world.open for world in end.worlds.values())
        assert (end.world().name, end.world().open, list(end.world().bodies)) == ("kitchen", True, ["cup"])
        assert end.body("cup").position == end.world().body("cup").position == (4, 5, 6)
        assert end.body("ball", "lab").position == (1, 2, 3)
        with pytest.raises(NoSuchName, match="no object 'cub'; did you mean cup"):
            end.body("cub")
        with pytest.raises(NoSuchName, match="no open world"):
            log.state_at(0).world()
