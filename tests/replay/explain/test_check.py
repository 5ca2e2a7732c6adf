"""``check``: properties of recordings; a violation has its step, its values, its task and the plan's line."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder.properties import BadProperty
from recorder.tracing.span import span
from replay.cli.main import main
from replay.explain.check import lines as check_lines
from replay.report import phrases
from tests.replay.documented import REPO, blocks, printed, without_numbers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording

PLAN = """
from pycram.bullet_world import BulletWorld, Object
from recorder.tracing.span import span

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("floor", "environment", "plane.urdf")
    cup = Object("cup", "cup", "cup.stl", [0, 0, 0.05])
    milk = Object("milk", "milk", "milk.stl", [1, 0, 0.1])
    world.settle()
    with span("motion", "lift"):
        milk.set_position([1, 0, 0.6])
        milk.set_position([1, 0, 0.9], [0.5, 0.5, 0.5, 0.5])  # line 13
    world.simulate(0.3)  # line 14
    milk.set_position([0, 0.5, 0.6])
"""
TURNED, FALLING = 13, 14


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    folder = tmp_path_factory.mktemp("check")
    plan = folder / "plan.py"
    plan.write_text(PLAN, encoding="utf-8")
    with recorder.record(folder / "run.mcap", source=plan):
        exec(compile(PLAN, str(plan), "exec"), {"__name__": "plan"})
    with replay.open(folder / "run.mcap") as opened:
        yield opened


def line_of(checked: object) -> int:
    return checked.causes.call_stack[-1].number


def test_a_violation_has_its_step_values_task_and_line(log: Recording) -> None:
    (checked,) = log.check("always upright(milk, 20 deg)")
    assert not checked
    (violation, *_) = checked.verdict.violations
    assert checked.record.move_body.body == "milk"
    assert violation.values["tilt(milk)"] == pytest.approx(math.pi / 2)
    assert violation.margin == pytest.approx(math.radians(20) - math.pi / 2)
    assert [task.started.name for task in checked.causes.tasks] == ["lift"]
    assert line_of(checked) == TURNED


def test_moments_within_a_simulation_are_checked(log: Recording) -> None:
    """It falls from 0.9 m for 0.3 s: no record ends below 0.85 m but above the floor before."""
    (checked,) = log.check("always milk.z > 0.85 after milk.z > 0.8")
    (violation,) = checked.verdict.violations
    assert violation.moment.sampled
    assert checked.record.HasField("simulate")
    assert line_of(checked) == FALLING
    assert f"by {phrases.length(-checked.verdict.margin)} at worst" in str(list(check_lines(checked)))
    assert 0.8 < violation.values["milk.z"] < 0.85


def test_the_end_is_blamed_on_the_step_that_made_the_condition_false(log: Recording) -> None:
    fallen, moved, turned = log.check("at end milk.z > 0.7", "at end milk.y < 0.4", "at end upright(milk, 20 deg)")
    assert fallen.record.HasField("simulate"), "a later move doesn't change the truth"
    assert fallen.verdict.margin == pytest.approx(-0.1)
    assert [line_of(each) for each in (fallen, moved, turned)] == [FALLING, FALLING + 1, TURNED]


def test_a_condition_that_never_held_is_blamed_on_the_last_failed_task_of_its_object(
    log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (never,) = log.check("eventually milk.z > 2")
    assert (never.record, never.causes) == (None, None), "no change of the milk is wrong"
    assert never.verdict.closest.step < never.verdict.violations[0].moment.step
    assert f"closest at step {never.verdict.closest.step}" in str(list(check_lines(never)))
    with recorder.record(tmp_path / "failed.mcap"), BulletWorld() as world:
        Object("milk", "milk", "milk.stl", [1, 0, 0.1])
        with suppress(ValueError), span("motion", "lift", {"object": "milk"}):
            raise ValueError
        with suppress(ValueError), span("motion", "look"):  # a later failure that isn't about the milk
            raise ValueError
        world.simulate(0.1)
    with replay.open(tmp_path / "failed.mcap") as failed:
        (never,) = failed.check("eventually milk.z > 2")
        assert main(["check", str(failed.path), "eventually milk.z > 2", "--json"]) == 1
    assert [task.started.name for task in never.causes.tasks] == ["lift"]
    assert json.loads(capsys.readouterr().out)[0]["blamed_step"] == never.record.seq


def test_contacts_are_measured_at_each_moment(log: Recording) -> None:
    on, apart, pairs, never = log.check(
        "on(milk, floor) before task:lift",
        "never contact(milk, cup)",
        'always count(contact("*", floor)) >= 1',
        "always contact(milk, floor)",
    )
    assert not on, "it is loaded above the floor"
    assert (bool(apart), apart.verdict.margin) == (True, 0.05)
    assert not pairs
    assert not never
    (lying,) = log.check("at end on(cup, floor)")
    assert (bool(lying), lying.verdict.margin) == (True, pytest.approx(0.001, abs=1e-3))


def test_a_count_of_conditions_is_a_number_of_objects(log: Recording) -> None:
    counted = log.check(
        'at end count(on("*", floor)) == 1',  # the milk is in the air
        'at end count(not on("*", floor)) == 1',
        'at end count(contact("*", "*")) == 1',
    )
    assert all(counted), [each.verdict.values for each in counted]


def test_the_verb_prints_results_and_fails_if_one_is_violated(
    log: Recording, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["check", str(log.path), "cup.z > 0", "eventually milk.z > 0.8"]) == 0
    assert [line[:5] for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")] == ["holds"] * 2
    file = tmp_path / "some.properties"
    file.write_text("milk.z < 0.8  # wrong\n", encoding="utf-8")
    assert main(["check", str(log.path), "-f", str(file)]) == 1
    shown = capsys.readouterr().out
    assert "in lift  [step" in shown
    assert f"plan.py:{TURNED} in <module>:  milk.set_position([1, 0, 0.9]" in shown
    assert f"pycram-replay state {log.path}" in shown
    assert main(["check", str(log.path), "-f", str(file), "--json"]) == 1
    (found,) = json.loads(capsys.readouterr().out)
    assert (found["property"], found["source"], found["holds"]) == ("milk.z < 0.8", "some.properties:1", False)
    assert found["causes"]["line"]["line"] == TURNED


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mlk.z > 1", "no object is called mlk; did you mean milk?"),
        ("contact(milk, cop)", "no object is called cop; did you mean cup?"),
        ("upright(milk, 10)", "write 10 deg"),
        ("", "it has no expression"),
    ],
)
def test_mistakes_are_wrong_usage(log: Recording, text: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(log.path), text]) == 2
    assert message in capsys.readouterr().err
    with pytest.raises(BadProperty):
        log.check(text)


def test_a_folder_is_counted(log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "high.mcap").write_bytes(Path(log.path).read_bytes())
    with recorder.record(tmp_path / "low.mcap"), BulletWorld():
        Object("milk", "milk", "milk.stl", [1, 0, 0.1])
    assert main(["check", str(tmp_path), "eventually milk.z > 0.5", "milk.x >= 0"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "eventually milk.z > 0.5: holds in 1 of 2 runs; violated in low.mcap",
        "milk.x >= 0: holds in 2 of 2 runs",
    ]


@pytest.mark.slow
def test_the_guide_shows_what_the_verb_prints(demo_log: Path, tmp_path: Path) -> None:
    (tmp_path / demo_log.name).write_bytes(demo_log.read_bytes())
    (block,) = blocks((REPO / "docs" / "reference" / "properties.md").read_text(encoding="utf-8"))
    output = [without_numbers(line) for line in printed(block.commands, tmp_path)]
    assert [without_numbers(line) for line in block.lines] == output
