"""Properties are watched while a plan runs: where they are violated, the plan fails, or only the recording says so."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import monitored
from pycram.bullet_world import BulletWorld, Object
from pycram.cli import main
from pycram.failures import BranchesFailed, PropertyViolated
from pycram.language import par, seq
from pycram.scheduling.cancellation import uninterruptible
from recorder.properties import BadProperty
from recorder.records import Check, Mutation
from replay.cli.main import main as replay_main

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def world() -> Iterator[BulletWorld]:
    with BulletWorld() as opened:
        yield opened


@pytest.fixture
def milk(world: BulletWorld) -> Object:
    return Object("milk", "milk", "milk.stl", [0, 0, 0.5], world=world)


@pytest.fixture
def cup(world: BulletWorld) -> Object:
    return Object("cup", "cup", "cup.stl", [3, 0, 0.5], world=world)


def height(body: Object) -> float:
    return body.get_position()[2]


def test_a_violation_is_raised_at_the_next_change(milk: Object) -> None:
    with pytest.raises(PropertyViolated) as raised, monitored("always milk.z < 1"):  # noqa: PT012  where in the block it is raised is the point
        milk.set_position([0, 0, 2])
        milk.set_position([0, 0, 3])
    assert height(milk) == 2.0
    error = raised.value
    assert (error.property, error.margin, error.values) == ("always milk.z < 1", -1.0, {"milk.z": 2.0})
    assert error.step == -1, "nothing is recorded"
    assert "always milk.z < 1: violated (0.000 s): milk.z = 2" in str(error)


def test_it_is_raised_in_the_branch_that_did_it(milk: Object, cup: Object) -> None:
    raised: list[str] = []

    def lift(body: Object) -> None:
        try:
            for z in (0.6, 0.8, 1.2, 1.4):
                body.set_position([*body.get_position()[:2], z if body is milk else 0.7])
        except PropertyViolated:
            raised.append(body.name)
            raise

    with pytest.raises(BranchesFailed), monitored("milk.z < 1"):
        par(lambda: lift(milk), lambda: lift(cup))
    assert raised == ["milk"]
    assert height(milk) == 1.2


def test_what_cannot_be_interrupted_ends_first(milk: Object) -> None:
    with pytest.raises(PropertyViolated) as raised, monitored("milk.z < 1"):  # noqa: PT012  where in the block it is raised is the point
        with uninterruptible():
            milk.set_position([0, 0, 2])
            milk.set_position([0, 0, 3])
        milk.set_position([0, 0, 4])
    assert (height(milk), raised.value.values) == (3.0, {"milk.z": 2.0})


def test_a_branch_without_another_checkpoint_fails_at_its_end(milk: Object) -> None:
    with pytest.raises(BranchesFailed), monitored("milk.z < 1"):  # noqa: PT012  where in the block it is raised is the point
        par(lambda: milk.set_position([0, 0, 2]))
        milk.set_position([0, 0, 9])
    assert height(milk) == 2.0


def test_it_is_raised_once_and_again_only_after_it_held(milk: Object) -> None:
    raised = []
    with monitored("milk.z < 1"):
        for z in (2.0, 2.5, 3.0, 0.5, 2.0, 0.5):
            try:
                milk.set_position([0, 0, z])
            except PropertyViolated as error:
                raised.append(error.values["milk.z"])
                milk.set_position([0, 0, z])
        assert raised == [2.0, 2.0]


def test_the_end_of_the_block_decides_what_had_to_come(milk: Object) -> None:
    with pytest.raises(PropertyViolated, match=r"not until the end") as raised, monitored("eventually milk.z > 1"):
        milk.set_position([0, 0, 0.8])
    assert raised.value.margin == pytest.approx(-0.2)
    with pytest.raises(PropertyViolated, match="at the end"), monitored("at end milk.z > 1"):  # noqa: PT012  where in the block it is raised is the point
        milk.set_position([0, 0, 2])
        milk.set_position([0, 0, 0.8])
    with monitored("eventually milk.z > 1", "at end milk.z < 1"):
        milk.set_position([0, 0, 2])
        milk.set_position([0, 0, 0.8])


def test_actions_of_a_block_run_in_order_within_it(milk: Object) -> None:
    with seq():
        with monitored("at end milk.z > 1"):
            milk.set_position([0, 0, 2])
        milk.set_position([0, 0, 0.1])


def test_contacts_are_watched_within_a_simulation(world: BulletWorld, milk: Object) -> None:
    Object("floor", "environment", "plane.urdf", world=world)
    world.set_gravity([0, 0, -9.81])
    with pytest.raises(PropertyViolated) as raised, monitored("never contact(milk, floor)"):  # noqa: PT012  where in the block it is raised is the point
        world.simulate(1)
        world.simulate(1)
    assert 0.1 < raised.value.seconds < 0.5
    assert world.sim_step == 240


def test_mistakes_in_properties_are_errors_of_the_plan(milk: Object) -> None:
    with pytest.raises(BadProperty, match="did you mean upright"), monitored("uprigth(milk)"):
        pass
    with pytest.raises(BadProperty, match="did you mean milk"), monitored("mlk.z > 1"):
        milk.set_position([0, 0, 2])


def test_violations_may_only_be_recorded(milk: Object, tmp_path: Path) -> None:
    with recorder.record(tmp_path / "run.mcap"), monitored("milk.z < 1", only_record=True):
        milk.set_position([0, 0, 2])
        milk.set_position([0, 0, 3])
    with replay.open(tmp_path / "run.mcap") as log:
        watched, violated = log.records(Check)
        assert (watched.phase, watched.property, Path(watched.source_file)) == (
            Check.WATCHED,
            "milk.z < 1",
            Path(__file__),
        )
        assert (violated.phase, violated.margin) == (Check.VIOLATED, -1.0)
        assert log[violated.step].move_body.position == [0, 0, 2]
        assert violated.seq == violated.step + 1


PLAN = """
import random
from pycram.bullet_world import BulletWorld, Object
from pycram.language import par

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", "milk.stl", [0, 0, 0.5])
    cup = Object("cup", "cup", "cup.stl", [1, 0, 0.5])

    def lift(body):
        for _ in range(3):
            body.set_position([body.get_position()[0], 0, 0.5 + random.random()])

    par(lambda: lift(milk), lambda: lift(cup))
    world.simulate(0.5)  # line 17
