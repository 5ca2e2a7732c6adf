"""``log`` picks records by kind, task, object, world, time and text."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest

import recorder
import replay
from recorder.records import Mutation, Query, Task
from replay.cli.main import main


@pytest.fixture
def picked(small_log: Path, capsys: pytest.CaptureFixture[str]):
    """The steps that ``log`` gives for some options."""

    def pick(*options: str) -> list[int]:
        assert main(["log", str(small_log), *options, "--json"]) == 0
        return [json.loads(line)["step"] for line in capsys.readouterr().out.splitlines()]

    return pick


def test_log_without_filters_has_every_record(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        assert picked() == list(range(len(log)))


def test_log_filters_by_kind(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        assert picked("--kind", "query") == [record.seq for record in log.records(Query)]
        assert picked("--kind", "query", "--kind", "task") == [record.seq for record in log.records((Query, Task))]


def test_log_filters_by_task_with_its_subtasks(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        start, end = log.step("task:carry@start"), log.step("task:carry@end")
        assert picked("--task", "carry") == list(range(start, end + 1))
        assert picked("--task", str(log[start].task)) == list(range(start, end + 1))
        par = picked("--task", "par")
        assert {log[step].name for step in par if isinstance(log[step], Query)} == {"contact", "visible"}


def test_log_filters_by_object_also_as_carrier_or_carried(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        matches = [log[step] for step in picked("--object", "milk", "--kind", "mutation")]
        commands = [record.WhichOneof("command") for record in matches]
        assert commands == [
            "load_body",
            "simulate",
            "attach_body",
            "move_body",
            "detach_body",
            "move_body",
            "move_body",
        ]
        assert matches[3].move_body.body == "cereal"


def test_log_filters_by_world_text_and_steps(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        assert picked("--world", "table", "--kind", "mutation") == [record.seq for record in log.records(Mutation)]
        (failed, again) = picked("--text", "WOULD FALL", "--kind", "task")
        assert (failed, again) == (log.step("task:put@end"), log.step("task:put#2@end"))
        assert picked("--from", "-3") == list(range(len(log) - 3, len(log)))
        assert picked("--from", "task:put#2@start", "--to", "failure") == list(range(again - 3, again + 1))
        assert picked("--to", "0.1s") == list(range(log.step("0.1s") + 1))


def test_log_finds_what_a_line_of_the_plan_led_to(small_log: Path, picked) -> None:
    with replay.open(small_log) as log:
        moved = next(record for record in log.records("mutation") if record.HasField("attach_body"))
        line = f"plan.py:{moved.source_line}"
        assert moved.seq in picked("--where", line)
        assert moved.seq in picked("--where", f"golden/{line}", "--kind", "mutation")
        others = {log[step].source_line for step in picked("--where", line) if isinstance(log[step], Mutation)}
        assert others == {moved.source_line}
        start, end = log.step("task:carry@start"), log.step("task:carry@end")
        called = picked("--where", f"plan.py:{log[start].source_line}")
        assert set(range(start, end + 1)) <= set(called)  # all that the task did, whichever line did it
        assert len(picked("--where", "plan.py")) > len(called)


def test_log_finds_what_a_line_of_the_plan_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = tmp_path / "prints.py"
    plan.write_text('print("before")\nprint("here")\nprint("after")\n')
    with recorder.record(tmp_path / "prints.mcap", source=plan, output=True):
        runpy.run_path(str(plan), run_name="__main__")
    capsys.readouterr()
    assert main(["log", str(tmp_path / "prints.mcap"), "--where", "prints.py:2"]) == 0
    assert "stdout: here" in capsys.readouterr().out.splitlines()[0]


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (["--object", "milkk"], "there is no object 'milkk'; did you mean milk?"),
        (["--world", "tabel"], "did you mean table?"),
        (["--task", "cary"], "did you mean carry?"),
        (["--where", "plam.py:3"], "did you mean plan.py?"),
        (["--where", "plan.py:9999"], "it has lines 1 to"),
    ],
)
def test_a_filter_for_what_isnt_there_says_so(
    small_log: Path, options: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", str(small_log), *options]) == 2
    assert hint in capsys.readouterr().err
    assert main(["log", str(small_log), "--object", "milk", "--text", "no line has this"]) == 0


def test_records_are_picked_by_the_name_of_their_kind(small_log: Path) -> None:
    with replay.open(small_log) as log:
        assert list(log.records("query")) == list(log.records(Query))
        with pytest.raises(replay.NoSuchName, match="did you mean query"):
            log.records("querry")


def test_a_wrong_verb_gives_the_nearest_and_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tre", "x.mcap"]) == 2
    assert "there is no verb 'tre'; did you mean tree" in capsys.readouterr().err
    assert main(["zzz", "x.mcap"]) == 2
    assert "ask, blame, cheat, check, debug" in capsys.readouterr().err


def test_the_plans_source_is_listed_printed_and_written(
    small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = (Path(__file__).parents[1] / "golden" / "plan.py").read_text()
    assert main(["source", str(small_log)]) == 0
    assert "plan.py" in capsys.readouterr().out.split()
    assert main(["source", str(small_log), "--json"]) == 0
    (listed,) = [each for each in json.loads(capsys.readouterr().out) if each["file"] == "plan.py"]
    assert listed["bytes"] == len(plan)
    for name in ("plan.py", f"{listed['sha256'][:6]}/plan.py", "/elsewhere/plan.py"):
        assert main(["source", str(small_log), name]) == 0
        assert capsys.readouterr().out == plan
    assert main(["source", str(small_log), "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "plan.py").read_text() == plan
    capsys.readouterr()
    assert main(["source", str(small_log), "plan.py", "-o", str(tmp_path / "out" / "plan.py")]) == 2
    assert "File exists" in capsys.readouterr().err  # it may be the plan itself, changed since
    assert main(["source", str(small_log), "plain.py"]) == 2
    assert "did you mean plan.py?" in capsys.readouterr().err
