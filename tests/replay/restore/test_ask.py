"""Questions at past steps: the answers of the live run, changed conditions, and what isn't a question."""

from __future__ import annotations

import contextlib
import json
import random
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.world.world import open_worlds
from recorder.records import Query
from replay.cli.main import main
from replay.report import phrases
from replay.report.question import BadQuestion, Name, QueryCall, parse
from replay.restore.ask import QUERIES, Move
from tests.replay.approximately import assert_approximately

if TYPE_CHECKING:
    from pathlib import Path

CAMERA = "wide_stereo_optical_frame"


def names(answer_json: str) -> bool | list[str]:
    answer = json.loads(answer_json)
    if isinstance(answer, list):
        return [item["object"] if isinstance(item, dict) else item for item in answer]
    return answer


@pytest.mark.slow
@pytest.mark.parametrize("log_of", ["demo_log", "failed_log"])
def test_every_query_of_the_demos_gives_what_it_gave_live(log_of: str, request: pytest.FixtureRequest) -> None:
    with replay.open(request.getfixturevalue(log_of)) as log:
        asked = [record for record in log.records(Query) if record.name in QUERIES]
        assert {"visible", "blocking"} <= {record.name for record in asked}
        for record in asked:
            answer = log.ask(record.seq)
            where = f"step {record.seq}: {answer.question}"
            assert answer.answer == names(record.answer_json), where
            assert answer.world == record.world
            live = {fact.name: json.loads(fact.json) for fact in record.evidence}
            if record.name == "stable":  # its simulation clone has a past of its own: the same but for its creep
                assert answer.evidence["moved"] == pytest.approx(live["moved"], abs=1e-3), where
            else:
                assert_approximately(answer.evidence, live, where, within=1e-6)
    assert not open_worlds()


