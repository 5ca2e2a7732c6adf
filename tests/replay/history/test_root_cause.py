"""The step ``failure``, ``why`` and the tree's way down tell of one and the same failure."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

import recorder
import replay
from pycram import tasks
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import failure_handling, par, try_in_order
from recorder.tracing.span import span
from replay.history.source import PlanSource, parse_traceback

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.file.record_reader import RecordReader


def fail(name: str) -> None:
    with span("motion", name):
        raise PlanFailure(f"{name} can't be done")


def caught(name: str) -> PlanFailure:
    with pytest.raises(PlanFailure) as failed:
        fail(name)
    return failed.value


def raises_an_earlier_failure() -> None:
    first = caught("open")
    caught("look")
    raise first


def gives_up_after_attempts() -> None:
    for attempt in failure_handling(2):
        with attempt:
            fail("grasp")


def fails_by_its_own_mistake() -> None:
    caught("open")
    with BulletWorld(name="lab"):
        Object("ball", "ball", "apple.stl")
        _ = {}["spoon"]


def fails_by_a_mistake_beside_another_failure() -> None:
    with par() as block:
        block(first_breaks)
        block(then_fails)


BROKEN = threading.Event()


def first_breaks() -> None:
    with span("motion", "break"):
        BROKEN.set()
        _ = {}["spoon"]


def then_fails() -> None:
    BROKEN.wait(10)
    fail("open")


def fails_because_of_another() -> None:
    try:
        fail("open")
    except PlanFailure as failure:
        caught("look")
        raise PlanFailure("no spoon") from failure


def fails_outside_of_blocks_and_in_one() -> None:
    caught("open")
    with try_in_order as block:
        block(fail, "push")
        block(lambda: "pulled")


def deals_with_all() -> None:
    for name in ("push", "kick"):
        with try_in_order as block:
            block(fail, name)
            block(lambda: "pulled")


@pytest.mark.parametrize(
    ("plan", "name"),
    [
        (raises_an_earlier_failure, "open"),
        (gives_up_after_attempts, "grasp"),
        (fails_because_of_another, "open"),
        (fails_by_a_mistake_beside_another_failure, "break"),
        (fails_by_its_own_mistake, None),
        (fails_outside_of_blocks_and_in_one, "open"),
        (deals_with_all, "kick"),
    ],
)
def test_failure_step_why_and_tree_agree_on_the_root_cause(
    tmp_path: Path, plan: Callable[[], None], name: str | None
) -> None:
    error = None
    try:
        with recorder.record(tmp_path / "x.mcap"):
            plan()
    except (PlanFailure, KeyError) as raised:
        error = raised
    running = tasks.tree().failure_path()
    with replay.open(tmp_path / "x.mcap") as log:
        why, path = log.why(), log.tree().failure_path()
        assert log.step("failure") == why.step
        assert log.state_at("failure").step == why.step
        if name is None:
            assert why.task is None
            assert path == []
            assert log.state_at("failure").body("ball")  # while the world was still open
            return
        assert why.task.started.name == path[-1].name == name
        assert why.step == why.task.finished.seq == path[-1].finished.seq
        assert [node.id for node in path] == [task.started.task for task in why.task.around()][::-1]
        if error is None:
            assert [node.id for node in running] == [node.id for node in path]


def test_the_last_attempt_is_the_root_cause(tmp_path: Path) -> None:
    with pytest.raises(PlanFailure), recorder.record(tmp_path / "x.mcap"):
        gives_up_after_attempts()
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.step("failure") == log.step("task:grasp#-1@end")
        assert [node.name for node in log.tree().failure_path()] == ["failure-handling", "attempt 3", "grasp"]


def test_without_failure_there_is_no_root_cause(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"), span("motion", "look"):
        pass
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.tree().failure_path() == []
        with pytest.raises(replay.NoSuchStep, match="nothing failed"):
            log.step("failure")


def test_lines_of_an_action_of_pycram_are_no_lines_of_the_plan() -> None:
    log = cast("RecordReader", SimpleNamespace(assets={}))
    frame = '  File "/{}", line 7, in find\n    raise NoPlace(name)\n'
    text = "Traceback (most recent call last):\n{}pycram.failures.NoPlace: no place"
    for file, own in (("pycram/actions/hands.py", False), ("plan.py", True)):
        (error,) = parse_traceback(text.format(frame.format(file)), PlanSource(log))
        assert (error.own, bool(error.lines)) == (own, own)
