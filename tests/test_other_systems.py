"""A system without forks, locks and owners of files, as Windows is: plans run and are recorded there, and read again."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pycram.bullet_world import BulletWorld
from pycram.projection import NotProjectable, child, project_all
from pycram.sweeping import SweepRefused, sweep

REPO = Path(__file__).parents[1]
#: Hides what Python has on no Windows, after its own modules and those of other packages are loaded, which adapt.
HIDING = """
import asyncio, ctypes, importlib, multiprocessing.connection, os, pkgutil, pty, runpy, signal, socket, sqlite3, sys
import duckdb, greenlet, numpy, PIL.Image, pyarrow.parquet, pybullet, rerun, rich.progress, scipy.spatial, tempfile, trimesh
import uuid, email.parser, http.server, shutil, readline

for name in ("fcntl", "resource", "pty", "termios", "grp", "pwd", "tty", "readline"):
    sys.modules[name] = None
for module, names in {
    os: '''fork forkpty register_at_fork getuid geteuid getgid setsid nice pread sched_getaffinity waitid
        fdatasync mkfifo O_CLOEXEC O_NOFOLLOW O_NONBLOCK O_DIRECTORY set_blocking killpg statvfs
        uname posix_spawn''',
    signal: "SIGHUP SIGKILL SIGURG SIGUSR1 SIGCHLD SIGALRM SIGPIPE pthread_sigmask setitimer alarm",
    socket: "AF_UNIX",
}.items():
    for name in names.split():
        vars(module).pop(name, None)
loaded = ctypes.CDLL
def named(name, *args, **kwargs):
    if name is None:
        raise TypeError("bad argument type")
    return loaded(name, *args, **kwargs)
ctypes.CDLL = named
"""
IMPORTS = """
for package in ("recorder", "replay", "pycram"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.name.endswith("__main__") and "demos" not in module.name:
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                if type(error).__name__ != "NotInstalled":  # an extra that these tests don't need
                    raise
            print(module.name)
"""
COMMAND = "sys.argv = sys.argv[1:]; runpy.run_module(sys.argv[0], run_name='__main__')"
#: Runs commands in one process, as to start it takes longer than they do; prints the exit code and output of each.
COMMANDS = """
import contextlib, io, json
ended = []
for sys.argv in json.loads(sys.argv[1]):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            runpy.run_module(sys.argv[0], run_name="__main__")
        except SystemExit as end:
            ended.append((end.code, printed.getvalue()))
print(json.dumps(ended))
"""


def run(code: str, *arguments: object, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", HIDING + code, *map(str, arguments)]
    # With a temporary folder of its own: processes that have locks take one without a lock for dead, and tidy up.
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(REPO), "TMPDIR": str(temporary)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.costly
@pytest.mark.slow
def test_every_module_can_be_imported(tmp_path: Path) -> None:
    ended = run(IMPORTS, folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert {"recorder.mcap_sink", "replay.debug.stopped_plan", "pycram.sweeping"} <= set(ended.stdout.split())


@pytest.mark.costly
def test_plans_are_recorded_and_read_and_what_needs_forks_is_refused_by_name(tmp_path: Path) -> None:
    plan = str(REPO / "demos/fails_to_reach.py")
    (tmp_path / "projects.py").write_text(
        "from pycram.bullet_world import BulletWorld\nfrom pycram.projection import project\n"
        "with BulletWorld():\n    print(project(lambda: None))\n"
    )
    commands = [
        ["pycram", "run", plan, "--log", "run.mcap"],
        ["replay", "why", "run.mcap"],
        ["replay", "verify", "run.mcap"],
        ["replay", "retrace", "run.mcap"],
        ["replay", "debug", "run.mcap", "20"],
        ["pycram", "sweep", plan, "--runs", "2", "--out", "runs"],
        ["pycram", "run", "projects.py"],
    ]
    process = run(COMMANDS, json.dumps(commands), folder=tmp_path)
    assert process.returncode == 0, process.stderr
    assert not re.search("AttributeError|ImportError|ModuleNotFound", process.stdout + process.stderr), process.stdout
    ended = json.loads(process.stdout)
    assert [code for code, _ in ended] == [1, 0, 0, 2, 2, 2, 1], ended
    printed = [text for _, text in ended]
    assert all("os.fork" in text for text in printed[3:6]), printed
    refused = "NotProjectable: an action can't be projected here: this system can't copy a process (os.fork)"
    assert refused in printed[6]
    (tmp_path / "live.py").write_text(
        "import recorder\nfrom pycram.bullet_world import BulletWorld\n"
        "with recorder.record('live.mcap', live='serve'), BulletWorld():\n    pass\n"
    )
    process = run(COMMAND, "live", folder=tmp_path)
    assert process.returncode == 1
    assert "RecordingError: can't record to serve: this system can't pass an open pipe" in process.stderr


def test_memory_is_limited_on_linux_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "_SIZE", str(tmp_path / "missing"))
    with pytest.raises(SweepRefused, match="can't limit the memory of a run"):
        sweep(REPO / "demos/set_the_table.py", 1, tmp_path / "runs", memory=10**9)
    with BulletWorld(), pytest.raises(NotProjectable, match="can't limit the memory"):
        project_all([(lambda: None,)], memory=1000)
