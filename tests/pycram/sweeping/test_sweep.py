"""A plan runs many times: what is on record of each run, and what faults of runs cost."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import pycram
import recorder
from pycram.bullet_world import BulletWorld
from pycram.cli import main as pycram_command
from pycram.failures import BadArgument, UsageError
from pycram.plan_parameters import Variations
from pycram.sweeping import RunOutcome, Sweep, SweepRefused
from recorder.records import Mutation, Run
from replay.recording import Recording
from replay.restore.verify import verify
from replay.retrace.retrace import retrace

if TYPE_CHECKING:
    from collections.abc import Callable

PLAN = """
import os, random, signal, time
from pathlib import Path
import pycram
import recorder
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import seq

given = pycram.parameters(x=0.5, what="fine", marks="")

def put() -> None:
    cup = Object("cup", "cup", "cup.stl", [given.x, random.random(), 1])
    if given.what == "fails":
        raise PlanFailure(f"the cup is at {given.x}")
    if given.what == "takes all memory":
        blocks = [bytearray(1 << 28) for _ in range(40)]
    if given.what == "hangs":
        while True:
            time.sleep(0.01)
    for _ in range(60):  # more than a chunk
        cup.set_color([1, 0, 0, 1])
    once = Path(given.marks, "once")
    if given.what == "dies" or (given.what == "dies once" and not once.exists()):
        if given.what == "dies once":
            once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if given.what == "is deaf":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(0.01)

with BulletWorld():
    with seq as s:
        s(put)
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    file = tmp_path / "plan.py"
    file.write_text(PLAN)
    return file


def recordings(folder: Path) -> list[Path]:
    return sorted(each for each in folder.glob("[0-9]*.mcap"))


def ends(file: Path) -> tuple[Run, Run]:
    with Recording(file) as log:
        first, last = log[0], log[-1]
    assert isinstance(first, Run)
    assert isinstance(last, Run)
    return first, last


