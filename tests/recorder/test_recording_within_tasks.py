"""Recordings that begin or end during tasks list these tasks, and are sound."""

from __future__ import annotations

import random
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import failure_handling, in_thread, par, pursue, seq, try_all
from recorder.records import Keyframe, Run, Task
from recorder.tracing.span import span
from replay.cli.main import main
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path


def sound(file: Path) -> replay.Recording:
    with replay.open(file) as log:
        result = verify(log)
        assert result.sound, result.problem
    return replay.open(file)


def test_a_recording_within_tasks_begins_with_them(
    world: BulletWorld, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cup = Object("cup", "cup", "cup.stl", world=world)
    file = tmp_path / "inner.mcap"
    with span("motion", "outer", {"object": cup}), span("process-module", "Inner"):
        with recorder.record(file, name="part"):
            cup.set_position([0, 0, 1])
        cup.set_position([0, 0, 2])
    with sound(file) as log:
        run, outer, inner, *others = log
        assert (run.name, outer.name, inner.name) == ("part", "outer", "Inner")
        assert inner.parent == outer.task
        assert 0 < outer.began_ns <= inner.began_ns <= run.wall_time_ns
        assert (outer.source_file, inner.source_file) == (__file__, __file__)
        assert isinstance(others[0], Keyframe)
        assert [record.task for record in others[1:-3]] == [inner.task]
        left = others[-3:-1]
        assert [(task.name, task.phase, task.status) for task in left] == [
            ("Inner", Task.LEFT, Task.RUNNING),
            ("outer", Task.LEFT, Task.RUNNING),
        ]
        assert isinstance(others[-1], Run)
        assert [node.name for _, node in log.tree().walk()] == ["outer", "Inner"]
        assert log.tree().roots[0].start.wall_ns == outer.began_ns
        assert log.blame("cup").causes.tasks[0].started.name == "Inner"
    main(["log", str(file), "--kind", "task"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("motion outer(object=cup), already running")
    assert lines[-1].endswith("motion outer still runs when the recording ends")
    main(["tree", str(file)])
    assert "not finished, began before the recording" in capsys.readouterr().out
    main(["verify", str(file)])
    assert "2 of them unfinished" in capsys.readouterr().out


def test_a_recording_that_is_left_within_tasks_says_so(tmp_path: Path) -> None:
    file = tmp_path / "cut.mcap"
    with ExitStack() as recording:
        recording.enter_context(recorder.record(file))
        with span("motion", "done"):
            pass
        with span("motion", "cut"):
            recording.close()
    with sound(file) as log:
        *_, left, end = log
        assert (left.name, left.phase, left.parent) == ("cut", Task.LEFT, 0)
        assert end.phase == Run.FINISHED
        assert end.succeeded
        cut = log.tree().find(name="cut")[0]
        assert cut.finished is None
        with pytest.raises(replay.NoSuchStep, match="ends before the end of this task"):
            log.step("task:cut@end")


def test_branches_beside_the_one_that_records_are_in_it(tmp_path: Path) -> None:
    file = tmp_path / "branch.mcap"

    def slow() -> None:
        with span("motion", "slow"):
            for _ in range(4):
                par(lambda: None, lambda: None)

    def records() -> None:
        with recorder.record(file):
            par(lambda: None, lambda: None)

    par(slow, records, slow)
    with sound(file) as log:
        assert [node.name for node in log.tree().roots] == ["par"]


def test_a_recording_of_its_own_thread(tmp_path: Path) -> None:
    def records() -> None:
        with recorder.record(tmp_path / "thread.mcap"), span("motion", "there"):
            pass

    with span("motion", "here"):
        in_thread(records)
    with sound(tmp_path / "thread.mcap") as log:
        assert [node.path for _, node in log.tree().walk()][-1].endswith("there")


class Cut:
    """A plan that runs in a random way, within which a recording begins and, somewhere else, ends."""

    def __init__(self, seed: int, file: Path, cup: Object) -> None:
        self.dice, self.file, self.cup = random.Random(seed), file, cup
        self.ticks = 0
        self.first, self.last = sorted(self.dice.sample(range(40), 2))
        self.recording = ExitStack()

    def tick(self) -> None:
        if self.ticks == self.first:
            self.recording.enter_context(recorder.record(self.file))
        if self.ticks == self.last:
            self.recording.close()
        self.ticks += 1
        self.cup.set_position([0, 0, self.ticks])

    def part(self, depth: int) -> None:
        self.tick()
        kind = self.dice.randrange(5 if depth else 1)
        if kind == 0 and self.dice.random() < 0.2:
            raise PlanFailure("no")
        if kind == 1:
            with span("motion", f"motion {depth}"):
                self.part(depth - 1)
                self.tick()
        if kind == 2:
            failure_handling(1).run(lambda: self.part(depth - 1))
        if kind > 2:
            block = self.dice.choice((par, seq, pursue, try_all))
            block(*[lambda: self.part(depth - 1)] * self.dice.randrange(1, 4))
        self.tick()

    def run(self) -> None:
        while self.ticks < 40:
            with suppress(PlanFailure, ExceptionGroup):
                self.part(4)
        self.recording.close()


@pytest.mark.parametrize("seed", range(20))
def test_recordings_cut_out_of_random_plans_are_sound(world: BulletWorld, tmp_path: Path, seed: int) -> None:
    plan = Cut(seed, tmp_path / "cut.mcap", Object("cup", "cup", "cup.stl", world=world))
    plan.run()
    sound(plan.file).close()
