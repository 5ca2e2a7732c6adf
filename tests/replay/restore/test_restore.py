"""Restoring: scripts, shells and windows in the past."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.world.world import open_worlds
from recorder.records import Keyframe, Mutation
from replay.cli.main import main
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bowl falls at step 6; names are those of people, not of Python."""
    file = tmp_path_factory.mktemp("restore") / "run.mcap"
    with recorder.record(file), BulletWorld(name="lab") as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0.5])
        Object("big cup", "cup", "cup.stl", [1, 0, 0.5])
        world.simulate(0.1)
        world.simulate(0.5)
    return file


def restore(file: Path, *arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    """In a process of its own, as people call it."""
    command = [sys.executable, "-m", "replay", "restore", str(file), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100, **options)  # type: ignore[call-overload, no-any-return]


SCRIPT = """
import sys
assert __name__ == "__main__" and sys.argv == [__file__]
world.simulate(0.5)
print(bowl.get_position()[2], big_cup.name, objects["big cup"] is big_cup, robot, step, btr.contact(bowl, objects["floor"]))
print("trimesh" in sys.modules)
"""


@pytest.mark.slow
def test_a_script_finds_the_world_and_its_objects(log_file: Path, tmp_path: Path) -> None:
    script = tmp_path / "look.py"
    script.write_text(SCRIPT)
    before = sorted(tmp_path.iterdir())
    process = restore(log_file, "6", "--exact", "--script", str(script), cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    with replay.open(log_file) as log:
        end = log.state_at(7).body("bowl").position[2]
    said, slow = process.stdout.splitlines()
    assert said.split() == [repr(end), "big", "cup", "True", "None", "6", "True"]  # the original's future
    assert slow == "False", "a library that takes a second to import"
    assert sorted(tmp_path.iterdir()) == before  # nothing is recorded


@pytest.mark.parametrize(("text", "code"), [("1/0", 1), ("raise SystemExit(7)", 7), ("raise SystemExit", 0)])
def test_a_script_s_exit_code_is_the_verb_s(
    log_file: Path, tmp_path: Path, text: str, code: int, capfd: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "ends.py"
    script.write_text(text)
    assert main(["restore", str(log_file), "5", "--script", str(script)]) == code
    output = capfd.readouterr()
    assert ("ZeroDivisionError" in output.err) is (text == "1/0")
    assert not output.out
    assert not open_worlds()


def test_a_script_is_recorded_with_the_option_log(log_file: Path, tmp_path: Path) -> None:
    script, target = tmp_path / "s.py", tmp_path / "what_if.mcap"
    script.write_text("bowl.set_position([0, 0, 2]); world.simulate(0.1)")
    assert main(["restore", str(log_file), "5", "--script", str(script), "--log", str(target)]) == 0
    with replay.open(target) as log:
        kinds = [type(record) for record in log.records((Mutation, Keyframe))]
        assert kinds == [Keyframe, Mutation, Mutation]
        assert log.metadata["plan"] == "s"
        assert verify(log).sound


def test_a_session_cannot_overwrite_its_own_recording(
    log_file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = log_file.read_bytes()
    (tmp_path / "s.py").write_text("")
    (tmp_path / "link.mcap").symlink_to(log_file)
    for same in (log_file, tmp_path / "link.mcap"):
        assert main(["restore", str(log_file), "5", "--script", str(tmp_path / "s.py"), "--log", str(same)]) == 2
        assert "the recording itself" in capfd.readouterr().err
    assert log_file.read_bytes() == before


@pytest.mark.slow
def test_a_shell_runs_python(log_file: Path) -> None:
    process = restore(log_file, "5", "--shell", input="print(bowl.get_position())\n1/0\nworld.name\n")
    assert process.returncode == 0
    assert process.stdout == "[0.0, 0.0, 0.5]\n'lab@5'\n"
    assert "ZeroDivisionError" in process.stderr
    assert "big_cup" in process.stderr  # the banner says what there is


def test_restore_with_json_prints_the_objects(log_file: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["restore", str(log_file), "5", "--json"]) == 0
    data = json.loads(capfd.readouterr().out)
    assert data["objects"]["bowl"]["position"] == [0.0, 0.0, 0.5]
    assert (data["step"], data["world"], data["exact"]) == (5, "lab@5", False)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["last"], "no world is open any more"),
        (["5", "--world", "lap"], "did you mean lab"),
        (["5", "--script", "no_such.py"], "no such file"),
        (["5", "--gui"], "DISPLAY"),
        (["5", "--log", "/no/such/folder/x.mcap"], "folder"),
        (["99"], "steps 0 to"),
    ],
)
def test_wrong_usage_is_reported_on_stderr(
    log_file: Path,
    arguments: list[str],
    words: str,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    assert main(["restore", str(log_file), *arguments]) == 2
    output = capfd.readouterr()
    assert words in output.err
    assert not output.out
    assert not open_worlds()


@pytest.mark.costly
@pytest.mark.needs("Xvfb", "OpenGL")
@pytest.mark.slow
def test_a_window_stays_open_until_ctrl_c(log_file: Path, display: str) -> None:
    command = [sys.executable, "-m", "replay", "restore", str(log_file), "6", "--gui"]
    window = subprocess.Popen(
        command, env=os.environ | {"DISPLAY": display}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert window.stderr is not None
        line = ""
        while "close the window" not in line:
            line = window.stderr.readline()
            assert line, "it ended"
        window.send_signal(signal.SIGINT)
        out, _ = window.communicate(timeout=60)
    finally:
        window.kill()
    assert window.returncode == 130
    assert not out  # not even what the window's own thread says


@pytest.mark.costly
@pytest.mark.needs("Xvfb", "OpenGL")
@pytest.mark.slow
def test_a_script_can_have_a_window(log_file: Path, display: str, tmp_path: Path) -> None:
    script = tmp_path / "look.py"
    script.write_text("print(world.mode, bowl.get_position())")
    process = restore(log_file, "5", "--gui", "--script", str(script), env=os.environ | {"DISPLAY": display})
    assert process.stdout == "GUI [0.0, 0.0, 0.5]\n"
