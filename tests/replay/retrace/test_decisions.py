"""A fork forces decisions: candidates, slots, the order of branches, limits, and calls that aren't made."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Query
from replay.cli.main import main
from replay.retrace.decisions import BadChange, parse_decision
from replay.retrace.fork import fork
from replay.retrace.retrace import retrace
from tests.replay.retrace.test_changes import here, printed
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.recording import Recording

PLAN = """\
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.fluent import Fluent
from pycram.language import par, timeout
from pycram.process_module import ProcessModule
world = BulletWorld(name="kitchen")
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("kitchen", "environment", "kitchen.urdf")
robot = world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.9, 0])
milk = Object("milk", "milk", "milk.stl", [1.35, 0.9, 0.98])
other = Object("other", "milk", "milk.stl", [1.35, 0.3, 0.98])
def perform(*slots):
    return ProcessModule.perform(MotionDesignator(slots))
def one(): print("one")
def two(): print("two")
print("here")
print(perform(("type", "world-state-detecting"), ("object-type", "milk")).name)
perform(("type", "pick-up"), ("object", milk), ("arm", "left"))
print(robot.attachments[milk].carrier_link)
par(one, two)
with timeout(20, simulated=True) as limit:
    world.simulate(0.1)
other.remove()
print(other.alive, world.gravity[2])
"""
END = ["one", "two"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    file = tmp_path_factory.mktemp("decisions") / "plan.py"
    file.write_text(PLAN)
    with replay.open(record(file)) as recording:
        assert recording[len(recording) - 1].succeeded
        yield recording


@pytest.mark.costly
@pytest.mark.slow
def test_all_kinds_of_decisions_are_forced(log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "on.mcap"
    others = sorted(END, key=printed(log).index, reverse=True)
    given = (
        *(
            "nearest(...)=#1",
            "pick-up.arm(object=milk, ...)=right",
            "grasp(milk)=top",
            f"order(...)=[{', '.join(others)}]",
        ),
        "remove(other)=skip",
    )
    result = fork(log, here(log), file, answers=given, settings=["gravity=0,0,-1"])
    assert result.succeeded
    assert not result.unused
    with replay.open(file) as other:
        assert printed(log) != printed(other) == ["other", "r_gripper_tool_frame", *others, "True -1.0"]
        forced = [each for each in other.records(Query) if each.by_fork]
        assert [each.name for each in forced] == ["nearest", "grasp"]
        assert forced[1].answer_json == '"top"'
        assert retrace(other).identical  # the fork runs again, with its decisions
    assert main(["log", str(file)]) == 0
    assert "front, top across, left, right: the fork forces another candidate" in capsys.readouterr().out


@pytest.mark.costly
def test_a_decision_that_doesnt_come_ends_with_2_and_keeps_the_fork(log: Recording, tmp_path: Path) -> None:
    file = tmp_path / "on.mcap"
    given = ("--answer", "remove(milk)=skip", "--answer", "timeout(seconds=20)=0.05")
    assert main(["fork", str(log.path), "--at", str(here(log)), "-o", str(file), *given]) == 2
    with replay.open(file) as other:
        assert "TimedOut" in other[-1].failure.type  # the forced limit


@pytest.mark.costly
def test_a_candidate_that_isnt_there_is_named_with_the_others(
    log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for given, said in (
        ("grasp(milk)=bottom", "there is no such candidate; there are front, top, top across, left, right"),
        ("grasp(milk)=#99", "candidates: #1 "),
        ("graps(milk)=top", "did you mean grasp"),
        ("remvoe(milk)=skip", "did you mean remove"),
    ):
        assert (
            main(["fork", str(log.path), "--at", str(here(log)), "-o", str(tmp_path / "on.mcap"), "--answer", given])
            == 2
        )
        assert said in capsys.readouterr().err
        assert not list(tmp_path.iterdir())


def test_names_with_hyphens_are_parsed() -> None:
    parsed = parse_decision("accessing.drawer-joint(part-of=kitchen, ...)='a joint'")
    assert (parsed.name, parsed.slot, list(parsed.keywords), parsed.value) == (
        "accessing",
        "drawer-joint",
        ["part_of"],
        "a joint",
    )
    assert parse_decision("transporting()=#2").number == 2
    for wrong in ("grasp(milk)", "grasp=top", "grasp(milk)=", "grasp(milk)=#0", "timeout(...)=soon", "grasp(milk)=a b"):
        with pytest.raises(BadChange):
            parse_decision(wrong)
