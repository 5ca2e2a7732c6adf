"""Why a plan failed, for people who were not there."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

import recorder
import replay
from pycram import cli
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import par
from pycram.running import RunSpec, run
from recorder.records import Query, Run
from recorder.records.text import is_choice
from recorder.tracing.span import span
from replay.cli.main import main

if TYPE_CHECKING:
    from replay.recording import Recording

DOCS = Path(__file__).parents[3] / "docs"


def test_why_follows_the_causes_to_the_task_and_the_plan_s_lines(small: Recording) -> None:
    why = small.why()
    assert why.failure.message == "the milk can't be put anywhere"
    assert [(error.type, error.message) for error in why.exceptions] == [
        ("ReasoningError", "milk would fall from 0.5 m"),
        ("ReasoningError", "the milk can't be put anywhere"),
    ]
    assert [line.text for line in why.exceptions[0].lines] == [
        "put(milk, height)",
        'raise btr.ReasoningError(f"{body.name} would fall from {height} m")',
    ]
    assert why.exceptions[-1].lines[-1].text == 'raise btr.ReasoningError("the milk can\'t be put anywhere") from last'
    assert why.task.parameters["height"] == 0.5
    assert [each.task.parameters["height"] for each in why.attempts] == [1.0, 0.5]
    assert why.step == small.step("task:put#2@end")


def test_why_lists_the_queries_that_the_plan_relied_on(small: Recording) -> None:
    why = small.why()
    (asked,) = why.queries
    assert asked.query.name == "stable"
    assert asked.query.task == why.task.started.task
    assert not asked.moved
    assert why.warning == asked.query


def test_why_lists_changes_since_the_last_success(small: Recording) -> None:
    why = small.why()
    assert why.since_same_success is None
    assert why.since_last_success.task.started.name == "carry"
    assert {change.body for change in why.since_last_success.difference.notable} == {"milk", "cereal"}


def test_why_of_another_failure(small: Recording) -> None:
    first = small.step("task:put@end")
    for step in (first, first - 1, "failure", "task:put#2@start"):
        why = small.why(step)
        assert why.task.parameters["height"] == (0.5 if step in ("failure", "task:put#2@start") else 1.0)
    with pytest.raises(replay.NoSuchStep, match="no task had failed"):
        small.why(5)


def drop_in_branch(ball: Object) -> None:
    with span("motion", "drop", {"object": ball}):
        raise PlanFailure("it is stuck")


def drop_in_block(file: Path) -> None:
    with recorder.record(file, source=__file__), BulletWorld(name="lab"):
        ball = Object("ball", "ball", "apple.stl")
        with par as block:
            block(drop_in_branch, ball)


def test_a_branch_s_failure_is_explained_down_to_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(PlanFailure):
        drop_in_block(tmp_path / "x.mcap")
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    where = capsys.readouterr().out.partition("Where in the plan\n")[2].partition("\n\n")[0]
    lines = [line.strip() for line in where.splitlines()]
    assert lines.index("block(drop_in_branch, ball)") < lines.index('with span("motion", "drop", {"object": ball}):')
    assert "which raised BranchesFailed:" in lines
    assert "with par as block:" in lines


def test_an_earlier_failure_is_not_taken_for_the_plan_s(small: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(small.path), "task:put@end"]) == 0
    first, second = capsys.readouterr().out.splitlines()[:2]
    assert "the milk can't be put anywhere" in first
    assert second.startswith("Before that, put(object=milk, height=1) failed")


def test_after_the_end_of_all_worlds_the_last_open_one_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld(name="lab"):
        Object("ball", "ball", "apple.stl")
    assert main(["ask", str(tmp_path / "x.mcap"), "last", "contact(ball, ball)"]) == 0
    assert "no world is open after step 4; this is the answer after step 2" in capsys.readouterr().err


def test_a_mistake_in_the_plan_s_own_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError), recorder.record(tmp_path / "x.mcap", source=__file__), BulletWorld():
        {}["spoon"]
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        assert why.task is None
        assert why.is_python_error
        assert '{}["spoon"]' in why.exceptions[0].lines[-1].text
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    assert "KeyError: 'spoon'" in capsys.readouterr().out.splitlines()[0]


def test_file_paths_are_relative_to_the_working_directory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plans").mkdir()
    (tmp_path / "plans" / "broken_part.py").write_text("def fail():\n    raise ValueError\n")
    (tmp_path / "plans" / "plan.py").write_text("from broken_part import fail\nfail()\n")
    monkeypatch.chdir(tmp_path)
    assert run(RunSpec(Path("plans/plan.py")), Path("x.mcap")) == 1
    assert main(["why", "x.mcap"]) == 0
    where = capsys.readouterr().out.partition("Where in the plan\n")[2].splitlines()
    assert [line.split()[0] for line in where if ".py:" in line] == ["plans/plan.py:2", "plans/broken_part.py:2"]
    monkeypatch.chdir("plans")
    assert main(["why", "../x.mcap"]) == 0
    assert "\n  plan.py:2 in <module>\n" in capsys.readouterr().out
    monkeypatch.chdir(Path(__file__).parent)
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    assert f"\n  {tmp_path}/plans/plan.py:2 in <module>\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("message", "said"),
    [("", 'assert 2 < 1 or not "two"'), (', "two is too much"', "two is too much"), (', "two\\nlines"', "two")],
)
def test_an_assertion_of_the_plan_is_no_error_of_the_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], message: str, said: str
) -> None:
    file, plan = tmp_path / "x.mcap", tmp_path / "plan.py"
    plan.write_text(f'assert 2 < 1 or not "two"{message}')
    assert cli.main(["run", str(plan), "--log", str(file)]) == 1
    assert f"pycram: the plan's assertion doesn't hold: {said}\n" in capsys.readouterr().err
    assert main(["why", str(file)]) == 0
    assert f" s: the plan's assertion doesn't hold: {said}" in capsys.readouterr().out.splitlines()[0]


def test_a_failed_assertion_of_a_library_is_an_error_of_the_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, plan = tmp_path / "x.mcap", tmp_path / "plan.py"
    plan.write_text("import numpy.testing\nnumpy.testing.assert_equal(1, 2)")
    assert cli.main(["run", str(plan), "--log", str(file)]) == 1
    assert "the plan has an error: AssertionError" in capsys.readouterr().err
    assert main(["why", str(file)]) == 0
    assert " s: AssertionError" in capsys.readouterr().out.splitlines()[0]


def gives_up(error: BaseException) -> None:
    with pytest.raises(PlanFailure) as failed, span("motion", "fetch"):
        raise PlanFailure("it is out of reach")
    raise error from failed.value


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (KeyError("left"), "KeyError: 'left'"),
        (SystemExit(3), "SystemExit: 3"),
        (PlanFailure("milk"), "PlanFailure: milk"),
        (PlanFailure("no milk is left"), "no milk is left"),
    ],
)
def test_the_first_line_says_what_went_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], error: BaseException, message: str
) -> None:
    with pytest.raises(type(error)), recorder.record(tmp_path / "x.mcap", name="plan", source=__file__):
        gives_up(error)
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    output = capsys.readouterr().out.splitlines()
    assert output[0].partition(" s: ")[2] == message
    assert output[1].startswith("The cause: fetch failed")


def test_a_plan_that_succeeded_has_nothing_to_explain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap", name="walk"):
        pass
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    assert capsys.readouterr().out == "walk succeeded.\n"


def test_without_failure_there_are_no_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap", name="walk"):
        pass
    assert main(["why", str(tmp_path / "x.mcap"), "--pictures", str(tmp_path / "pictures")]) == 0
    assert "nothing failed" in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()


def test_handled_failures_are_explained_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap", name="walk"), span("plan", "walk"):
        for number in range(12):
            with pytest.raises(PlanFailure), span("motion", "step", {"foot": number}):
                raise PlanFailure(f"stumbled {number}")
        with span("motion", "step", {"foot": 99}):
            pass
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    output = capsys.readouterr().out
    assert "walk succeeded" in output
    assert "step was attempted 12 times" in output
    assert "... 5 more ..." in output
    assert "stumbled 11" in output


def test_why_of_a_plan_that_was_cut_off(small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(small_log) as log:
        last = log.step("task:put#2@start")
        places = [log._index.chunks[number] for number in range(len(log._index.chunks))]
        end = next(place.offset for place in places[log.chunk_of(last) + 1 :])
    cut = tmp_path / "x.mcap"
    cut.write_bytes(small_log.read_bytes()[: end - 9])
    code = main(["why", str(cut)])
    output = capsys.readouterr()
    assert code == 3
    assert "was cut off at step" in output.out
    assert "height=1" in output.out


@pytest.mark.slow
def test_the_explanation_of_the_demo_has_every_section(failed_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(failed_log)]) == 0
    output = capsys.readouterr().out
    first, second, third, fourth = output.splitlines()[:4]
    assert first.startswith("fails_to_reach failed after")
    assert "right arm can't reach" in first
    assert "pick-up was attempted 4 times" in second
    assert "right arm can't reach" in third
    assert "reachable_object(milk, pr2, r_gripper_tool_frame) was answered no" in fourth
    for section in (
        " in try_to_take",
        "perform(pick_up(object=found, arm=arm))",
        "failure-handling(retries=3)",
        "milk at [1.72, 0.85,",
        "arm=left, pr2 at [0.65, 0.9]",
        "arm=right, pr2 at [0.65, 0.6]",
        "all of it is visible",
        "No pick-up succeeded before.",
        "detecting(object-type=milk) succeeded",
        "pycram-replay blame",
    ):
        assert section in output
    with replay.open(failed_log) as log:
        assert f"{log.why()}\n" == f"{log.why().text}\n" == output


@pytest.mark.slow
def test_why_with_json_has_the_same_content(failed: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(failed.path), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["failure"]["type"] == "Unreachable"
    assert [each["parameters"]["arm"] for each in data["tries"]] == ["left", "right", "left", "right"]
    assert [asked["name"] for asked in data["asked"]] == ["visible", "reachable_object", "blocking"]
    queries = [query.seq for query in failed.records(Query) if not is_choice(query)]
    assert [asked["step"] for asked in data["asked"]] == queries[-3:]
    assert isinstance(failed[-1], Run)
    (choice,) = data["choices"]
    assert (choice["name"], choice["arguments"]["arm"], choice["chosen"]) == ("grasp", "right", -1)
    assert {each["reason"] for each in choice["candidates"]} == {"OutOfReach"}
    assert min(each["data"]["distance"] for each in choice["candidates"]) == pytest.approx(0.211, abs=1e-3)
    assert data["decision"]["module"] == "pycram.motions.modules.pick_up.PickUp"


@pytest.mark.slow
def test_what_a_failed_motion_chose_from_is_told_everywhere(
    failed: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    (choice,) = failed.why().choices
    shown = {}
    for verb in (
        ["why"],
        ["tree"],
        ["log", "--from", str(choice.seq), "--to", str(choice.seq)],
        ["show", str(choice.seq)],
    ):
        assert main([verb[0], str(failed.path), *verb[1:]]) == 0
        shown[verb[0]] = capsys.readouterr().out
    for verb, text in shown.items():
        assert "out of reach by 0.211 m at best" in text, verb
    assert "OutOfReach" in shown["show"]
    excerpt = (
        (DOCS / "guides" / "reasoning.md")
        .read_text()
        .partition("choices of the failed motion:\n\n```\n")[2]
        .partition("```")[0]
    )
    lines = {re.sub(r"\d+", "#", line) for line in shown["why"].splitlines()}
    assert excerpt
    for line in excerpt.splitlines():
        assert re.sub(r"\d+", "#", line).strip() in {each.strip() for each in lines}, (
            "docs/guides/reasoning.md shows it"
        )
    assert shown["tree"].count("grasp(object=milk") == 1, "of the motion that the tree's marks lead to"
    assert main(["ask", str(failed.path), str(choice.seq)]) == 2
    assert "its record is a grasp" in capsys.readouterr().err


@pytest.mark.costly
def test_why_writes_pictures(failed_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(failed_log), "--pictures", str(tmp_path / "pictures"), "--json"]) == 0
    explained = json.loads(capsys.readouterr().out)
    files, step = explained["pictures"], explained["step"]
    assert [Path(file).name for file in files] == [f"step_{step}_{name}.png" for name in ("robot", "side", "milk")]
    for file in files:
        with Image.open(file) as picture:
            assert picture.size == (640, 480)
            assert len(picture.getcolors(1 << 20)) > 50


def try_another_way(file: Path) -> None:
    with recorder.record(file):
        try:
            with span("motion", "take", {"arm": "left"}):
                raise PlanFailure("too far")  # noqa: TRY301  as plans do
        except PlanFailure:
            with span("motion", "take", {"arm": "right"}):
                raise PlanFailure("too high")  # noqa: B904  as plans do


def test_a_handled_failure_is_no_root_cause(tmp_path: Path) -> None:
    with pytest.raises(PlanFailure):
        try_another_way(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        assert why.task.parameters == {"arm": "right"}
        assert [error.message for error in why.exceptions] == ["too high"]
        assert len(why.attempts) == 2


@pytest.mark.slow
def test_why_explains_a_damaged_recording_as_far_as_possible(failed_log: Path, tmp_path: Path) -> None:
    content = failed_log.read_bytes()
    copy = tmp_path / "damaged.mcap"
    for number in range(30):
        damaged = bytearray(content)
        for place in range(number, len(damaged), len(damaged) // (2 + number % 7)):
            damaged[place] ^= 0xFF
        copy.write_bytes(damaged)
        assert main(["why", str(copy)]) in (1, 2, 3), number
