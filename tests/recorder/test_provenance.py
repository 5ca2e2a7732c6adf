"""The origin of a run in its recording: arguments, directory, seeds, revisions of plan and PyCRAM, computer."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from hashlib import sha256
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder import provenance
from recorder.records import Run, Task
from recorder.records.values import LEFT_OUT, is_secret, without_secrets
from recorder.tracing.span import span
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path


def start_of(file: Path) -> Run:
    with replay.open(file) as log:
        first = log[0]
        assert isinstance(first, Run)
        return first


def git(folder: Path, *words: str) -> str:
    config = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    return subprocess.run(["git", *config, *words], cwd=folder, check=True, capture_output=True, text=True).stdout


def recorded(file: Path, plan: Path) -> Run:
    provenance._plan_revision.cache_clear()  # as a new process has it
    with recorder.record(file, source=plan, overwrite=True):
        pass
    return start_of(file)


def test_a_program_s_arguments_directory_and_computer_are_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["plan.py", "--arm", "left", "--api-key=s3cret", "--token", "abc"])
    monkeypatch.setenv("PYTHONHASHSEED", "random")
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "x.mcap"
    with recorder.record(file):
        pass
    start = start_of(file)
    assert list(start.arguments) == ["--arm", "left", f"--api-key={LEFT_OUT}", "--token", LEFT_OUT]
    assert start.directory == str(tmp_path)
    assert not start.seed
    assert start.hash_seed == ("random" if sys.flags.hash_randomization else "0")
    assert start.host == platform.node()
    assert start.cpu
    content = file.read_bytes()
    assert b"s3cret" not in content
    assert main(["info", str(file)]) == 0
    shown = {line[:12].strip(): line[13:] for line in capsys.readouterr().out.splitlines()}
    assert shown["directory"] == str(tmp_path)
    assert shown["seed"].startswith("unknown")
    assert start.cpu in shown["computer"]
    assert start.pycram.sha256[:12] in shown["revision"] or start.pycram.commit[:12] in shown["revision"]


def test_a_seed_that_is_given_is_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, seed=0):
        pass
    assert start_of(file).seed == "0"
    assert main(["info", str(file)]) == 0
    assert "\nseed         0" in capsys.readouterr().out


@pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")
def test_a_plan_s_revision_is_its_commit_and_whether_it_was_changed_since(tmp_path: Path) -> None:
    plan, file = tmp_path / "repo" / "plan.py", tmp_path / "x.mcap"
    plan.parent.mkdir()
    plan.write_text("pass\n")
    digest = sha256(plan.read_bytes()).hexdigest()
    outside = recorded(file, plan).plan
    assert (outside.commit, outside.modified, outside.sha256) == ("", False, digest)
    git(plan.parent, "init", "-q")
    assert recorded(file, plan).plan.commit == ""  # it isn't in that repository yet
    git(plan.parent, "add", "plan.py")
    git(plan.parent, "commit", "-q", "-m", "plan")
    head = git(plan.parent, "rev-parse", "HEAD").strip()
    clean = recorded(file, plan).plan
    assert (clean.commit, clean.modified) == (head, False)
    (plan.parent / "other.txt").write_text("new, and not the repository's")
    assert not recorded(file, plan).plan.modified
    plan.write_text("print()\n")
    changed = recorded(file, plan).plan
    assert (changed.commit, changed.modified) == (head, True)
    assert changed.sha256 == sha256(b"print()\n").hexdigest()


def test_without_git_there_is_the_hash_of_the_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text("pass\n")
    monkeypatch.setenv("PATH", str(tmp_path))
    provenance.pycram_revision.cache_clear()
    try:
        start = recorded(tmp_path / "x.mcap", plan)
        assert (start.plan.commit, start.plan.sha256) == ("", sha256(b"pass\n").hexdigest())
        assert start.pycram.commit == ""
        assert len(start.pycram.sha256) == 64
    finally:
        provenance.pycram_revision.cache_clear()


@pytest.mark.parametrize(
    ("name", "secret"),
    [
        *[
            (name, True)
            for name in ("password", "api_key", "apiKey", "API-KEY", "--auth-token", "dbCredentials", "PWD")
        ],
        *[(name, False) for name in ("keyframe", "monkey", "passing", "arm", "tokenizer", "secretary", "")],
    ],
)
def test_names_that_say_that_a_value_is_secret(name: str, secret: bool) -> None:
    assert is_secret(name) is secret


def test_values_of_secret_options_are_left_out_of_a_command_line() -> None:
    given = ["--token", "--fast", "--password", "x", "y", "key=5", "token"]
    assert without_secrets(given) == ["--token", "--fast", "--password", LEFT_OUT, "y", f"key={LEFT_OUT}", "token"]


def test_secret_slots_of_a_designator_are_left_out(tmp_path: Path) -> None:
    file, secret = tmp_path / "x.mcap", "hunter" + str(2)  # in no source
    with recorder.record(file), span("motion", "unlock", {"door": "front", "secret_token": secret}):
        pass
    with replay.open(file) as log:
        started = next(log.records(Task))
        assert {each.name: each.json for each in started.parameters} == {
            "door": '"front"',
            "secret_token": f'"{LEFT_OUT}"',
        }
    assert secret.encode() not in file.read_bytes()
