"""What queries had answered: whether it still held when the plan failed, and in which world."""

from __future__ import annotations

import io
import shlex
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.world.world import open_worlds
from recorder.tracing.span import span
from replay.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.recording import Recording


def take_what_is_gone(file: Path) -> None:
    with recorder.record(file), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        btr.stable(ball)
        ball.set_position([1, 0, 1])
        with span("motion", "take", {"object": ball}):
            raise PlanFailure("it isn't there")


def test_an_outdated_answer_is_marked(tmp_path: Path) -> None:
    with pytest.raises(PlanFailure):
        take_what_is_gone(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        (asked,) = why.queries
        assert asked.query.answer_json == "false"
        assert asked.moved == ("ball",)
        assert why.warning is None
        assert main(["why", str(log.path)]) == 0


def take_one_of_two(file: Path) -> None:
    with recorder.record(file), BulletWorld():
        Object("floor", "environment", "plane.urdf")
        ball, cup = (Object(each, each, "apple.stl", [x, 0, 1]) for x, each in enumerate(("ball", "cup")))
        btr.supporting(cup, ball)
        with span("motion", "take", {"object": ball}):
            raise PlanFailure("it can't be taken")


def test_an_answer_about_another_object_is_no_warning(tmp_path: Path) -> None:
    with pytest.raises(PlanFailure):
        take_one_of_two(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        assert [relevant.query.answer_json for relevant in why.queries] == ["false"]
        assert why.warning is None


def take_after(file: Path, change: str) -> None:
    """A ball is asked about; then something becomes of it, or of its world; then it can't be taken."""
    with recorder.record(file):
        lab = BulletWorld(name="lab")
        Object("floor", "environment", "plane.urdf")
        ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        lab.set_gravity([0, 0, -9.8])
        btr.stable(ball)
        if change == "removed":
            ball.remove()
        elif change == "another lab":
            lab.exit()
            BulletWorld(name="lab")
            ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        elif change == "another world":
            BulletWorld(name="hall")
            Object("ball", "ball", "apple.stl", [7, 7, 7])
        with span("motion", "take", {"object": ball}):
            raise PlanFailure("it can't be taken")


@pytest.fixture
def taken(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Recording]:
    with pytest.raises(PlanFailure):
        take_after(tmp_path / "x.mcap", request.param)
    while open_worlds():
        open_worlds()[-1].exit()
    with replay.open(tmp_path / "x.mcap") as log:
        yield log


@pytest.mark.parametrize("taken", ["nothing"], indirect=True)
def test_an_answer_that_holds_is_a_warning(taken: Recording) -> None:
    why = taken.why()
    assert why.warning is not None
    assert why.warning.name == "stable"


@pytest.mark.parametrize("taken", ["removed"], indirect=True)
def test_a_removed_body_is_not_listed_as_moved(taken: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    why = taken.why()
    assert (why.queries[0].removed, why.queries[0].moved, why.removed) == (("ball",), (), ("ball",))
    assert why.warning is None
    assert main(["why", str(taken.path)]) == 0
    output = capsys.readouterr().out
    assert "later ball was removed" in output
    assert "ball had been removed" in output


@pytest.mark.parametrize("taken", ["another lab"], indirect=True)
def test_a_query_about_an_earlier_world_of_the_same_name_is_no_warning(
    taken: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    why = taken.why()
    assert [asked.world for asked in why.queries] == ["lab"]
    assert why.world.title == "lab (2nd of that name)"
    assert why.warning is None
    assert main(["why", str(taken.path)]) == 0
    assert "asked in another world: lab" in capsys.readouterr().out


@pytest.mark.parametrize("taken", ["another world"], indirect=True)
@pytest.mark.slow
def test_suggested_commands_name_the_world_if_it_is_not_the_default(
    taken: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["why", str(taken.path)]) == 0
    output = capsys.readouterr().out.partition("Look closer\n")[2]
    commands = [shlex.split(line)[1:] for line in output.splitlines()]
    commands = [command for command in commands if command[0] not in ("why", "fix")]  # about the run, not about a step
    assert {command[0] for command in commands} == {"show", "state", "blame", "ask", "render", "restore"}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO("print(world.name, objects['ball'].get_position())"))
    for command in commands:
        assert command[0] == "show" or command[-2:] == ["--world", "lab"]
        assert main(command) == 0
    output = capsys.readouterr().out
    assert "[7" not in output
    assert "stable(ball): no" in output
    assert "lab@" in output


@pytest.mark.parametrize("taken", ["another world"], indirect=True)
def test_blame_takes_the_world_opened_last_and_names_others(
    taken: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (taken.blame("ball").world, taken.blame("ball").other_worlds) == ("hall", ("lab",))
    assert taken.blame("ball", world="lab").world == "lab"
    assert taken.blame("floor").world == "lab"
    assert taken.state_at("failure").body("ball").position == (7, 7, 7)
    assert main(["blame", str(taken.path), "ball"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("ball in hall has been at [7, 7, 7]")
    assert "ball is in lab, too" in output


@pytest.mark.parametrize("taken", ["another world"], indirect=True)
@pytest.mark.parametrize(
    "verb", ["ask last stable(floor)", "state last floor --world hall", "blame floor --world hall"]
)
def test_the_error_names_another_world_that_has_the_object(
    taken: Recording, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name, *rest = verb.split()
    assert main([name, str(taken.path), *rest]) == 2
    assert (
        "there is no object 'floor'; it is in lab, not in hall; choose a world with --world" in capsys.readouterr().err
    )
