"""Names that aren't UTF-8: of the plan's file, its folder and modules, arguments, threads, models and the environment."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import replay
from recorder.records import Mutation, Output, Run, Task
from replay.cli.main import main

REPO = Path(__file__).parent.parent
MILK = REPO / "resources" / "milk.stl"
PLAN = """
import importlib.util, os, sys, threading
from pathlib import Path
from pycram.bullet_world import BulletWorld, Object
from pycram.language import par

found = importlib.util.spec_from_file_location("mod\\udcff", Path(__file__).parent / os.fsdecode(b"module-\\xff.py"))
module = importlib.util.module_from_spec(found)
found.loader.exec_module(module)
print("given", ascii(sys.argv[1]), ascii(os.environ["WORD"]))
with BulletWorld() as world:
    milk = Object("milk", "milk", sys.argv[2])
    thread = threading.Thread(target=module.move, args=[milk], name=sys.argv[1])
    thread.start()
    thread.join()
    def move():
        milk.set_position([1, 0, 3])
    move.__name__ = move.__qualname__ = sys.argv[1]
    with par as s:
        s(move)
    raise ValueError(sys.argv[1])
"""
MODULE = """
def move(body):
    body.set_position([1, 0, 2])
"""


def run(folder: bytes, *words: bytes | str, **environment: bytes) -> subprocess.CompletedProcess[bytes]:
    kept = {os.fsencode(name): os.fsencode(value) for name, value in os.environ.items()}
    given = {name.encode(): value for name, value in environment.items()}
    command = [os.fsencode(word) for word in (sys.executable, "-m", *words)]
    return subprocess.run(
        command,
        cwd=folder,
        env=kept | {b"PYTHONPATH": os.fsencode(REPO), b"PYTHONUTF8": b"1"} | given,
        capture_output=True,
        timeout=100,
        check=False,
    )


@pytest.mark.slow
def test_a_plan_whose_names_are_not_utf_8_runs_is_recorded_and_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = os.fsencode(tmp_path) + b"/folder-\xff"
    Path(os.fsdecode(folder)).mkdir()
    for name, text in ((b"plan-\xff.py", PLAN), (b"module-\xff.py", MODULE)):
        Path(os.fsdecode(folder + b"/" + name)).write_text(text)
    shutil.copy(MILK, folder + b"/milk-\xff.stl")
    ended = run(folder, "pycram", "run", b"plan-\xff.py", "--", b"word-\xff", b"milk-\xff.stl", WORD=b"w\xff")
    assert ended.returncode == 1, ended.stderr
    assert b"the plan has an error: ValueError: word-\\udcff" in ended.stderr
    file = Path(os.fsdecode(folder + b"/plan-\xff.mcap"))
    with replay.open(file) as log:
        assert log.complete
        assert not log.problems
        began = log[0]
        assert isinstance(began, Run)
        assert (began.name, list(began.arguments)) == ("plan-\\udcff", ["word-\\udcff", "milk-\\udcff.stl"])
        assert began.directory.endswith("folder-\\udcff")
        lines = [record.text for record in log.records(Output)]
        assert "given 'word-\\udcff' 'w\\udcff'" in lines
        moves = [record for record in log.records(Mutation) if record.HasField("move_body")]
        assert [move.thread for move in moves] == ["word-\\udcff", "par-1 word-\\udcff"], "in a thread and a branch"
        assert Path(moves[0].source_file).name == "module-\\udcff.py"
        assert any(record.name == "word-\\udcff" for record in log.records(Task))
        sources = [name for name in log.assets if name.endswith(".py")]
        assert {name.partition("/")[2] for name in sources} == {"plan-\\udcff.py", "module-\\udcff.py"}
        (loaded,) = [record.load_body for record in log.records(Mutation) if record.HasField("load_body")]
        assert loaded.path.endswith("milk-\\udcff.stl")
    capsys.readouterr()
    for words in (
        ["info"],
        ["why"],
        ["tree"],
        ["log"],
        ["state", "last"],
        ["view", "--save", "x.rrd"],
        ["info", "--json"],
    ):
        verb, *options = words
        monkeypatch.chdir(tmp_path)
        assert main([verb, str(file), *options]) == 0
        said = capsys.readouterr()
        assert "Traceback" not in said.err
    assert json.loads(said.out)["file"].endswith("plan-\\udcff.mcap")
    assert main(["verify", str(file)]) == 0
