"""Every reading verb works where neither the engine nor the viewer is installed.

Here, what the extras bring is hidden from the commands. ``make test-reading`` runs this file where it isn't installed: so
it imports nothing but what reading needs, and has no fixtures of others. ``PYCRAM_RECORDINGS`` names a folder with more
recordings to read, such as those of the demos, which can't be made there.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from collections.abc import Sequence

HERE = Path(__file__).parents[1]
REPO = HERE.parents[1]
EXTRAS = (
    "greenlet",
    "pybullet",
    "pybullet_data",
    "trimesh",
    "scipy",
    "collada",
    "PIL",
    "rerun",
    "rerun_cli",
    "rerun_sdk",
    "pyarrow",
)
LOGS = [
    *sorted((HERE / "golden").glob("*.mcap")),
    *sorted(Path(os.environ.get("PYCRAM_RECORDINGS", os.devnull)).glob("*.mcap")),
]
READING = [
    ("info",),
    ("log",),
    ("show", "last"),
    ("tree",),
    ("state", "last"),
    ("diff", "8", "last"),
    ("blame", "milk"),
    ("why",),
    ("check", "eventually milk.z > 0"),
    ("verify", "--static"),
]
HIDING = """
import sys

hidden = sys.argv[2:]

class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hidden())
"""
CALLING = """
import contextlib, io, json, sys
from importlib import import_module

for module, *words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = import_module(module).main(words)
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""


class Ended(NamedTuple):
    """What a command has said."""

    code: int
    out: str
    err: str


def run(*calls: Sequence[str], hidden: Sequence[str] = EXTRAS) -> list[Ended]:
    """Runs commands in a process of their own, in which what the extras bring isn't found.

    Args:
        calls: of each the module and the words.
        hidden: the modules that it doesn't find.
    """
    command = [sys.executable, "-c", HIDING + CALLING, json.dumps(calls), *hidden]
    environment = os.environ | {"PYTHONPATH": str(REPO)}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return [Ended(*json.loads(line)) for line in ended.stdout.splitlines()]


def replay(verb: str, log: Path, *words: str) -> tuple[str, ...]:
    return ("replay.cli.main", verb, str(log), *words)


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS, ids=lambda log: log.stem)
def test_reading_verbs(log: Path) -> None:
    calls = [replay(verb, log, *words, *more) for verb, *words in READING for more in ((), ("--json",))]
    for call, printed in zip(calls, run(*calls), strict=True):
        assert printed.code == 0, (call, printed.err)
        assert printed.out, call
        assert not printed.err, call


@pytest.mark.slow  # `make test-reading` leaves it out: where only the base is installed, there is nothing to compare with
def test_they_say_the_same_as_where_all_is_installed() -> None:
    calls = [replay(verb, LOGS[0], *words) for verb, *words in READING]
    assert run(*calls) == run(*calls, hidden=())


@pytest.mark.slow
def test_other_commands_say_what_to_install(tmp_path: Path) -> None:
    calls = {
        replay("ask", LOGS[0], "last", "stable(milk)"): ("pycram-replay: ask: ", "executor"),
        replay("render", LOGS[0], "last", "-o", str(tmp_path / "moment.png")): ("pycram-replay: render: ", "render"),
        replay("check", LOGS[0], "never contact(milk, cabinet)"): ("pycram-replay: check: ", "executor"),
        replay("verify", LOGS[0]): ("pycram-replay: verify: ", "executor"),
        replay("restore", LOGS[0], "last", "--shell"): ("pycram-replay: restore: ", "executor"),
        replay("render", LOGS[0], "last", "-o", str(tmp_path / "x.png")): ("pycram-replay: render: ", "render"),
        replay("view", LOGS[0], "--save", str(tmp_path / "log.rrd")): ("pycram-replay: view: ", "viewer"),
        ("pycram.cli", "demo", "--log", str(tmp_path / "demo.mcap")): ("pycram: ", "executor"),
    }
    for (begin, extra), printed in zip(calls.values(), run(*calls), strict=True):
        assert printed.code == 2
        assert not printed.out
        (line,) = printed.err.splitlines()
        assert line.startswith(begin)
        assert line.endswith(f" isn't installed; in a checkout of PyCRAM: pip install '.[{extra}]'")


@pytest.mark.costly
@pytest.mark.slow  # `make test-reading` leaves it out: it has nothing to open folders with
def test_of_folders_too(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    runs.mkdir()
    for log in LOGS:
        (runs / log.name).symlink_to(log)
    engine, drawing = ("greenlet", "pybullet", "pybullet_data", "scipy", "ompl", "toppra"), ("trimesh", "collada")
    sheet, out = str(tmp_path / "sheet.png"), str(tmp_path / "set")
    calls = {
        replay("stats", runs, "--picture", sheet): ((*engine, *drawing), "stats", "render"),
        replay("stats", runs, "--html", sheet): ((*engine, "PIL"), "stats", "render"),
        replay("view", runs, "--save", out): (("rerun", "rerun_cli", "rerun_sdk"), "view", "viewer"),
        replay("export", runs, "--to", "lerobot", out, "--images"): (("av",), "export", "video"),
        replay("sql", runs, "select 1"): (("duckdb",), "sql", "runs"),
        replay("test", LOGS[0], "-o", out): (("pytest",), "test", "test"),
    }
    for call, (hidden, verb, extra) in calls.items():
        (printed,) = run(call, hidden=hidden)
        assert printed.code == 2, printed.out
        assert printed.err.startswith(f"pycram-replay: {verb}: ")
        assert printed.err.endswith(f" isn't installed; in a checkout of PyCRAM: pip install '.[{extra}]'\n")
    (drawn,) = run(replay("stats", runs, "--picture", sheet), hidden=engine)
    assert Path(sheet).stat().st_size > 5000, drawn.err


def test_a_damaged_recording_is_repaired(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(LOGS[0].read_bytes()[:-20_000])
    repaired, verified = run(replay("repair", cut), replay("verify", tmp_path / "cut.sound.mcap", "--static"))
    assert repaired.code == 3, repaired.err
    assert verified.code == 0, verified.err
    assert verified.out.startswith("sound ")


def test_the_version_is_printed() -> None:
    for name, printed in zip(
        ("pycram-replay", "pycram"), run(("replay.cli.main", "--version"), ("pycram.cli", "--version")), strict=True
    ):
        assert printed.code == 0
        assert printed.out.startswith(f"{name} 0.")
        assert not printed.err
