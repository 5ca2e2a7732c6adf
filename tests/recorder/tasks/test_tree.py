"""The task tree: the tree of a running plan and the tree of its recording are equal."""

# ruff: noqa: PT012  the plans under test have bodies
from __future__ import annotations

import json
import subprocess
import sys
import threading
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import pytest

import recorder
import replay
from pycram import tasks
from pycram.bullet_world import BulletWorld
from pycram.designator import MotionDesignator
from pycram.failures import PlanFailure, Unreachable
from pycram.language import State, failure_handling, finally_, par, pursue, seq, timeout, try_in_order
from pycram.process_module import ProcessModule
from recorder.records import Task
from recorder.tasks import Tree
from recorder.tracing.span import span
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path


def fails() -> None:
    raise Unreachable("left", [1, 2, 3], 0.2)


def plan() -> None:
    """Every kind of task, and every end."""
    with par as s:
        s(int, 7)
        with seq as t:
            t(int, 8)
            with try_in_order as u:
                u(fails)
                u(int, 9)
                u(int, 10)
        s(lambda: failure_handling(2, arm="left").on(Unreachable, lambda _: {"arm": "right"}).run(take))
        with finally_(int), timeout(60):
            pass
    with pursue as s:
        s(lambda: threading.Event().wait(0))
        with seq([]) as t:
            t(fails)
    fails()


def take(arm: str) -> str:
    if arm == "left":
        fails()
    return arm


@pytest.fixture
def log(tmp_path: Path, world: BulletWorld) -> Path:
    file = tmp_path / "plan.mcap"
    with recorder.record(file), pytest.raises(Unreachable), span("plan", "tidy up", {"room": "kitchen"}):
        world.simulate(1)
        plan()
    return file


def test_live_tree_and_recorded_tree_are_equal(log: Path) -> None:
    with replay.open(log) as opened:
        recorded = opened.tree()
    live = tasks.tree()
    assert recorded == live
    assert len(recorded) >= 18
    (root,) = live.roots
    assert root.kind == "plan"
    assert root.parameters == {"room": "kitchen"}
    assert root.status is State.FAILED
    assert root.failure.type == "Unreachable"
    assert root.failure.traceback
    assert (root.start.sim_seconds, root.end.sim_seconds) == (0.0, 1.0)
    assert root.start.world == root.end.world != ""
    assert 0 < root.start.wall_ns < root.end.wall_ns
    assert root.seconds == pytest.approx((root.end.wall_ns - root.start.wall_ns) / 1e9, abs=0.5)
    assert __file__ in root.source
    other = Tree()
    assert other != recorded
    for _, node in recorded.walk():
        for record in (node.asked, node.started, node.finished):
            if record is not None:
                other.apply(record)
    assert other == recorded


def test_attempts_and_failures_can_be_found(log: Path) -> None:
    tree = tasks.tree()
    (handling,) = tree.find(kind="failure-handling")
    assert [(node.attempt, node.status, dict(node.parameters)) for node in handling.attempts] == [
        (1, State.FAILED, {"arm": "left"}),
        (2, State.SUCCEEDED, {"arm": "right"}),
    ]
    (inner,) = tree.find(name="try_in_order")
    assert [child.status.word for child in inner.children] == ["failed", "succeeded", "cancelled"]
    assert inner.parent.name == "seq"
    assert inner.path == "tidy up/par/seq/try_in_order"
    assert inner.children[2].start is None
    assert inner.children[2].seconds == 0
    assert [node.name for node in tree.failure_path()] == ["tidy up"]
    assert tree.find(status=State.RUNNING) == []


def test_a_plan_reads_its_tree_while_it_runs() -> None:
    seen = {}

    def branch() -> None:
        node = tasks.current()
        seen["path"] = node.path
        seen["status"] = node.status
        seen["siblings"] = [child.status for child in node.parent.children]
        seen["block"] = node.parent.status

    assert tasks.current() is None
    with span("plan", "outer") as outer, par([]) as s:
        s(fails)
        s.branches[0].wait()
        s(branch)
        assert tasks.current().name == "par"
    assert tasks.tree().nodes[outer.id].status is State.SUCCEEDED
    assert seen["path"].startswith("outer/par/")
    assert seen["status"] is seen["block"] is State.RUNNING
    assert seen["siblings"] == [State.FAILED, State.RUNNING]


def test_the_parent_is_right_across_threads() -> None:
    seen = []

    class Looking(MotionDesignator):
        def reference(self) -> dict[str, object]:
            return {}

    class Module(ProcessModule):
        def _execute(self, designator: Looking) -> None:
            seen.append(tasks.current().path)

    module = Module()
    added = ProcessModule.resolvers.added(lambda designator: module if isinstance(designator, Looking) else None)
    with added, BulletWorld(), span("plan", "p"), par:
        ProcessModule.perform(Looking([("type", "gaze")]))
        with seq:
            ProcessModule.perform(Looking([("type", "gaze")]))
    assert sorted(seen) == ["p/par/gaze/Module", "p/par/seq/gaze/Module"]
    root = tasks.tree().roots[-1]
    at_once, in_order = root.children[0].children
    assert (at_once.kind, in_order.kind) == ("motion", "block")
    assert at_once.asked is None
    (waiting,) = in_order.children
    for node in (at_once, in_order, waiting):
        assert node.created.wall_ns <= node.start.wall_ns
        assert __file__ in node.source