@pytest.mark.slow
def test_a_recorded_query_can_be_typed_as_a_question(
    demo_log: Path, failed_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of each query of the demos, typed as ``log`` and ``why`` show it."""
    for file in (demo_log, failed_log):
        with replay.open(file) as log:
            asked = {record.name: record for record in log.records(Query) if record.name in QUERIES}
            assert asked
            for record in asked.values():
                shown = phrases.question(record)
                assert main(["ask", str(file), str(record.seq), shown, "--json"]) == 0, shown
                assert json.loads(capsys.readouterr().out)["answer"] == names(record.answer_json), shown


def test_json_literals_of_records_are_parsed() -> None:
    question = parse("reachable_object(object=milk, gripper=tip, collision_free=false, grasp=null, threshold=1e-3)")
    assert question.keywords == {
        "object": Name("milk"),
        "gripper": Name("tip"),
        "collision_free": False,
        "grasp": None,
        "threshold": 1e-3,
    }
    assert (
        str(QueryCall("stable", (Name("red cup"), Name("true"), Name("milk"), True)))
        == "stable('red cup', 'true', milk, True)"
    )


def test_a_name_that_is_no_identifier_must_be_quoted() -> None:
    with pytest.raises(BadQuestion, match="into quotes"):
        parse("stable(red-cup)")


def first(log: replay.Recording, query: str) -> Query:
    return next(record for record in log.records(Query) if isinstance(record, Query) and record.name == query)


@pytest.mark.slow
def test_changed_conditions_change_the_answer(demo_log: Path) -> None:
    with replay.open(demo_log) as log:
        step = first(log, "visible").seq
        question = f"visible(milk, {CAMERA}, threshold=0.5)"
        seen = log.ask(step, question)
        assert seen.answer is True
        assert seen.evidence["share"] > 0.5  # type: ignore[operator]
        behind = log.ask(step, question, moves=[Move("milk", (-2, 0, 1))])
        assert behind.answer is False
        assert "behind the camera" in str(behind.evidence["reason"])
        gone = log.ask(step, question)
        assert gone.answer is True  # nothing of the move is left
        assert gone.evidence == seen.evidence
        in_hand = log.ask(step, "reachable(milk, robot, l_gripper_tool_frame)", moves=[Move("milk", (1.2, 0.9, 1))])
        assert in_hand.answer is True
        blocked = first(log, "blocking")
        assert log.ask(blocked.seq).answer == ["bowl"]
        assert log.ask(blocked.seq, moves=[Move("bowl", (-2, 0, 1))]).answer == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("stable(milk)", True),
        ("btr.stable('milk', world)", True),
        ("contact(kitchen, milk)", True),
        ("contact(object1=milk, object2=bowl)", False),
        ("supporting(kitchen, milk, None)", True),
        ("visible(milk, [0.6, 1.0, 1.4])", True),
        ("visible(milk, ([0.6, 1.0, 1.4], (0, 0, 0, 1)))", False),
        (f"occluding(milk, {CAMERA}, robot=pr2)", None),
        ("reachable([1.2, 0.9, 1], BulletWorld.robot, l_gripper_tool_frame, world, 0.02)", True),
        ("reachable_object(milk, pr2, 'l_gripper_tool_frame', threshold=0.05, grasp=front)", True),
        ("reachable_pose([1.2, 9, -1], pr2, l_gripper_tool_frame)", False),
        ("reachable_poses([[1.2, 0.9, 1], [9, 9, 9]], pr2, l_gripper_tool_frame, ignoring=[milk])", [True, False]),
        ("blocking(cereal, pr2, r_gripper_tool_frame, grasp=None)", []),
    ],
)
def test_queries_are_asked_as_in_the_thesis(scene_log: Path, question: str, answer: object) -> None:
    with replay.open(scene_log) as log:
        result = log.ask(first(log, "visible").seq, question)
    assert isinstance(result.answer, list) if answer is None else result.answer == answer
    assert result.evidence or answer is False
    assert parse(str(result.question)) == result.question  # it can be typed again as it is printed


def test_every_query_can_be_asked() -> None:
    assert set(QUERIES) == {
        "blocking",
        "contact",
        "occluding",
        "reachable",
        "reachable_object",
        "reachable_pose",
        "reachable_poses",
        "reachable_position",
        "stable",
        "supporting",
        "visible",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "can't be parsed"),
        ("stable(", "can't be parsed"),
        (
            "stable(milk carton)",
            "invalid syntax; put names with spaces into quotes: stable\\('milk carton'\\)",
        ),
        ("stable", "is the call of a query"),
        ("stable(milk) and stable(bowl)", "is the call of a query"),
        ("stable(open('x'))", "can't be an argument"),
        ("stable(*milk)", "can't be an argument"),
        ("stable(**milk)", r"\*\*"),
        ("stable(lambda: 0)", "can't be an argument"),
        ("stable([x for x in milk])", "can't be an argument"),
        ("stable(milk.__class__.__mro__[0])", "can't be an argument"),
        ("(lambda: 0)()", "isn't a name"),
        ("stable(f'{milk}')", "can't be an argument"),
        ("stable(-milk)", "can't be an argument"),
        ("stable(" + "[" * 5000 + "]" * 5000 + ")", "nest"),
        ("stable(\0)", "can't be parsed"),
        ("stable(1j)", "can't be an argument"),
    ],
)
def test_anything_but_a_query_call_is_refused_without_executing_it(text: str, message: str) -> None:
    with pytest.raises(BadQuestion, match=message):
        parse(text)


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ("stabel(milk)", "did you mean stable"),
        ("__import__('os')", "no query"),
        ("stable(milc)", "did you mean milk"),
        ("stable()", "missing a required argument: 'object'"),
        ("stable(milk, speed=3)", "unexpected keyword argument 'speed'"),
        ("stable(3)", "expected an Object"),
        ("visible(milk, no_such_frame)", "no_such_frame"),
        ("reachable([0, 0], pr2, l_gripper_tool_frame)", "3 finite numbers"),
    ],
)
def test_questions_without_an_answer_say_why(scene_log: Path, question: str, message: str) -> None:
    with replay.open(scene_log) as log, pytest.raises(replay.ReplayError, match=message):
        log.ask(first(log, "visible").seq, question)
    assert not open_worlds()


def test_properties_and_queries_are_refused_with_the_command_that_takes_them(
    scene_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(scene_log)
    for given, remedy in (
        (["ask", log, "5", "milk.z > 0.5"], f"pycram-replay check {log} 'milk.z > 0.5'"),
        (["ask", log, "5", "never contact(milk, floor)"], f"pycram-replay check {log} 'never contact(milk, floor)'"),
        (["ask", log, "5", "upright(milk, 30 deg)"], f"pycram-replay check {log} 'upright(milk, 30 deg)'"),
        (["check", log, "always stable(milk) within 2 s"], f"pycram-replay ask {log} STEP 'stable(milk)'"),
    ):
        assert main(given) == 2
        assert capsys.readouterr().err.rstrip().endswith(remedy)
    for given in (["ask", log, "5", "stabel(milk)"], ["ask", log, "5", "milk"], ["check", log, "uprigth(milk)"]):
        assert main(given) == 2
        assert "pycram-replay " not in capsys.readouterr().err


def test_identifiers_print_without_quotes_other_names_with_quotes() -> None:
    asked = parse("btr.visible(milk, camera=wide, threshold=-0.5, robot=None)")
    assert asked.query == "visible"
    assert asked.arguments == (Name("milk"),)
    assert asked.keywords == {"camera": Name("wide"), "threshold": -0.5, "robot": None}


def test_the_verb_prints_the_answer_and_its_evidence(scene_log: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """What the engine's native code prints doesn't get among the results."""
    with replay.open(scene_log) as log:
        step = str(first(log, "visible").seq)
    asked = ["ask", str(scene_log), step, f"visible(milk, {CAMERA})"]
    assert main(asked) == 0
    assert capfd.readouterr().out.startswith(f"visible(milk, {CAMERA}): yes\n  share")
    assert main([*asked, "--json", "--move", "milk=-2,0,1,0,0,0,1"]) == 0
    data = json.loads(capfd.readouterr().out)
    assert data["answer"] is False
    assert data["evidence"]["reason"]
    assert data["moves"] == [{"object": "milk", "position": [-2, 0, 1], "orientation": [0, 0, 0, 1]}]


def test_after_the_plan_the_last_open_world_is_asked(scene_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ask", str(scene_log), "last", "stable(milk)"]) == 0
    output = capsys.readouterr()
    with replay.open(scene_log) as log:
        last, answer = log.step("last"), log.ask("last", "stable(milk)")
    assert log.state_at(answer.step).world().open
    assert output.out.startswith(next(answer.lines()))
    assert f"no world is open after step {last}; this is the answer after step {answer.step}" in output.err


@pytest.mark.slow
def test_without_the_engine_the_missing_library_is_named(scene_log: Path) -> None:
    script = (
        "import sys; sys.modules['pybullet'] = None; from replay.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    asked = [sys.executable, "-c", script, "ask", str(scene_log), "-3", "stable(milk)"]
    process = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert process.returncode == 2
    assert (
        process.stderr
        == "pycram-replay: ask: pybullet isn't installed; in a checkout of PyCRAM: pip install '.[executor]'\n"
    )
    assert not process.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["-3", "stabel(milk)"],
        ["-3", "stable(milk)", "--move", "milk=1,2"],
        ["-3", "stable(milk)", "--move", "nothing=1,2,3"],
        ["-3", "stable(milk)", "--move", "milk=nan,2,3"],
        ["0"],
        ["-3", "stable(milk)", "--world", "elsewhere"],
    ],
)
def test_wrong_usage_is_reported_on_stderr(
    scene_log: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ask", str(scene_log), *arguments]) == 2
    output = capsys.readouterr()
    assert not output.out
    assert output.err.startswith("pycram-replay: ")


@pytest.mark.slow
def test_odd_arguments_are_answered_or_refused(tmp_path: Path) -> None:
    """Never an error of another kind, whatever is asked."""
    with recorder.record(tmp_path / "x.mcap"), BulletWorld(name="w"):
        for number, name in enumerate(("apple", "bowl")):
            Object(name, name, f"{name}.stl", [number, 0, 0])
    terms = (
        "apple",
        "nix",
        "''",
        "0",
        "-1e400",
        "[]",
        "[1,2]",
        "[[1,2,3],[0,0,0,0]]",
        "null",
        "[apple,[1]]",
        "'\\x00'",
    )
    dice = random.Random(5)
    asked = answered = 0
    with replay.open(tmp_path / "x.mcap") as log:
        for query in QUERIES * 12:
            arguments = [dice.choice(terms) for _ in range(dice.randrange(5))]
            arguments += [f"{dice.choice(('threshold', 'camera', 'poses', 'nix'))}={dice.choice(terms)}"]
            asked += 1
            with contextlib.suppress(replay.ReplayError):
                log.ask(3, f"{query}({', '.join(arguments[dice.randrange(2) :])})")
                answered += 1
        assert asked > answered
        for question in ("stable(a=1,a=2)", "stable(apple if 1 else 2)", "0x_", "stable(" + "[" * 3000, "5and 6"):
            with pytest.raises(BadQuestion):
                log.ask(3, question)


def test_a_recorded_query_is_asked_again_in_its_own_world_only(scene_log: Path) -> None:
    with replay.open(scene_log) as log, pytest.raises(BadQuestion, match="asked in kitchen"):
        log.ask(first(log, "visible").seq, world="elsewhere")
