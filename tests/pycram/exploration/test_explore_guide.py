"""The command: what docs/guides/explore.md shows is what a reader gets; JSON, wrong usage, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

import replay
from pycram.cli import main
from recorder.records import Run

REPO = Path(__file__).parents[3]
GUIDE = REPO / "docs" / "guides" / "explore.md"


def explore(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pycram", "run", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(REPO)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@pytest.mark.costly
@pytest.mark.slow
def test_a_reader_of_the_guide_gets_what_it_shows(tmp_path: Path) -> None:
    text = GUIDE.read_text(encoding="utf-8")
    plan, *_ = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (shown,) = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    (tmp_path / "paint.py").write_text(plan)
    command, _, lines = shown.partition("\n")
    process = explore(tmp_path, *command.removeprefix("$ pycram run ").split())
    printed, said = process.communicate(timeout=500)
    assert printed == lines
    assert all(re.fullmatch(r"pycram: \d+ of 40 orders", line) for line in said.splitlines())  # on a busy machine
    assert process.returncode == 1
    (bad,) = re.findall(r"--order (added:\S+)", lines)
    process = explore(tmp_path, "--seed", "1", "--order", bad, "paint.py")  # the command that it names
    _, said = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "AssertionError" in said
    for name in ("paint.mcap", "paint.explored-2.mcap"):
        with replay.open(tmp_path / name) as log:
            began = log[0]
            assert isinstance(began, Run)
            assert (began.order, began.seed, began.hash_seed) == (bad, "1", "1")


@pytest.mark.costly
def test_machines_get_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(
        "from pycram.fluent import Fluent\n"
        "from pycram.language import par\n"
        "from pycram.scheduling.cancellation import checkpoint\n"
        "import sys\n"
        "last = Fluent('', 'last')\n"
        "def say(word):\n"
        "    checkpoint()\n"
        "    last.set_value(word)\n"
        "par(*[lambda word=word: say(word) for word in sys.argv[1:]])\n"
    )
    given = ["run", "--explore", "12", "--seed", "3", "--json", "--log", str(tmp_path / "x.mcap"), str(plan)]
    assert main([*given, "--", "one", "two"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["runs"], found["alike"], found["deterministic"]) == (12, False, True)
    first, second = found["endings"]
    assert first["runs"] + second["runs"] == 12
    assert second["differences"] == ['fluent last is "one" instead of "two"']
    (decides,) = second["decides"]
    assert [decides[each]["branch"].split()[0] for each in ("branch", "before")] == ["par-2", "par-1"]
    assert second["command"] == f"pycram run --seed 3 --order {second['order']} {plan} -- one two"
    assert second["recording"] == str(tmp_path / "x.explored-2.mcap")
    assert main([*given, "--", "one"]) == 0
    assert json.loads(capsys.readouterr().out)["alike"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--explore", "0"], "not a whole number from 1 up"),
        (["--explore", "5", "--order", "added"], "--explore makes many"),
        (["--explore", "5", "--debug-on-failure"], "--debug-on-failure is for one run"),
        (["--explore", "5", "--limit", "0"], "not a time in seconds greater than 0"),
        (["--json"], "--json is only for --explore"),
        (["--order", "first"], "'first' is not an order: expected"),
    ],
)
def test_wrong_usage_is_said_before_anything_runs(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text("from pathlib import Path\nPath(__file__).with_name('ran').touch()\n")
    with pytest.raises(SystemExit) as ended:
        main(["run", *given, str(plan)])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "ran").exists()


@pytest.mark.slow
def test_a_plan_that_fails_in_all_orders_alike_is_no_success(tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text("from pycram.language import par\npar(list, list)\nraise ValueError('so')\n")
    process = explore(tmp_path, "--explore", "2", "plan.py")
    printed, _ = process.communicate(timeout=500)
    assert "all end alike: failed: ValueError: so at plan.py:3" in printed
    assert process.returncode == 1


@pytest.mark.slow
def test_ctrl_c_ends_all_runs_and_tells_what_was_found(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "begun")
    (tmp_path / "plan.py").write_text(
        "import os, signal\n"
        "from pycram.language import par\n"
        "from pycram.scheduling.cancellation import checkpoint\n"
        "par(checkpoint, checkpoint)\n"
        "try:\n"
        "    open('first', 'x')\n"  # the first run ends
        "except FileExistsError:\n"
        "    with open('begun', 'w') as file:\n"
        "        file.write('x')\n"
        "    signal.pause()\n"
    )
    process = explore(tmp_path, "--explore", "50", "--seed", "1", "plan.py")
    with open(tmp_path / "begun", encoding="utf-8") as begun:  # noqa: PTH123  waits for the second run
        assert begun.read(1) == "x"
        os.killpg(process.pid, signal.SIGINT)
        printed, _ = process.communicate(timeout=100)
    assert process.returncode == 130
    assert printed.startswith("interrupted after 1 runs; so far:\n")
    assert "succeeded" in printed
    left = [each for each in psutil.process_iter(["status"]) if _group(each.pid) == process.pid]
    assert not [each for each in left if each.info["status"] != psutil.STATUS_ZOMBIE], (
        "what has ended awaits its reaper"
    )


def _group(pid: int) -> int:
    try:
        return os.getpgid(pid)
    except ProcessLookupError:
        return 0
