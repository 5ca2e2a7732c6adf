"""One plan of a robot in which many things fail, and what is said of each; the page that documents it."""

from __future__ import annotations

import contextlib
import json
import re
from dataclasses import fields
from pathlib import Path
from textwrap import dedent
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.failures import PlanFailure
from recorder.tracing.span import span
from replay.cli.main import main
from replay.explain import causes as kinds
from tests.replay.explain.causes.explaining import START, executed, words

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording


DOCS = Path(__file__).parents[4] / "docs"


ROBOT = """
    from pycram.designator import MotionDesignator
    from pycram.process_module import ProcessModule
    def perform(**slots):
        slots = [(key.replace("_", "-"), value) for key, value in slots.items()]
        return ProcessModule.perform(MotionDesignator(slots))
    def tried(**slots):
        try:
            return perform(**slots)
        except PlanFailure:
            return None
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    robot = world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
    cup = Object("cup", "cup", "cup.stl", [1.75, 0.9, 0.92])
    bowl = Object("bowl", "bowl", "bowl.stl", [1.4, 0.4, 0.9])
    world.settle()
    perform(type="move-arm-joints", left_arm="park", right_arm="park")

    tried(type="pick-up", object=cup, arm="left")  # 1: too far
    perform(type="move-arm-joints", left_arm="park")
    tried(type="place", object=cup, target=[1.3, 0.6, 0.9], arm="left")  # 1: so it holds nothing

    cup.set_position([1.35, 0.9, 0.9])
    world.settle()
    assert btr.reachable(cup, robot, "l_gripper_tool_frame")
    cup.set_position([1.75, 0.9, 0.9])
    tried(type="pick-up", object=cup, arm="left")  # 2: no longer there

    cup.set_position([1.35, 0.9, 0.9])
    world.settle()
    perform(type="pick-up", object=cup, arm="left")
    tried(type="place", object=cup, target=[1.9, 0.9, 0.9], arm="left")  # a wall
    drawer = {"drawer_joint": "sink_area_left_upper_drawer_main_joint", "part_of": kitchen}
    drawer["drawer_handle"] = "sink_area_left_upper_drawer_handle"
    tried(type="accessing", **drawer, arm="left")  # 3: the hand isn't free

    bowl.set_position([1.3, 0.88, 0.88])
    tried(type="place", object=cup, target=[1.3, 0.9, 0.9], arm="left")  # 4: the bowl is there

    perform(type="pick-up", object=cup, arm="left")
    perform(type="move-tcp", target=[0.6, 1.2, 1.1], arm="left")
    perform(type="opening-gripper", gripper="left")
    milk = tried(type="detecting", object_type="milk")  # 5: there is none
    try:
        with par as s:
            perform(type="pick-up", object=cup, arm="left")  # 6: it fell
            perform(type="pick-up", object=bowl, arm="right", grasp="left")
    except PlanFailure:
        pass
    perform(type="pick-up", object=milk, arm="right")
"""


@pytest.fixture(scope="module")
def robot_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    (folder / "plan.py").write_text(dedent(START) + dedent(ROBOT))
    assert executed(folder / "plan.py") == 1
    return folder / "x.mcap"


@pytest.fixture
def robot(robot_log: Path) -> Iterator[Recording]:
    with replay.open(robot_log) as log:
        yield log


def numbered(log: Recording, text: str) -> int:
    lines = (log.path.parent / "plan.py").read_text().splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


@pytest.mark.slow
def test_a_swallowed_failure_explains_the_later_one(robot: Recording) -> None:
    (cause,) = robot.why("task:place#1@end").causes
    assert (cause.kind, cause.precondition) == ("swallowed-failure", "held")
    assert (cause.subject, cause.arm) == ("cup", "left")
    assert cause.failed.last_step == robot.step("task:pick-up#1@end")
    assert cause.went_on.number == numbered(robot, "# 1: too far") + 1
    assert cause.steps[0] == cause.failed.last_step
    assert robot.step("task:place#1@start") < cause.steps[-1] <= robot.step("task:place#1@end")


@pytest.mark.slow
def test_what_no_longer_held_is_told_with_the_change(robot: Recording) -> None:
    (cause,) = robot.why("task:pick-up#2@end").causes
    assert cause.kind == "no-longer-true"
    assert cause.asked.name == "reachable_object"
    (change,) = cause.changes
    assert (change.body, change.how) == ("cup", "command")
    assert change.line.number == numbered(robot, "# 2: no longer") - 1


