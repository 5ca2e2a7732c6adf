"""A process' store is removed at its end, or by the next process if the process was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.models import store

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

REPO = Path(__file__).parent.parent.parent.parent
PROGRAM = """
import os, sys
from pycram.models import store
print(store.folder(), flush=True)
if sys.argv[1:] == ["forks"]:
    if not (child := os.fork()):
        sys.exit()
    os.waitpid(child, 0)
    print(store.folder().is_dir(), flush=True)
sys.stdin.read()
"""


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., tuple[subprocess.Popen[str], Path]]]:
    """Starts a process that has a store and waits for the end of its input."""
    started = []

    def start(*arguments: str) -> tuple[subprocess.Popen[str], Path]:
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(REPO), "TMPDIR": str(tmp_path)},
        )
        started.append(process)
        assert process.stdout is not None
        return process, Path(process.stdout.readline().strip())

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Path]:
    """Makes the store that this process would have, had it begun now."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return store.folder.__wrapped__


def test_the_store_of_a_killed_process_is_removed_by_the_next_process(
    start: Callable[..., tuple[subprocess.Popen[str], Path]], folder: Callable[[], Path]
) -> None:
    killed, abandoned = start()
    _, used = start()
    assert abandoned.is_dir(), "it was in use"
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    own = folder()
    assert not abandoned.exists()
    assert used.is_dir()
    assert folder() != own
    assert own.is_dir(), "this process has it, though it makes another"


def test_a_process_removes_its_store_but_its_fork_does_not(
    start: Callable[..., tuple[subprocess.Popen[str], Path]],
) -> None:
    process, used = start("forks")
    assert process.stdout is not None
    assert process.stdout.readline() == "True\n", "the child has ended"
    process.communicate()
    assert process.returncode == 0
    assert not used.exists()


def test_folders_that_are_not_our_stores_are_kept(
    tmp_path: Path, folder: Callable[[], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pycram-models-empty").mkdir()
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "lock").touch()
    (tmp_path / "pycram-models-link").symlink_to(precious)
    (tmp_path / "pycram-models-file").touch()
    folder()
    assert (precious / "lock").exists()
    theirs = tmp_path / "pycram-models-theirs"
    theirs.mkdir()
    (theirs / "lock").touch()
    monkeypatch.setattr(os, "getuid", lambda: theirs.stat().st_uid + 1)
    folder()
    assert (theirs / "lock").exists()
