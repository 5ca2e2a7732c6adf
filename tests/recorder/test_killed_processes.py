"""kill -9 at any moment, or a full disk: the file opens, few records are missing, and none before a failure."""

from __future__ import annotations

import contextlib
import inspect
import itertools
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.physics import engine
from recorder.records import Run, Task
from tests.measures import REPO, seeded

if TYPE_CHECKING:
    from collections.abc import Callable


def waited(process: int) -> int:
    """How long the threads of a process were ready to run, but had no processor, in ns; 0 where Linux doesn't tell."""
    total = 0
    for thread in Path(f"/proc/{process}/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended
            total += int((thread / "schedstat").read_text().split()[1])
    return total


# Writes records as a plan would, in bursts and alone, and prints after each its step, the time, and how long its threads
# were ready to run until then, but had no processor.
VICTIM = f"""
import contextlib, os, sys, random, threading, time
from pathlib import Path
import recorder
from recorder.tracing import journal
from recorder.records import Event, Failure, Task
{inspect.getsource(waited)}
rng = random.Random(int(sys.argv[2]))
def tell(kind):
    os.write(1, b"%s%d %d %d\\n" % (kind, recording.length - 1, time.time_ns(), waited(os.getpid())))
pause = threading.Event()
with recorder.record(sys.argv[1]) as recording:
    while True:
        for _ in range(rng.choice([1, 3, 40, 200])):
            if rng.random() < 0.02:
                journal.emit(Task(phase=Task.FINISHED, status=Task.FAILED, failure=Failure(type="Unreachable")))
                tell(b"F")
            else:
                journal.emit(Event(name="tick", sender="x" * rng.randrange(400)))
                tell(b"E")
        pause.wait(rng.choice([0, 0.001, 0.03]))
"""


# Runs a demo, and prints the same after each of its records.
DEMO = f"""
import contextlib, os, sys, time
from pathlib import Path
from pycram import cli
from recorder.mcap_sink import McapSink
from recorder.records import Task
{inspect.getsource(waited)}
write, tell = McapSink.write, os.dup(1)
def told(self, topic, record, payload):
    write(self, topic, record, payload)
    failed = isinstance(record, Task) and record.status in (Task.FAILED, Task.CANCELLED)
    os.write(tell, b"%s%d %d %d\\n" % (b"F" if failed else b"E", record.seq, time.time_ns(), waited(os.getpid())))
McapSink.write = told
os.dup2(2, 1)
cli.main(["run", sys.argv[3], "--log", sys.argv[1], "--seed", "1"])
"""
RECORDS = {"fails_to_reach": 166, "set_the_table": 340}  # of the demos, about


# Prints how often Python had something to tell of itself (imports, files) while the file was there, and empty.
WATCHED = """
import os, sys
import recorder
empty = 0
def look(*_):
    global empty
    try:
        empty += not os.stat(sys.argv[1]).st_size
    except OSError:
        pass
sys.addaudithook(look)
with recorder.record(sys.argv[1]):
    print(empty)
"""


def test_a_file_is_empty_for_no_longer_than_it_takes_to_open_it(tmp_path: Path) -> None:
    """What takes time is done before: 25 ms in which a killed process would leave a file that doesn't open."""
    command = [sys.executable, "-c", WATCHED, str(tmp_path / "x.mcap")]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(ended.stdout) < 5


def kill_at_random(file: Path, seed: int, rng: random.Random) -> tuple[list[tuple[str, int, int, int]], int, int]:
    """Kills a process; returns its lines, when that was, and how long its threads had waited for a processor by then."""
    victim = subprocess.Popen([sys.executable, "-c", VICTIM, str(file), str(seed)], stdout=subprocess.PIPE)
    assert victim.stdout is not None
    lines = [victim.stdout.readline()]
    deadline = time.monotonic() + rng.uniform(0.0, 0.4)
    while time.monotonic() < deadline:
        lines.append(victim.stdout.readline())
    return stopped_and_killed(victim, lines)


def kill_demo(file: Path, seed: int, rng: random.Random) -> tuple[list[tuple[str, int, int, int]], int, int]:
    """Kill a demo at random, every second time while it is ending; return the same as :func:`kill_at_random`."""
    demo = sorted(RECORDS)[seed % 4 // 2]
    command = [sys.executable, "-c", DEMO, str(file), str(seed), str(REPO / "demos" / f"{demo}.py")]
    victim = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
    assert victim.stdout is not None
    number = rng.randrange(RECORDS[demo] - 15 if seed % 2 else 1, RECORDS[demo])
    lines = list(itertools.islice(victim.stdout, number))
    time.sleep(
        rng.uniform(0, 0.03 if seed % 2 else 0.08)
    )  # the moment is random; the killed process itself reported the figures
    return stopped_and_killed(victim, lines)


def stopped_and_killed(
    victim: subprocess.Popen[bytes], lines: list[bytes]
) -> tuple[list[tuple[str, int, int, int]], int, int]:
    assert victim.stdout is not None
    os.kill(victim.pid, signal.SIGSTOP)  # nothing of it runs any more, so that it can be looked at before it is killed
    killed = time.time_ns()
    stopped = os.WIFSTOPPED(os.waitpid(victim.pid, os.WUNTRACED)[1])  # else it has ended
    late = waited(victim.pid) - (time.time_ns() - killed) if stopped else 0
    victim.kill()
    lines += victim.stdout.readlines()
    victim.wait()
    victim.stdout.close()
    complete = [line.split() for line in lines if line.endswith(b"\n")]
    return [(word[:1].decode(), int(word[1:]), int(when), int(waits)) for word, when, waits in complete], killed, late


@seeded("killed processes", range(50), 5)
def test_a_killed_process_loses_at_most_50_records_and_no_failure(
    tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    check_losses(kill_at_random, tmp_path, seeds, record_property)


@seeded("killed demos", range(50), 4)
def test_a_killed_demo_loses_at_most_50_records_and_no_failure(
    tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    check_losses(kill_demo, tmp_path, seeds, record_property)


def check_losses(
    kill: Callable[..., tuple[list[tuple[str, int, int, int]], int, int]],
    tmp_path: Path,
    seeds: range,
    record_property: Callable[[str, object], None],
) -> None:
    rng = random.Random(seeds[0])
    most_records = 0
    ages: list[float] = []  # of the oldest record that is lost, in ms
    own_ages: list[float] = []  # without what the process waited for a processor
    for seed in seeds:
        file = tmp_path / f"{seed}.mcap"
        written, killed, late = kill(file, seed, rng)
        with replay.open(file) as log:
            kept = len(log)
            assert [record.seq for record in log] == list(range(kept))
            if not log.complete:  # else it was closed just before
                assert "not closed" in log.problems
            lost = [(kind, when, waits) for kind, seq, when, waits in written if seq >= kept]
            assert not [kind for kind, _, _ in lost if kind == "F"], "a recorded failure is missing"
            failures = sum(1 for kind, seq, *_ in written if kind == "F" and seq < kept)
            assert sum(1 for record in log.records(Task) if record.status == Task.FAILED) >= failures
        most_records = max(most_records, len(lost))
        if lost:
            _, when, waits = lost[0]
            ages.append((killed - when) / 1e6)
            # where others have the processors, nobody can write: what counts is the time in which it could have run
            own_ages.append(ages[-1] - max(late - waits, 0) / 1e6)
    figures = f"oldest of them {max(ages, default=0):.0f} ms, {max(own_ages, default=0):.0f} ms of its own"
    print(f"\nmost records lost: {most_records}, {figures}")
    assert most_records <= 50
    record_property("killed", len(seeds))
    record_property("older than 100 ms by the clock", sum(age > 100 for age in ages))
    assert max(own_ages, default=0) <= 100


@pytest.mark.slow
def test_a_process_that_is_killed_at_once_leaves_a_readable_file(tmp_path: Path) -> None:
    file = tmp_path / "short.mcap"
    program = """
import os, signal, sys
import recorder
with recorder.record(sys.argv[1]):
    os.kill(os.getpid(), signal.SIGKILL)
"""
    ended = subprocess.run([sys.executable, "-c", program, str(file)], check=False)
    assert ended.returncode == -signal.SIGKILL
    with replay.open(file) as log:
        assert [type(record) for record in log] == [Run]
        assert not log.complete


def output(program: str, file: Path, status: int = 0) -> str:
    command = [sys.executable, "-c", program, str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == status, ended.stderr
    return ended.stdout


def test_nothing_waits_while_the_engine_loads_a_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It keeps all other threads from running for up to 90 ms, also that which writes the file."""
    file, load = tmp_path / "x.mcap", engine.bullet.loadURDF
    kept: list[int] = []

    def looking(*arguments: object, **options: object) -> object:
        with replay.open(file) as log:
            kept.append(len(log))
        return load(*arguments, **options)

    with recorder.record(file, source=__file__) as recording, BulletWorld() as world:
        monkeypatch.setattr(engine.bullet, "loadURDF", looking)
        before = recording.length
        Object("milk", "milk", "milk.stl", world=world)
    assert kept == [before]


@pytest.mark.slow
def test_a_full_disk_ends_the_plan_with_an_error_and_leaves_a_readable_file(tmp_path: Path) -> None:
    program = """
import resource, signal, sys
import recorder
from recorder.tracing import journal
from recorder.records import Event
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
try:
    with recorder.record(sys.argv[1]) as recording:
        for number in range(100_000):
            journal.emit(Event(name="tick", sender=str(hash((number, "x"))) * 40))
except recorder.RecordingError as error:
    print(number, error)
    sys.exit(7)
"""
    number, message = output(program, tmp_path / "x.mcap", status=7).split(maxsplit=1)
    assert int(number) < 99_999
    assert "x.mcap" in message
    assert "File too large" in message
    with replay.open(tmp_path / "x.mcap") as log:
        assert len(log) > int(number) - 60


@pytest.mark.slow
def test_a_recording_that_fails_to_begin_leaves_no_thread_and_no_open_journal(tmp_path: Path) -> None:
    program = """
import resource, signal, sys, threading
import recorder
from pycram.bullet_world import BulletWorld, Object
world = BulletWorld()
Object("pr2", "robot", "pr2.urdf")
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY))
try:
    with recorder.record(sys.argv[1]):
        print("began")
except recorder.RecordingError as error:
    print("refused")
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
print([thread.name for thread in threading.enumerate()])
world.set_gravity([0, 0, -9.8])  # unrecorded, and nobody minds
with recorder.record(sys.argv[1], overwrite=True) as recording:
    Object("milk", "milk", "milk.stl")
print(recording.length)
"""
    assert output(program, tmp_path / "x.mcap").splitlines() == ["refused", "['MainThread']", "4"]
    with replay.open(tmp_path / "x.mcap") as log:
        assert len(log) == 4
