"""What is different: between two steps, and between two runs."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.fluent import Fluent
from pycram.language import par
from pycram.process_module import ProcessModule
from recorder.mcap_sink import McapSink
from recorder.records import TOPICS, Query, Task
from recorder.records.values import AssetFile
from recorder.tracing.span import span
from replay.cli.main import main
from replay.compare import compare_recordings, difference
from replay.report import phrases
from replay.restore.verify import verify
from tests.replay.commands import mutation

if TYPE_CHECKING:
    from pathlib import Path

    from replay.recording import Recording


def test_a_step_does_not_differ_from_itself(small: Recording) -> None:
    for step in (0, 5, 60, len(small) - 1):
        assert not difference(small.state_at(step), small.state_at(step))


def test_a_difference_names_added_moved_and_attached_bodies(small: Recording) -> None:
    loaded, attached = mutation(small, "load_body", 1), mutation(small, "attach_body")
    came = difference(small.state_at(loaded - 1), small.state_at(loaded))
    assert came.added == (("table", "milk"),)
    assert not came.changed
    held = difference(small.state_at(attached - 1), small.state_at(attached))
    (change,) = [change for change in held.changed if change.body == "milk"]
    assert change.carrier_changed
    assert not change.moved
    assert change.carrier[1].carrier == "cereal"
    moved = difference(small.state_at(attached), small.state_at(attached + 2))
    assert {change.body for change in moved.notable} == {"milk", "cereal"}
    for change in moved.notable:
        assert change.distance == pytest.approx((0.2**2 + 0.2**2) ** 0.5, abs=5e-3)


def test_two_runs_of_the_same_plan_are_the_same(small_log: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    again.write_bytes(small_log.read_bytes())
    with replay.open(small_log) as first, replay.open(again) as second:
        compared = compare_recordings(first, second)
        assert compared.divergence is None
        assert compared.equal == len(first)
        assert not compared.difference


def drop(file: Path, heights: list[float], *, extra: bool = False) -> None:
    with recorder.record(file, name=file.stem), BulletWorld(name="lab") as world:
        ball = Object("ball", "ball", "apple.stl")
        for height in heights:
            with span("motion", "drop", {"height": height}):
                ball.set_position([0, 0, height])
        if extra:
            with span("motion", "look"):
                ball.set_position([0, 0, 9])
        world.simulate(0.1)


def fill(file: Path, height: float, *names: str) -> None:
    """Two worlds with a ball each, and fluents that branches wait for."""
    with recorder.record(file, name="fill"), contextlib.ExitStack() as open_worlds:
        for name in names or ("", ""):
            world = open_worlds.enter_context(BulletWorld(name=name or None))
            Object("ball", "ball", "apple.stl", [0, 0, height], world=world)
            height += 1
        fluent = Fluent(0)
        with par as block:
            block((fluent > 2).wait_for)
            block(fluent.set_value, 3)


def test_runs_in_one_process_are_compared_whatever_their_worlds_and_fluents_are_called(tmp_path: Path) -> None:
    fill(tmp_path / "first.mcap", 1)
    fill(tmp_path / "second.mcap", 1)
    fill(tmp_path / "third.mcap", 2)
    with (
        replay.open(tmp_path / "first.mcap") as first,
        replay.open(tmp_path / "second.mcap") as second,
        replay.open(tmp_path / "third.mcap") as third,
    ):
        assert first.lifetimes[0].world != second.lifetimes[0].world  # or nothing would be shown here
        same = compare_recordings(first, second)
        assert same.divergence is None
        assert same.equal == len(first)
        assert not same.difference
        other = compare_recordings(first, third)
        assert other.divergence is not None
        assert set(other.divergence.fields) == {"load_body.position[2]", "effect.bodies[0].position[2]"}
        assert [change.distance for change in other.difference.changed] == [1, 1]


def test_worlds_of_other_names_are_compared_in_order(tmp_path: Path) -> None:
    fill(tmp_path / "first.mcap", 1, "lab", "hall")
    fill(tmp_path / "second.mcap", 1, "lab", "yard")
    fill(tmp_path / "third.mcap", 1, "hall", "lab")
    with replay.open(tmp_path / "first.mcap") as first, replay.open(tmp_path / "second.mcap") as second:
        assert compare_recordings(first, second).divergence is None
        with replay.open(tmp_path / "third.mcap") as third:
            crossed = compare_recordings(first, third)  # names that both have are the same worlds
            assert crossed.divergence is not None
            assert [change.distance for change in crossed.difference.changed] == [1, 1]


def test_runs_diverge_at_the_first_different_record(tmp_path: Path) -> None:
    drop(tmp_path / "a.mcap", [1, 2, 3])
    drop(tmp_path / "b.mcap", [1, 2.5, 3])
    with replay.open(tmp_path / "a.mcap") as first, replay.open(tmp_path / "b.mcap") as second:
        divergence = compare_recordings(first, second).divergence
        assert divergence.task == "drop"
        assert divergence.first.seq == divergence.second.seq == first.step("task:drop#2@start")
        assert divergence.fields == {"parameters.height": (2, 2.5)}
        assert compare_recordings(first, second, tolerance=1.0).divergence is None


def test_a_record_of_only_one_run_is_the_divergence(tmp_path: Path) -> None:
    drop(tmp_path / "a.mcap", [1, 2])
    drop(tmp_path / "b.mcap", [1, 2], extra=True)
    with replay.open(tmp_path / "a.mcap") as first, replay.open(tmp_path / "b.mcap") as second:
        for log, second_log, side in ((first, second, "second"), (second, first, "first")):
            divergence = compare_recordings(log, second_log).divergence
            alone = getattr(divergence, side)
            assert isinstance(alone, Task)
            assert alone.name == "look"
            assert alone.phase == Task.STARTED
        compared = compare_recordings(first, second)
        (change,) = compared.difference.changed
        assert change.body == "ball"
        assert change.after[0][2] > 8


def test_a_record_of_only_one_run_comes_before_its_consequences(tmp_path: Path) -> None:
    """Records are numbered differently from there on, and still compared with their like."""

    def run(file: Path, *, looks: bool, height: float) -> None:
        with recorder.record(file), BulletWorld(name="lab"):
            ball = Object("ball", "ball", "apple.stl")
            if looks:
                with span("motion", "look"):
                    pass
            for place in (1.0, height, 3.0):
                with span("motion", "drop", {"height": place}):
                    ball.set_position([0, 0, place])

    run(tmp_path / "a.mcap", looks=False, height=2.0)
    run(tmp_path / "b.mcap", looks=True, height=2.5)
    run(tmp_path / "c.mcap", looks=True, height=2.0)
    with (
        replay.open(tmp_path / "a.mcap") as first,
        replay.open(tmp_path / "b.mcap") as second,
        replay.open(tmp_path / "c.mcap") as third,
    ):
        assert compare_recordings(first, second).divergence.second.name == "look"
        assert compare_recordings(first, third).divergence.second.name == "look"
        assert compare_recordings(second, third).divergence.fields == {"parameters.height": (2.5, 2.0)}


def test_diff_of_diverging_runs_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drop(tmp_path / "a.mcap", [1])
    drop(tmp_path / "b.mcap", [2])
    assert main(["diff", str(tmp_path / "a.mcap"), str(tmp_path / "a.mcap")]) == 0
    assert main(["diff", str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap")]) == 1
    assert "diverge in drop" in capsys.readouterr().out


@pytest.mark.parametrize("tolerance", ["nan", "-1", "inf", "much"])
def test_an_invalid_tolerance_is_refused(small_log: Path, tolerance: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diff", str(small_log), str(small_log), f"--tolerance={tolerance}"]) == 2
    assert "--tolerance" in capsys.readouterr().err


def test_diff_with_a_cut_recording_exits_with_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, cut = tmp_path / "a.mcap", tmp_path / "b.mcap"
    drop(whole, [1])
    cut.write_bytes(whole.read_bytes()[:-25_000])
    for pair in ((whole, cut), (cut, whole)):
        assert main(["diff", *map(str, pair)]) == 3
        output = capsys.readouterr()
        assert "has no such record" in output.out or "they diverge" in output.out
        assert "incomplete" in output.err
        assert "was cut off" in output.out.splitlines()[-1]


def test_small_changes_are_printed_with_enough_digits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file), BulletWorld(name="lab"):
        ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        ball.set_position([0, 0, 1 + 2e-8])
    assert main(["blame", str(file), "ball"]) == 0
    assert "ball was moved: by 2e-05 mm to" in capsys.readouterr().out
    with replay.open(file) as log:
        step = mutation(log, "move_body")
    assert main(["diff", str(file), str(step - 1), str(step), "--all"]) == 0
    assert "[0, 0, 1] -> [0, 0, 1.00000002]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("before", "after", "texts"),
    [
        (0.25, 0.25, ("0.25", "0.25")),
        (0.25, 0.5, ("0.25", "0.5")),
        (0.25, 0.24999993, ("0.25", "0.2499999")),
        (0.0, -4.8e-9, ("0", "-4.8e-09")),
        (1.0, 1.0 + 2**-52, ("1.0", "1.0000000000000002")),
    ],
)
def test_different_numbers_are_printed_differently(before: float, after: float, texts: tuple[str, str]) -> None:
    assert phrases.apart(before, after) == texts


def move_head(file: Path) -> None:
    with recorder.record(file), BulletWorld(name="lab") as world:
        world.set_robot(Object("pr2", "robot", "pr2.urdf"))
        for height in (1.0, 1.2):
            ProcessModule.perform(MotionDesignator([("type", "looking"), ("target", [1, 0, height])]))


def as_of_earlier_release(file: Path, target: Path) -> None:
    """The same recording without records and fields that releases before 0.2 didn't have."""
    with replay.open(file) as log:
        sink = McapSink(target, log.metadata)
        sink._frames.transforms = lambda record: iter(())  # type: ignore[method-assign]  steps are others
        for name, content in log.assets.items():
            sink.attach(AssetFile(name.partition("/")[2], content))
        kept = [record for record in log.records() if not isinstance(record, Query)]
        for step, record in enumerate(kept):
            record.seq = step
            if isinstance(record, Task):
                record.ClearField("decision")
            sink.write(TOPICS[type(record)], record, record.SerializeToString())
        sink.close()


def test_a_recording_of_an_earlier_release_differs_only_in_what_happened(tmp_path: Path) -> None:
    now, then = tmp_path / "now.mcap", tmp_path / "then.mcap"
    move_head(now)
    as_of_earlier_release(now, then)
    with replay.open(now) as first, replay.open(then) as second:
        assert {query.name for query in first.records(Query)} == {"gaze"}
        assert compare_recordings(first, second).divergence is None
        assert compare_recordings(second, first).divergence is None
        assert compare_recordings(first, first).equal == len(first)
        assert verify(second).exact