def command(*words: object, cwd: Path, **more: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pycram", *map(str, words)],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(Path(pycram.__file__).parents[1])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


# --- what is on record ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_run_is_a_whole_recording_with_its_seed_and_parameters(plan: Path, tmp_path: Path) -> None:
    result = pycram.sweep(
        plan, 4, tmp_path / "runs", seed=7, set={"x": [0.25, 2]}, sample={"what": "choice(fine,well)"}
    )
    assert (result.done, result.failed, result.before) == (4, 0, 0)
    files = recordings(tmp_path / "runs")
    assert [file.name.partition(",")[0] for file in files] == [f"{n:05}.x={x}" for n, x in enumerate(("0.25", "2") * 2)]
    places = set()
    for number, file in enumerate(files):
        began, ended = ends(file)
        assert ended.succeeded
        assert (began.seed, began.sweep.number, began.sweep.seed, began.sweep.attempt) == (
            str(7 + number),
            number,
            7,
            1,
        )
        given = {each.name: json.loads(each.value_json) for each in began.parameters}
        assert given["x"] == (0.25, 2)[number % 2]
        assert given["what"] in ("fine", "well")
        with Recording(file) as log:
            assert verify(log).problem is None
            cup = log.state_at(log.final_step()).world().bodies["cup"]
            assert cup.position[0] == given["x"]
            places.add(cup.position[1])
    assert len(places) == 4  # each run has random numbers of its own
    with Recording(files[3]) as log:  # and does the same again, with the same parameters
        assert retrace(log).difference is None
    assert not list((tmp_path / "runs").glob(".*"))


@pytest.mark.slow
def test_main_gets_its_arguments(tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(
        "def main(side: str = 'left', count: int = 1) -> None:\n    print(side * count)\n\nif __name__ == '__main__':\n    main()\n"
    )
    pycram.sweep(plan, 2, tmp_path / "runs", set={"side": ["right", "up"], "count": [2]})
    printed = []
    for file in recordings(tmp_path / "runs"):
        with Recording(file) as log:
            printed += [record.text for record in log.records("output")]
    assert printed == ["rightright", "upup"]


@pytest.mark.slow
def test_projections_lie_beside_their_runs(tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(
        "from pycram.bullet_world import BulletWorld, Object\nfrom pycram.projection import project\n"
        "with BulletWorld():\n    cup = Object('cup', 'cup', 'cup.stl')\n"
        "    assert project(cup.set_position, [1, 0, 1]).succeeded\n"
    )
    assert pycram.sweep(plan, 2, tmp_path / "runs").failed == 0
    names = ["00000.mcap", "00000.projection-1.mcap", "00001.mcap", "00001.projection-1.mcap"]
    assert [file.name for file in recordings(tmp_path / "runs")] == names
    assert not list((tmp_path / "runs").glob(".*"))
    with Recording(tmp_path / "runs" / "00001.mcap") as log:
        assert retrace(log).difference is None


@pytest.mark.slow
def test_a_run_begins_anew_whatever_its_process_did_before(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "before.mcap"), BulletWorld():
        pass
    plan = tmp_path / "plan.py"
    plan.write_text("from pycram.bullet_world import BulletWorld\nwith BulletWorld():\n    pass\n")
    pycram.sweep(plan, 2, tmp_path / "runs")
    for file in recordings(tmp_path / "runs"):
        with Recording(file) as log:
            assert next(each.number for each in log.records(Run)) == 1
            opened = next(each for each in log.records(Mutation) if each.WhichOneof("command") == "open_world")
            assert opened.world == "world_1"


def test_what_a_run_draws_depends_on_seed_and_number_only() -> None:
    few = Variations({"a": [1, 2], "b": ["x", "y", "z"]}, {"c": "uniform(0, 1)"})
    more = Variations({"a": [1, 2], "b": ["x", "y", "z"]}, {"d": "integers(1, 6)", "c": "uniform(0, 1)"})
    drawn = [few.of(3, number) for number in range(12)]
    assert {(each["a"], each["b"]) for each in drawn[:6]} == {(a, b) for a in (1, 2) for b in "xyz"}
    assert [each["c"] for each in drawn] == [more.of(3, number)["c"] for number in range(12)]
    assert drawn[0]["c"] != few.of(4, 0)["c"]
    assert {more.of(0, number)["d"] for number in range(200)} == {1, 2, 3, 4, 5, 6}


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("choice(cup.stl, my bowl.stl,a-b/c.stl)", {"cup.stl", "my bowl.stl", "a-b/c.stl"}),
        ("choice(left,right)", {"left", "right"}),
        ("choice('left, or right', 2)", {"left, or right", 2}),
        ("choice(true,2.stl)", {True, "2.stl"}),
        ("choice((0,1),(-1,2))", {(0, 1), (-1, 2)}),
    ],
)
def test_choices_are_words_as_those_of_a_list_or_literals(text: str, values: set[object]) -> None:
    given = Variations({}, {"a": text})
    assert {given.of(0, number)["a"] for number in range(60)} == values


@pytest.mark.parametrize(
    "text", ["choice()", "choice(a,,b)", "choice(a", "choice(a(b))", "choice(a='b')", "uniform(a,b)"]
)
def test_what_is_no_distribution_is_refused(text: str) -> None:
    with pytest.raises(BadArgument, match="choice"):
        Variations({}, {"a": text})


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"set": {"y": [1]}}, "plan.py has no parameter 'y'; "),
        ({"set": {"whta": ["fine"]}}, "did you mean what?"),
        ({"set": {"x": ["far"]}}, "a value of type float, because the default is 0.5"),
        ({"sample": {"x": "uniform(0)"}}, "uniform(a,b)"),
        ({"sample": {"x": "unifrom(0,1)"}}, "did you mean uniform?"),
        ({"sample": {"x": "__import__('os')"}}, "a distribution"),
        ({"set": {"x": []}}, "a list of one or more values"),
        ({"limit": 0}, "seconds"),
        ({"runs": 0}, "a whole number from 1"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_done(
    plan: Path, tmp_path: Path, given: dict[str, Any], says: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(says)):
        pycram.sweep(plan, given.pop("runs", 2), tmp_path / "runs", **given)
    assert not (tmp_path / "runs").exists()


def test_a_plan_that_declares_no_parameters_says_how(tmp_path: Path) -> None:
    plan = tmp_path / "bare.py"
    plan.write_text("print(1)\n")
    with pytest.raises(
        pycram.UnknownParameter, match=r"declares no parameters; declare them with pycram.parameters\(name=default\)"
    ):
        pycram.sweep(plan, 2, tmp_path / "runs", set={"x": [1]})


@pytest.mark.parametrize("text", ["import nothing_like_it\n", "def (\n", "raise RuntimeError('no')\n"])
def test_a_plan_that_cannot_start_stops_after_the_first_run(tmp_path: Path, text: str) -> None:
    plan, folder = tmp_path / "plan.py", tmp_path / "runs"
    plan.write_text(text)
    result = pycram.sweep(plan, 50, folder)
    assert result.done == 1
    assert "the first run failed before the plan did anything" in result.stopped
    assert not recordings(folder)
    [failure] = result.failures
    _, ended = ends(folder / failure.name)
    assert ended.failure.type in result.stopped
    assert {each.name for each in folder.iterdir()} == {"00000.mcap.failed", "sweep.lock"}
    plan.write_text("print('mended')\n")
    assert pycram.sweep(plan, 2, folder).failed == 0
    assert len(recordings(folder)) == 2


@pytest.mark.slow
def test_two_sweeps_into_one_folder(plan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    messages = []

    def meanwhile(_: Sweep, outcome: RunOutcome | None) -> None:
        if outcome is None:
            with pytest.raises(SweepRefused) as refused:
                pycram.sweep(plan, 1, folder)
            messages.append(str(refused.value))

    pycram.sweep(plan, 1, folder, progress=meanwhile)
    assert f"process {os.getpid()} on " in messages[0]
    with pytest.raises(SweepRefused, match="the seed was 0, not 1"):
        pycram.sweep(plan, 1, folder, seed=1)
    plan.write_text(PLAN + "\n# another\n")
    with pytest.raises(SweepRefused, match="the plan was different"):
        pycram.sweep(plan, 1, folder)


def test_a_url_is_no_folder_of_this_machine(plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="a URL is for a Ray cluster"):
        pycram.sweep(plan, 1, "s3://bucket/runs")
    assert not (tmp_path / "s3:").exists()


@pytest.mark.slow
def test_a_process_with_threads_and_worlds_as_a_notebook_sweeps_in_another_one(plan: Path, tmp_path: Path) -> None:
    ended = threading.Event()
    thread = threading.Thread(target=ended.wait)
    thread.start()
    folder = tmp_path / "runs"
    values = {"what": ["fine", "fails"], "x": [0.25]}

    def stop(result: Sweep, _: RunOutcome | None) -> None:
        if result.done == 2:
            raise KeyboardInterrupt

    try:
        with BulletWorld(name="mine") as world:
            interrupted = pycram.sweep(plan, 60, folder, set=values, progress=stop)
            rest = pycram.sweep(plan, 6, folder, set=values)
            assert not world.objects
    finally:
        ended.set()
        thread.join()
    assert (interrupted.interrupted, interrupted.done) == (True, 2)
    assert rest.before >= 2
    assert rest.before + rest.done == 6
    files = recordings(folder)[:6]
    assert [ends(file)[1].succeeded for file in files] == [True, False] * 3
    assert [ends(file)[0].sweep.number for file in files] == list(range(6))
    assert not list(folder.glob(".*"))
    assert len(list(folder.glob("models-*"))) == 1
    with Recording(files[2]) as log:
        assert [each.world for each in log.lifetimes] == ["world_1"], "it begins without the worlds of the caller"


# --- what is missing --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_started_again_it_does_what_is_missing(plan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    pycram.sweep(plan, 3, folder)
    before = {file.name: file.stat().st_mtime_ns for file in recordings(folder)}
    (folder / "00001.mcap").unlink()
    (folder / ".00001.mcap.part").write_bytes(b"half of one")  # of a sweep that was killed
    result = pycram.sweep(plan, 4, folder)
    assert (result.before, result.done) == (2, 2)
    after = {file.name: file.stat().st_mtime_ns for file in recordings(folder)}
    assert len(after) == 4
    assert all(after[name] == before[name] for name in ("00000.mcap", "00002.mcap"))
    assert not list(folder.glob(".*"))


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_ended_in_the_middle_it_leaves_what_is_done(plan: Path, tmp_path: Path, how: signal.Signals) -> None:
    folder = tmp_path / "runs"
    with command("sweep", plan, "--runs", 300, "-o", folder, cwd=tmp_path) as process:
        while len(recordings(folder)) < 4 and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(how)
        printed, errors = process.communicate(timeout=60)
    assert process.returncode == (130 if how == signal.SIGINT else -9), errors
    done = recordings(folder)
    assert 4 <= len(done) < 300
    for file in done:
        assert ends(file)[1].succeeded
        with Recording(file) as log:
            assert log.complete
    if how == signal.SIGINT:
        assert "are missing; the same command makes them" in printed
        assert not list(folder.glob(".*"))
    again = pycram.sweep(plan, len(done) + 1, folder)
    assert (again.before, again.done) == (len(done), 1)


# --- what goes wrong --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_whose_process_is_killed_is_tried_once_more(plan: Path, tmp_path: Path) -> None:
    values = {"what": ["fine", "dies once", "dies"], "marks": [str(tmp_path)]}
    result = pycram.sweep(plan, 4, tmp_path / "runs", set=values)
    assert (result.done, result.failed) == (4, 1)
    fine, once, lost, last = recordings(tmp_path / "runs")
    assert all(ends(file)[1].succeeded for file in (fine, once, last))
    assert ends(once)[0].sweep.attempt == 2
    began, ended = ends(lost)
    assert ended.failure.type == "RunLost"
    assert "its process was ended by SIGKILL, at each of 2 attempts" in ended.failure.message
    assert {each.name for each in began.parameters} == {"what", "marks"}
    killed = lost.with_name(f"{lost.name}.killed")
    assert ended.failure.message.endswith(f"its incomplete recording is {killed.name}")
    with Recording(killed) as log:  # what it had done until then
        assert any(record.HasField("set_color") for record in log.records("mutation"))


@pytest.mark.costly
@pytest.mark.slow
def test_a_run_that_hangs_is_ended(plan: Path, tmp_path: Path) -> None:
    result = pycram.sweep(plan, 2, tmp_path / "runs", set={"what": ["fine", "hangs"]}, limit=4)
    assert (result.done, result.failed) == (2, 1)
    began, ended = ends(recordings(tmp_path / "runs")[1])
    assert (ended.failure.type, ended.failure.message) == ("TimeLimit", "the run was still running after 4 s")
    assert began.sweep.attempt == 2


@pytest.mark.costly
@pytest.mark.slow
def test_a_run_that_takes_too_much_memory_fails(plan: Path, tmp_path: Path) -> None:
    pycram.sweep(plan, 2, tmp_path / "runs", set={"what": ["fine", "takes all memory"]}, memory=1 << 30)
    fine, much = recordings(tmp_path / "runs")
    assert ends(fine)[1].succeeded
    assert ends(much)[1].failure.type == "MemoryError"


@pytest.mark.costly
@pytest.mark.slow
def test_a_full_disk_stops_it_and_what_is_done_stays(plan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    pycram.sweep(plan, 2, folder)
    full = tmp_path / "full.py"
    full.write_text(
        f"import sys, resource, pycram\nresource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))\n"
        f"result = pycram.sweep({str(plan)!r}, 50, {str(folder)!r})\nprint(result.done, result.stopped)\n"
    )
    process = subprocess.run(
        [sys.executable, str(full)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=os.environ | {"PYTHONPATH": str(Path(pycram.__file__).parents[1])},
    )
    assert process.stdout.startswith("0 run 2 couldn't be recorded: File too large"), process.stderr
    assert [ends(file)[1].succeeded for file in recordings(folder)] == [True, True]
    assert not list(folder.glob(".*"))


@pytest.mark.slow
def test_what_installed_packages_do_with_a_recording_costs_no_run(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def note(path: Path) -> None:
        if path.name == "00001.mcap":
            raise ValueError("no row")
        with Recording(path) as log:
            path.with_suffix(".row").write_text(str(len(log)))

    hooks: Callable[[], Any] = lambda: (note,)  # noqa: E731
    monkeypatch.setattr("pycram.sweeping.local.hooks", hooks)
    result = pycram.sweep(plan, 2, tmp_path / "runs")
    assert result.remarks == ["00001.mcap: ValueError: no row"]
    assert result.failed == 0
    assert int((tmp_path / "runs" / "00000.row").read_text()) > 2


def test_secret_parameters_are_left_out(tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text("import pycram\nassert pycram.parameters(api_key='').api_key == 'xyzzy'\n")
    result = pycram.sweep(plan, 1, tmp_path / "runs", set={"api_key": ["xyzzy"]})
    assert result.failed == 0
    (file,) = recordings(tmp_path / "runs")
    assert "xyzzy" not in file.name
    assert b"xyzzy" not in file.read_bytes().replace(plan.read_bytes(), b"")
    assert "xyzzy" not in str(ends(file)[0])


@pytest.mark.slow
def test_one_run_is_given_parameters_too(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "one.mcap"
    assert pycram_command(["run", str(plan), "--seed", "1", "--set", "x=2", "--log", str(log)]) == 0
    began, _ = ends(log)
    assert [(each.name, each.value_json) for each in began.parameters] == [("x", "2")]
    with Recording(log) as one:
        assert one.state_at(one.final_step()).world().bodies["cup"].position[0] == 2
    with pytest.raises(SystemExit):
        pycram_command(["run", str(plan), "--set", "y=2", "--log", str(log)])
    assert "plan.py has no parameter 'y'" in capsys.readouterr().err


def test_its_last_lines_count_failures_but_for_their_numbers(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = plan.read_text().replace("the cup is at {given.x}", "\\x1b[2Jthe cup is at {given.x}")
    plan.write_text(text)
    runs = tmp_path / "runs"
    command = ["sweep", str(plan), "--runs", "3", "--set", "x=1,1.5,2", "--set", "what=fails", "-o", str(runs)]
    assert pycram_command(command) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert lines[1].startswith(
        "     3  BranchesFailed: seq failed: PlanFailure: [2Jthe cup is at 1.0  pycram-replay why "
    )
