"""What a failed action tried, as `why` and `tree` tell it: each choice with its failure, and of how many places."""

from __future__ import annotations

import contextlib
import zlib
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram.actions import ActionFailed, Try, perform
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import ActionDesignator, LocationDesignator
from pycram.failures import GraspFailed
from recorder.records import Argument, Candidate, Grid, Query, Spot, to_json
from recorder.tracing import journal
from recorder.tracing.span import Span
from replay.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def handling(action: str) -> Span:
    return Span("failure-handling", "failure-handling", parameters={"action": action, "budget": 2})


def attempt(number: int, arm: str, failure: Exception | None = None) -> Exception | None:
    with contextlib.suppress(GraspFailed), Span("attempt", f"attempt {number}", parameters={"arm": arm}):
        if failure is not None:
            raise failure
    return failure


def consider_places(task: Span) -> None:
    pairs = [Argument(name="pairs", json=to_json([{"body": "kitchen"}]))]
    spots = [Spot(position=[0, 0, 0], candidate=0)] * 3
    grid = Grid(origin=[0, 0, 0], resolution=1.0, width=1, height=1, scores=zlib.compress(b"\0"), spots=spots)
    candidates = [Candidate(names=["a"], count=3, reason="Touching", data=pairs)]
    journal.publish(Query(name="standing_places", task=task.id, world="w", candidates=candidates, grid=grid))


def plan() -> None:
    with Span("action", "parking-arms"), handling("parking-arms"):
        attempt(1, "both")
    with Span("action", "fetching", parameters={"object": "milk"}) as action:
        consider_places(action)
        with handling("fetching"):
            tries = []
            for number, arm in enumerate(("left", "right"), 1):
                failure = attempt(number, arm, GraspFailed(arm, "milk", f"too far for the {arm} one"))
                assert failure is not None
                tries.append(Try({"arm": arm}, failure))
            raise ActionFailed("fetching", tries, spent=True)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "log.mcap"
    with pytest.raises(ActionFailed), recorder.record(file):
        plan()
    return file


def test_why_lists_each_choice_with_its_failure(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(log)]) == 0
    _, _, text = capsys.readouterr().out.partition("Attempts of fetching(object=milk) action\n")
    lines = [line.strip() for line in text.partition("\n\n")[0].splitlines()]
    assert [line.partition(": ")[2] for line in lines if line.startswith("step")] == [
        "arm=left",
        "arm=right",
        "standing_places",
    ]
    assert "GraspFailed: left gripper can't grasp milk: too far for the left one" in lines
    assert "GraspFailed: right gripper can't grasp milk: too far for the right one" in lines
    assert "of 3 places 3 collide with kitchen, none was taken" in lines
    assert lines[-1] == "the budget of attempts was spent"


def test_tree_shows_actions_with_their_attempts(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tree", str(log)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any('fetching(object="milk") action' in line for line in lines)
    parking = next(number for number, line in enumerate(lines) if "parking-arms" in line)
    assert 'attempt 1(arm="both")' in lines[parking + 1], "what counts the attempts isn't shown where nothing failed"
    assert sum("failure-handling" in line for line in lines) == 1
    assert main(["tree", str(log), "--all"]) == 0
    assert capsys.readouterr().out.count("failure-handling") == 2


@pytest.fixture
def table() -> Iterator[BulletWorld]:
    """A Panda on a table, with milk in reach, and another table that is not."""
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("table", "environment", "table.urdf")
        Object("far table", "environment", "table.urdf", [4, 0, 0])
        world.robot = robot = Object("panda", "robot", "panda.urdf", [0, 0, 0.72])
        assert robot.description is not None
        robot.set_joint_positions(next(iter(robot.description.arms.values())).posture("park"))
        Object("milk", "milk", "milk.stl", [0.62, -0.25, 0.83])
        yield world


@pytest.mark.slow
def test_why_tells_which_choice_a_transport_could_not_make(
    table: BulletWorld, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, milk = tmp_path / "log.mcap", table.get_object("milk")
    target = LocationDesignator(on=table.get_object("far table"))
    with pytest.raises(ActionFailed), recorder.record(file):
        perform(ActionDesignator(type="transporting", object=milk, target=target))
    assert milk.carrier is table.robot, "taking it is what succeeded"
    assert main(["why", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "The cause: delivering(" in printed, "the part of it that failed"
    _, _, text = printed.partition("Attempts of transporting(")
    lines = [line.strip() for line in text.partition("\n\n")[0].splitlines()]
    assert any(line.startswith("NoPlace: no place for milk on table: ") and "by reach" in line for line in lines)
    taking = next(number for number, line in enumerate(lines) if ": standing_places(" in line)
    putting = max(number for number, line in enumerate(lines) if ": free_places(" in line)  # once more, for that arm
    assert lines[taking + 1] == "of 1 place 1 was taken"
    assert lines[putting + 1] == "its map had no places left"
    assert lines[-1] == "there were no further choices"
