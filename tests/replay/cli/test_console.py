"""What a recording tells reaches any terminal whole, and a terminal obeys nothing of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import recorder
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from recorder.tracing.span import span
from replay.cli.console import print_json, print_text, visible
from replay.cli.main import main

SPOON = "Löffel 🥄"
RED = "\x1b[31mred\x9b0m\r\x07\u202e"
VERBS = (
    "info", "log", "show 4", "tree", "state last", "diff 4 last", f"blame|{SPOON}", "why",
    f"ask|last|stable('{SPOON}')", "render|last|-o|{folder}/ö.png|--size|8x8", "verify", "restore last",
)  # fmt: skip
ASCII = """
import sys
from replay.cli.main import main
for line in sys.argv[2:]:
    verb, *rest = line.split("|") if "|" in line else line.split()
    print(main([verb, sys.argv[1], *rest, "--json"]), file=sys.stderr)
"""


@pytest.fixture
def strange(tmp_path: Path) -> Path:
    """A recording with letters that not every terminal has, and with what makes terminals do things."""
    file = tmp_path / "x.mcap"
    with pytest.raises(PlanFailure):
        fetch(file)
    BulletWorld.current_bullet_world.exit()
    return file


def fetch(file: Path) -> None:
    with recorder.record(file, name=f"plan {RED}"):
        BulletWorld(name="Küche")
        Object("floor", "environment", "plane.urdf")
        spoon = Object(SPOON, RED, "spoon.stl", [0, 0, 0.5])
        btr.stable(spoon)
        with span("motion", f"hole {RED}", {"was": spoon, "how": RED}):
            raise PlanFailure(f"kein {SPOON} {RED}")


def commands(folder: Path) -> list[list[str]]:
    calls = [verb.format(folder=folder) for verb in VERBS]
    return [line.split("|") if "|" in line else line.split() for line in calls]


@pytest.mark.slow
def test_json_is_complete_on_ascii_terminals(strange: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", ASCII, str(strange), *(verb.format(folder=tmp_path) for verb in VERBS)],
        env=os.environ | {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"},
        capture_output=True,
        check=True,
    )
    assert ended.stderr.decode("ascii").split() == ["0"] * len(VERBS)
    expected = []
    for verb, *rest in commands(tmp_path):
        assert main([verb, str(strange), *rest, "--json"]) == 0
        expected += capsys.readouterr().out.splitlines()
    given = ended.stdout.decode("ascii").splitlines()
    for one, other in zip(given, expected, strict=True):
        assert without_clock(json.loads(one)) == without_clock(json.loads(other))
    assert sum(SPOON in json.dumps(json.loads(line), ensure_ascii=False) for line in given) > len(VERBS) / 2


def without_clock(data: object) -> object:
    return {key: value for key, value in data.items() if key != "seconds"} if isinstance(data, dict) else data


def test_control_characters_of_recordings_are_escaped(
    strange: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = ""
    more = [["tree", "--dot"], ["tree", "--svg"], ["state", "last", RED], ["ask", "last", f"stable('{RED}')"]]
    for verb, *rest in [*commands(tmp_path), *more]:
        if verb != "restore":
            main([verb, str(strange), *rest])
            output = capsys.readouterr()
            printed += output.out + output.err
    assert not [letter for letter in printed if letter != "\n" and visible(letter) != letter]
    assert r"\x1b[31mred\x9b0m\x0d\x07\u202e" in printed
    assert SPOON in printed


def test_newlines_and_tabs_are_kept(capsys: pytest.CaptureFixture[str]) -> None:
    print_text("a\tb\nc é")
    assert capsys.readouterr().out == "a\tb\nc é\n"


def test_numbers_that_json_lacks_become_strings(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"x": [float("nan"), (float("-inf"), 1.5)], "y": "\x7f"})
    output = capsys.readouterr().out
    assert json.loads(output, parse_constant=pytest.fail) == {"x": ["nan", ["-inf", 1.5]], "y": "\x7f"}
    assert "\x7f" not in output


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb",
    [
        "show 4",
        *(pytest.param(verb, marks=pytest.mark.costly) for verb in ("info", "log", f"ask|last|stable('{SPOON}')")),
    ],
)
def test_a_closed_stdout_ends_without_a_traceback(strange: Path, verb: str) -> None:
    command = [sys.executable, "-m", "replay", *commands_of(verb, strange)]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr == "pycram-replay: [Errno 28] No space left on device\n"
    closed = subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *command], check=False)
    assert closed.returncode == 0


def commands_of(verb: str, file: Path) -> list[str]:
    name, *rest = verb.split("|") if "|" in verb else verb.split()
    return [name, str(file), *rest]