def test_a_branch_is_created_until_it_starts() -> None:
    with pursue as s:
        s(lambda: None)
        s.branches[0].wait()
        s(lambda: None)  # too late
    late = tasks.tree().roots[-1].children[1]
    assert late.status is State.CANCELLED
    assert late.start is None
    assert __file__ in late.source
    fresh = Tree()
    fresh.apply(late.asked)
    assert fresh.roots[0].status is State.CREATED
    assert fresh.roots[0].start is None


def test_a_long_plan_keeps_its_last_tasks() -> None:
    tree = Tree(limit=100)
    tree.apply(Task(phase=Task.STARTED, task=1, name="day"))
    for number in range(2, 1000):
        tree.apply(Task(phase=Task.STARTED, task=number, parent=1, name="hour"))
        tree.apply(Task(phase=Task.FINISHED, status=Task.SUCCEEDED, task=number, parent=1))
    assert len(tree) == 100
    (root,) = tree.roots
    assert root.forgotten == 999 - 100
    assert [child.id for child in root.children] == list(range(901, 1000))
    assert "... 899 more, forgotten" in tree.text()
    heavy = Tree(size=100_000)
    for number in range(1, 100):
        heavy.apply(Task(phase=Task.STARTED, task=number, name="look"))
        heavy.apply(Task(phase=Task.FINISHED, status=Task.SUCCEEDED, task=number, result_json="0" * 10_000))
    assert [root.id for root in heavy.roots] == list(range(91, 100))
    tree.apply(Task(phase=Task.FINISHED, status=Task.SUCCEEDED, task=1))
    tree.forget()
    assert len(tree) == 0
    assert not tree.roots


def test_text_json_dot_and_picture(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tree = tasks.tree()
    text = tree.text()
    assert str(tree) == text
    for line in (
        "X tidy up plan",
        '+ attempt 2(arm="right")',
        "- int branch",
        "never begun",
        "Unreachable: left arm",
    ):
        assert line in text
    assert "... " in tree.text(depth=1)
    facts = json.loads(tree.to_json())
    assert len(facts) == len(tree)
    assert {fact["status"] for fact in facts} == {"succeeded", "failed", "cancelled"}
    picture = ET.fromstring(tree.to_svg())
    assert picture.attrib["viewBox"] == f"0 0 {picture.attrib['width']} {picture.attrib['height']}"  # scaled, never cut
    titles = [title.text for title in picture.iter("{http://www.w3.org/2000/svg}title")]
    assert len(titles) == len(tree)
    assert any("Unreachable" in title for title in titles)
    dot = tree.to_dot()
    assert dot.startswith("digraph tasks {")
    assert dot.count(" -> ") == len(tree) - 1
    for option, expected in (
        ("--svg", tree.to_svg()),
        ("--dot", dot),
        ("--json", tree.to_json() + "\n"),
        ("--all", tree.text(whole=True) + "\n"),
    ):
        assert main(["tree", str(log), option]) == 0
        assert capsys.readouterr().out == expected


def test_multiline_and_empty_messages_of_failures_are_indented(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file):
        for words in ("first\nsecond", ""):
            with pytest.raises(PlanFailure), span("plan", "tidy up"):
                raise PlanFailure(words)
    text = [line.lstrip("> ") for line in tasks.tree().text().splitlines()]
    assert text[1:3] == ["PlanFailure: first", "second"]
    assert text[4:] == ["PlanFailure"]
    assert main(["log", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [int(line.split()[0]) for line in lines] == list(range(6))
    assert lines[2].endswith("PlanFailure: first; second")
    assert lines[4].endswith("PlanFailure")


def test_states_print_their_names() -> None:
    assert [str(State.FAILED), f"{State.FAILED}"] == ["State.FAILED"] * 2


@pytest.mark.slow
def test_a_recorded_tree_is_read_without_the_physics_engine(log: Path) -> None:
    program = f"""
import sys
sys.modules["pybullet"] = None
import replay
print(len(replay.open({str(log)!r}).tree()), "pycram" in sys.modules)
"""
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert out.split() == [str(len(tasks.tree())), "False"]


def test_the_tree_exists_without_a_recording() -> None:
    with pytest.raises(PlanFailure), par as s:
        s(fails)
    root = tasks.tree().roots[-1]
    assert (root.name, root.status, root.failure.type) == ("par", State.FAILED, "BranchesFailed")
    assert root.children[0].failure.message.startswith("left arm")
    assert root.end.wall_ns >= root.start.wall_ns > 0