@pytest.mark.slow
def test_a_hand_that_is_not_free_is_told_with_what_should_have_freed_it(robot: Recording) -> None:
    why = robot.why("task:accessing@end")
    (cause,) = why.causes
    assert (cause.kind, cause.precondition, cause.subject) == ("swallowed-failure", "hand-free", "cup")
    assert cause.failed.last_step == robot.step("task:place#3@end")
    kitchen = next(involved for involved in why.bodies if involved.body.name == "kitchen")
    assert set(kitchen.joints) == {"sink_area_left_upper_drawer_main_joint"}
    assert set(kitchen.links) == {"sink_area_left_upper_drawer_handle"}
    cup = next(involved for involved in why.bodies if involved.body.name == "cup")
    assert cup.hands == {"cup": "left"}


@pytest.mark.slow
def test_what_is_in_the_way_is_in_the_scene_with_its_link_and_what_put_it_there(robot: Recording) -> None:
    why = robot.why("task:place#5@end")
    let_go, cause = why.causes
    assert (let_go.kind, let_go.body, let_go.how) == ("physics", "cup", "tipped")
    assert (cause.kind, cause.body, cause.mover) == ("in-the-way", "bowl", "cup")
    assert cause.change.line.number == numbered(robot, "bowl.set_position")
    assert "bowl" in [involved.body.name for involved in why.bodies]


@pytest.mark.slow
def test_all_failing_branches_have_their_scene_and_their_causes(robot: Recording) -> None:
    why = robot.why(robot.step("task:pick-up#-2@end"))
    (branch,) = why.branches
    by_arm = {why.task.motion.parameters["arm"]: why.causes, branch.task.motion.parameters["arm"]: branch.causes}
    fell = next(cause for cause in by_arm["left"] if isinstance(cause, kinds.Physics))
    assert (fell.body, fell.how, fell.hand) == ("cup", "fell", "left")
    assert fell.lets[0].task.name == "opening-gripper"
    names = {involved.body.name for involved in branch.bodies}
    assert names >= {"pr2", *([] if branch.task.motion.parameters["arm"] == "left" else ["bowl"])}


@pytest.mark.slow
def test_a_variable_without_a_value_leads_to_the_failure_that_left_it_so(robot: Recording) -> None:
    cause, mistake = robot.why().causes
    assert (cause.kind, cause.precondition, cause.subject) == ("swallowed-failure", "result", "milk")
    assert cause.failed.name == "detecting"
    assert (mistake.kind, mistake.own) == ("raised", False)
    assert mistake.line.text == 'perform(type="pick-up", object=milk, arm="right")'


def test_of_very_many_failures_the_last_are_looked_at_and_the_others_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replay.history.tasks._MAX_KEPT", 10)
    with contextlib.suppress(PlanFailure), recorder.record(tmp_path / "x.mcap"), span("plan", "long", {}):
        for number in range(40):
            with (
                contextlib.suppress(PlanFailure) if number < 39 else contextlib.nullcontext(),
                span("motion", "take", {}),
            ):
                raise PlanFailure(f"no {number}")
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        assert why.failure.message == "no 39"
        assert len(why.attempts) == 10
        assert why.forgotten == 30
    text = words(tmp_path, capsys)
    assert "take was attempted at least 10 times" in text
    assert "30 earlier failures are left out" in text


@pytest.mark.slow
def test_json_has_the_kinds_and_fields_that_the_page_documents(
    robot_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for step in ("task:place#1@end", "task:pick-up#2@end", "task:accessing@end", "task:place#5@end", "failure"):
        assert main(["why", "--json", str(robot_log), step]) == 0
        for cause in json.loads(capsys.readouterr().out)["causes"]:
            assert set(cause) == documented()[cause["kind"]] | {"kind", "steps", "text"}
            assert cause["text"]


@pytest.mark.slow
def test_the_page_shows_what_a_reader_gets(
    robot_log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(robot_log.parent)
    assert main(["why", str(robot_log), "task:place@end"]) == 0
    output = {without_numbers(line) for line in capsys.readouterr().out.splitlines()}
    shown = (
        (DOCS / "guides" / "why.md")
        .read_text()
        .partition("$ pycram-replay why")[2]
        .partition("```")[0]
        .splitlines()[1:]
    )
    assert len(shown) > 5
    for line in shown:
        assert line == "..." or without_numbers(line) in output, line


def without_numbers(line: str) -> str:
    return re.sub(r"\d+(?:\.\d+)?", "#", line)


def documented() -> dict[str, set[str]]:
    """The fields of each kind of cause by the page's table."""
    page = (DOCS / "reference" / "causes.md").read_text().partition("## Values")[0]
    rows = re.findall(r"^\| `([a-z-]+)` \|[^|]*\|([^|]*)\|$", page, re.MULTILINE)
    return {kind: set(re.findall(r"`(\w+)`", text)) for kind, text in rows}


def test_the_page_documents_every_kind_of_cause_with_its_fields() -> None:
    causes = (*kinds.KINDS, kinds.Interruption)
    assert documented() == {each.kind: {field.name for field in fields(each)} - {"steps"} for each in causes}
