"""What reading costs, on recordings of 10,000 and 1,000,000 records: ``make bench`` prints the table.

Ratios between the two are what counts: machines are noisy, and seconds are printed with their goals, not asserted.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from math import inf
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.recording import record
from recorder.records import (
    BodyState,
    Effect,
    Failure,
    Keyframe,
    LoadBody,
    MoveBody,
    Mutation,
    OpenWorld,
    Query,
    Run,
    Task,
)
from recorder.tracing import journal
from tests.benchmarks.timing import goal

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.slow

SMALL, LARGE = 10_000, 1_000_000
BODIES = 20

READER = """
import itertools, json, pathlib, random, statistics, sys, time
import replay

def took(action):
    start = time.perf_counter()
    action()
    return (time.perf_counter() - start) * 1e3

path, steps = sys.argv[1], int(sys.argv[2])
begin = time.perf_counter()
log = replay.open(path)
log.state_at(steps // 2)
first = (time.perf_counter() - begin) * 1e3
rng = random.Random(1)
for _ in range(50):
    log.state_at(rng.randrange(steps))  # warm
states = sorted(took(lambda: log.state_at(rng.randrange(steps))) for _ in range(400))
middle = steps // 2
forward = took(lambda: [None for record in log.records(start=middle, stop=middle + 5000)])
log = replay.open(path)
log.state_at(5)
backward = took(lambda: list(itertools.islice(log.backwards(middle), 5000)))
print(json.dumps({
    "first": first,
    "median": statistics.median(states),
    "p95": states[int(len(states) * 0.95)],
    "forward": forward,
    "backward": backward,
    # the peak of this process; getrusage would tell that of its parent, if it is larger
    "memory": int(pathlib.Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1e3,
}))
"""


def write(file: Path, count: int) -> None:
    """A long run: two worlds with 20 bodies each, moves and queries, keyframes as often as the executor makes them."""
    at = (0.0, 0.0, 0.0, 1.0)
    names = [f"body_{number}" for number in range(BODIES)]
    loaded = [LoadBody(body=name, type="box") for name in names]
    with record(file, name="long"):
        for world in ("a", "b"):
            journal.emit(Mutation(open_world=OpenWorld(mode="DIRECT")), world=world)
            for body in loaded:
                journal.emit(Mutation(load_body=body), world=world)
        changes = {"a": 0, "b": 0}
        for number in range(count - 2 * (BODIES + 1) - 2):
            world = "b" if number % 4 == 3 else "a"
            if changes[world] == 100:
                changes[world] = 0
                states = [BodyState(body=name, position=(number, 0, 0), orientation=at) for name in names]
                record_ = Keyframe(mode="DIRECT", loaded=loaded, bodies=states)
            elif number % 3 == 0:
                record_ = Query(name="contact", answer_json="true")
            else:
                changes[world] += 1
                name = names[number % BODIES]
                record_ = Mutation(
                    move_body=MoveBody(body=name, position=(number, 0, 0)),
                    effect=Effect(bodies=[BodyState(body=name, position=(number, 0, 0), orientation=at)]),
                )
            journal.emit(record_, world=world, sim_step=number)


def measured(file: Path, steps: int) -> dict[str, float]:
    """The best of three processes: what else the machine does only ever adds."""
    runs = []
    for _ in range(3):
        ended = subprocess.run([sys.executable, "-c", READER, str(file), str(steps)], capture_output=True, check=True)
        runs.append(json.loads(ended.stdout))
    return {name: min(run[name] for run in runs) for name in runs[0]}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("long")
    made = {count: folder / f"{count}.mcap" for count in (SMALL, LARGE)}
    for count, file in made.items():
        write(file, count)
    return made


@pytest.mark.long
def test_a_million_records_are_read_as_ten_thousand_are(files: dict[int, Path]) -> None:
    small, large = (measured(files[count], count) for count in (SMALL, LARGE))
    print(f"\n{'':32}{SMALL:>12}{LARGE:>12}")
    for name, text in (
        ("first", "open and first state, ms"),
        ("median", "state at a random step, ms"),
        ("p95", "the same, p95, ms"),
        ("forward", "5,000 records forwards, ms"),
        ("backward", "5,000 records backwards, ms"),
        ("memory", "memory of the process, MB"),
    ):
        print(f"{text:32}{small[name]:12.1f}{large[name]:12.1f}")
    goal("first state, ms", large["first"], 100, inf)
    goal("random state, p95, ms", large["p95"], 20, inf)
    goal("random state of the large one, of that of the small one", large["median"] / (small["median"] + 0.3), 1.5)
    goal("backwards, of forwards", large["backward"] / large["forward"], 1.5)
    assert large["memory"] < 200


EXPLAINER = """
import json, pathlib, sys, time
import replay

start = time.process_time()
with replay.open(sys.argv[1]) as log:
    why = log.why()
    assert why.failure.message == "gone"
used = int(pathlib.Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1e3
print(json.dumps({"seconds": time.process_time() - start, "memory": used}))
"""


def write_tasks(file: Path, count: int) -> None:
    """A long run of motions, each with its process module; the last one fails."""
    with record(file, name="long"):
        for number in range(1, count + 1, 2):
            error = Failure(type="PlanFailure", message="gone") if number >= count - 1 else None
            for phase, status in (
                (Task.STARTED, Task.RUNNING),
                (Task.FINISHED, Task.FAILED if error else Task.SUCCEEDED),
            ):
                parts = [("motion", "pick-up", number, 0), ("process-module", "PickUp", number + 1, number)]
                for kind, name, task, parent in parts if phase == Task.STARTED else reversed(parts):
                    failure = error if phase == Task.FINISHED else None
                    made = Task(phase=phase, status=status, kind=kind, name=name, parent=parent, failure=failure)
                    journal.emit(made, task=task)


@pytest.mark.long
def test_many_tasks_are_explained_in_the_memory_of_few(tmp_path: Path) -> None:
    used, many = {}, 10 * SMALL
    for count in (SMALL, many):
        file = tmp_path / f"{count}.mcap"
        write_tasks(file, count)
        ended = subprocess.run([sys.executable, "-c", EXPLAINER, str(file)], capture_output=True, check=True)
        used[count] = json.loads(ended.stdout)
        print(f"\nwhy of {count} tasks: {used[count]['seconds']:.2f} s of computing, {used[count]['memory']:.0f} MB")
    goal("ten times as many, in times", used[many]["seconds"] / used[SMALL]["seconds"], 12, 1.5)
    goal("their memory, in times", used[many]["memory"] / used[SMALL]["memory"], 1.5, 1.5)


VERB = """
import json, os, pathlib, sys, time
from replay.cli.main import main

sys.stdout = open(os.devnull, "w")
assert main(sys.argv[1:]) == 0
used = int(pathlib.Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1e3
print(json.dumps({"seconds": time.process_time(), "memory": used}), file=sys.stderr)
"""


@pytest.mark.long
def test_verbs_that_go_through_all_tasks_take_a_bounded_memory(tmp_path: Path) -> None:
    few, many = 6 * SMALL, 30 * SMALL
    for count in (few, many):
        write_tasks(tmp_path / f"{count}.mcap", count)
    for verb in (["info"], ["log"], ["tree"], ["tree", "--all"], ["tree", "--json"], ["why"]):
        used = {}
        for count in (few, many):
            command = [sys.executable, "-c", VERB, verb[0], str(tmp_path / f"{count}.mcap"), *verb[1:]]
            used[count] = json.loads(subprocess.run(command, stderr=subprocess.PIPE, check=True).stderr)
        print(f"\n{' '.join(verb)} of {many} tasks: {used[many]['seconds']:.1f} s, {used[many]['memory']:.0f} MB")
        goal("five times as many, in times", used[many]["seconds"] / used[few]["seconds"], 6, 1.5)
        assert used[many]["memory"] < 500


@pytest.mark.long
def test_info_from_the_shell(files: dict[int, Path]) -> None:
    for count, file in files.items():
        times, used = [], []
        for _ in range(5):
            start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, "-m", "replay", "info", str(file)], capture_output=True, check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            times.append(time.perf_counter() - start)
            used.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        print(f"\ninfo of {count} records from the shell: {min(times):.2f} s, {min(used):.2f} s of them computing")
        goal("info, s of computing", min(used), 0.5, inf)
    with replay.open(files[LARGE]) as log:
        assert len(log) == LARGE
        assert isinstance(log[-1], Run)