"""


def run(folder: Path, properties: str, *options: str, name: str = "run.mcap") -> int:
    return main(arguments(folder, properties, *options, name=name))


def arguments(folder: Path, properties: str, *options: str, name: str = "run.mcap") -> list[str]:
    (folder / "plan.py").write_text(PLAN, encoding="utf-8")
    (folder / "some.properties").write_text(properties, encoding="utf-8")
    checked = ("--check", str(folder / "some.properties")) if properties else ()
    return ["run", str(folder / "plan.py"), "--seed", "3", "--log", str(folder / name), *checked, *options]


def test_watching_changes_nothing_of_the_run(tmp_path: Path) -> None:
    assert run(tmp_path, "", name="plain.mcap") == 0
    assert run(tmp_path, "milk.z < 9\nnever contact(milk, cup)\neventually contact(cup, floor)\n") == 0
    with replay.open(tmp_path / "plain.mcap") as plain, replay.open(tmp_path / "run.mcap") as watched:
        kept = [record for record in watched.records() if not isinstance(record, Check)]
        assert len(kept) == len(plain)
        for one, other in zip(plain.records(Mutation), watched.records(Mutation), strict=True):
            assert one.effect == other.effect
            assert one.thread == other.thread


def test_a_run_with_properties_fails_and_is_explained_and_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "# falls\nnever contact(milk, floor)\n") == 1
    assert "the plan failed: PropertyViolated: never contact(milk, floor): violated at step" in capsys.readouterr().err
    log = str(tmp_path / "run.mcap")
    assert replay_main(["why", log]) == 0
    why = capsys.readouterr().out
    assert "milk fell by" in why
    assert "plan.py:17" in why
    assert "a mistake in the plan" not in why
    assert replay_main(["check", log, "never contact(milk, floor)"]) == 1
    with replay.open(log) as recording:
        (violated,) = [each for each in recording.records(Check) if each.phase == Check.VIOLATED]
        (checked,) = recording.check("never contact(milk, floor)")
        (violation,) = checked.verdict.violations
        assert (violation.moment.step, violation.moment.sim_step) == (violated.step, violated.moment)
        assert math.isclose(violation.margin, violated.margin)


def test_a_violation_at_the_end_names_its_step_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "at end not contact(milk, floor)\n") == 1
    printed = capsys.readouterr().err
    assert "at the end, since step " in printed
    assert "in plan.py:17" in printed
    assert "Traceback" not in printed


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--check-only-record",)])
def test_a_guided_run_watches_the_same_properties(tmp_path: Path, options: tuple[str, ...]) -> None:
    command = arguments(tmp_path, "never contact(milk, floor)\n", *options)
    ended = subprocess.run([sys.executable, "-m", "pycram", *command], check=False, capture_output=True)
    assert ended.returncode == (0 if options else 1)
    assert replay_main(["retrace", str(tmp_path / "run.mcap")]) == 0


def test_a_run_may_record_violations_without_failing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "never contact(milk, floor)\n", "--check-only-record") == 0
    assert "pycram: never contact(milk, floor): violated at step" in capsys.readouterr().err
    log = str(tmp_path / "run.mcap")
    assert replay_main(["sql", log, "select outcome, violated from runs", "--csv"]) == 0
    assert capsys.readouterr().out == "outcome,violated\nsucceeded,1\n"
    assert replay_main(["sql", log, "select property, violated, margin < 0 from checks", "--csv"]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == [
        '"never contact(milk, floor)",false,',
        '"never contact(milk, floor)",true,true',
    ]


def test_mistakes_in_a_file_are_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(tmp_path, "milk.z <\n")
    assert ended.value.code == 2
    assert "some.properties:1: milk.z <" in capsys.readouterr().err
    assert run(tmp_path, "always mlk.z < 9\n") == 2
    assert "no object is called mlk; did you mean milk?" in capsys.readouterr().err


@pytest.mark.slow
def test_sweeps_and_statistics_know_violations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.py").write_text(PLAN, encoding="utf-8")
    (tmp_path / "some.properties").write_text("milk.z < 1.3\n", encoding="utf-8")
    sweep = ["sweep", str(tmp_path / "plan.py"), "--runs", "4", "-o", str(tmp_path / "runs")]
    assert main([*sweep, "--check", str(tmp_path / "some.properties")]) == 1
    capsys.readouterr()
    assert replay_main(["stats", str(tmp_path / "runs"), "--json"]) == 0
    stats = json.loads(capsys.readouterr().out)
    assert stats["outcomes"]["failed"] > 0
    assert stats["causes"][0]["cause"].startswith("PropertyViolated at par/<lambda>: milk.z < #: violated")
    for seed in "123":
        assert run(tmp_path, "milk.z < 1.3\n", "--check-only-record", "--seed", seed, name=f"{seed}.mcap") == 0
    capsys.readouterr()
    assert replay_main(["stats", str(tmp_path), "--json"]) == 0
    outcomes = json.loads(capsys.readouterr().out)["outcomes"]
    assert outcomes["succeeded but violated"] > 0


@pytest.mark.slow
def test_an_order_that_only_violates_is_an_ending(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.py").write_text(
        "from pycram.bullet_world import BulletWorld, Object\n"
        "from pycram.language import par\n"
        "with BulletWorld():\n"
        "    milk = Object('milk', 'milk', 'milk.stl', [0, 0, 0.5])\n"
        "    lift, move = (lambda: milk.set_position([0, 0, 2])), (lambda: milk.set_position([5, 0, 0.5]))\n"
        "    par(lift, move)\n"
        "    milk.set_position([0, 0, 0])\n",
        encoding="utf-8",
    )
    (tmp_path / "some.properties").write_text("eventually milk.z > 1 after milk.x > 1\n", encoding="utf-8")
    explore = ["run", str(tmp_path / "plan.py"), "--explore", "8", "--json", "--log", str(tmp_path / "run.mcap")]
    assert main([*explore, "--check", str(tmp_path / "some.properties"), "--check-only-record"]) == 1
    endings = [each["kind"] for each in json.loads(capsys.readouterr().out)["endings"]]
    assert sorted(endings) == ["succeeded", "succeeded but violated"]
