"""Projection: an action done in a copy of the process ends as it would here, and leaves nothing here but its outcome."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import Designator, MotionDesignator
from pycram.failures import BadArgument, DeadlockedBranches, PlanFailure, Unreachable
from pycram.fluent import Fluent
from pycram.language import in_thread, par, timeout, try_in_order
from pycram.motions.resources import Resources
from pycram.process_module import ProcessModule
from pycram.projection import NotProjectable, Outcome, ProjectedError, ProjectionDied, project, project_all
from pycram.scheduling.schedule import LockHeld, seed_order
from pycram.world.transaction import take_snapshot
from recorder.records import Mutation, Task
from replay.restore.verify import verify
from tests.measures import seeded
from tests.pycram.language.gates import Gate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.conftest import MemorySink

REPO = Path(__file__).parents[2]


@pytest.fixture
def cup(world: BulletWorld) -> Object:
    Object("floor", "environment", "plane.urdf", world=world)
    return Object("cup", "cup", "cup.stl", [0, 0, 0.3], world=world)


@pytest.fixture(autouse=True)
def _no_child_is_left() -> Iterator[None]:
    others = set(psutil.Process().children())  # of tests before this one
    yield
    seed_order(None)
    assert not set(psutil.Process().children()) - others


def drop(cup: Object, height: float) -> tuple[Object, list[float]]:
    """Drop a cup from a random place."""
    cup.set_position([random.random(), 0, height])
    cup.world.simulate(0.4)
    return cup, cup.get_position()


def test_what_is_imagined_happens_to_the_same_bits_and_nothing_has_happened_here(
    world: BulletWorld, cup: Object, sink: MemorySink
) -> None:
    before, dice, records = take_snapshot(cup), random.getstate(), len(sink.of(Mutation))
    imagined = project(drop, cup, height=0.5)
    assert imagined.succeeded
    assert imagined
    assert imagined.failure is None
    assert imagined.duration == pytest.approx(0.4)
    assert (take_snapshot(cup), random.getstate(), len(sink.of(Mutation)), world.sim_step) == (before, dice, records, 0)
    assert imagined.state is not None
    saved = world.save()
    body, at = drop(cup, 0.5)
    assert imagined.result == (cup, at)
    assert imagined.result[0] is cup
    assert body is cup
    done = world.engine.center_pose(cup.handle)[0]
    world.restore(saved)
    world.restore(imagined.state)
    assert world.engine.center_pose(cup.handle)[0] == done


def fails(cup: Object) -> None:
    cup.world.simulate(0.1)
    raise Unreachable("left", cup.get_position(), 0.2)


def test_a_failure_comes_back_with_its_data(cup: Object) -> None:
    outcome = project(fails, cup)
    assert not outcome
    assert isinstance(outcome.failure, Unreachable)
    assert outcome.failure.arm == "left"
    assert outcome.duration == pytest.approx(0.1)

    class Unknown(Exception):
        """A plan's own, which no other process can know."""

    def raises() -> None:
        raise Unknown("why not")

    outcome = project(raises)
    assert isinstance(outcome.failure, ProjectedError)
    assert outcome.failure.error == "Unknown: why not"
    assert outcome.result is None


class Silent:
    """Has no text, and can't leave its process."""

    def __repr__(self) -> str:
        raise ValueError("ask me not")

    def __reduce__(self) -> str:
        raise ValueError("nor this")


@pytest.mark.slow
def test_a_result_that_cannot_leave_the_copy_is_told_as_text(cup: Object, sink: MemorySink) -> None:
    outcome = project(lambda: (i for i in ()))
    assert outcome.succeeded
    assert outcome.result is None
    assert outcome.unsent.startswith("<generator")
    assert project(Silent).unsent == "<Silent, without a text: ValueError: ask me not>"
    assert project(str, None).unsent == ""
    told = [json.loads(task.result_json) for task in sink.of(Task) if task.result_json]
    assert [each.get("unsent", "")[:10] for each in told] == ["<generator", "<Silent, w", ""]


@pytest.mark.slow
def test_what_ends_the_copy_is_an_outcome(cup: Object) -> None:
    for action, limits, cause in (
        (lambda: os._exit(3), {}, "exit code 3"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), {}, "SIGKILL"),
        (lambda: cup.world.simulate(10_000), {"timeout": 0.2}, "longer than 0.2 s"),
        (lambda: bytearray(10**9), {"memory": 100}, "more than 100 MB"),
    ):
        outcome = project(action, **limits)
        assert isinstance(outcome.failure, ProjectionDied)
        assert cause in outcome.failure.cause
        assert not outcome.succeeded
    assert isinstance(project(sys.exit, 0).failure, SystemExit)
    assert project(cup.get_position).succeeded


def test_what_the_copy_reads_is_still_to_be_read_here(cup: Object, tmp_path: Path) -> None:
    file = tmp_path / "goals"
    file.write_text("".join(f"{number}\n" for number in range(10_000)))
    with file.open() as goals:
        assert next(goals) == "0\n"
        assert project(lambda: [*goals][-1]).result == "9999\n"
        assert [*goals] == [f"{number}\n" for number in range(1, 10_000)]


def test_a_process_that_an_action_forks_ends_with_the_copy_and_keeps_nobody_waiting(
    cup: Object, tmp_path: Path
) -> None:
    file = tmp_path / "pid"

    def forks() -> str:
        child = os.fork()
        if not child:
            time.sleep(600)
        file.write_text(str(child))
        return "done"

    assert project(forks, timeout=60).result == "done"
    ended(int(file.read_text()))
    assert project(os.fork, timeout=60).result > 0  # and the one that would answer, too, has no say


def ended(process: int) -> None:
    """Waits until a process has ended that isn't a child of this one."""
    folder, deadline = Path("/proc") / str(process), time.monotonic() + 60
    while folder.exists() and "zombie" not in (folder / "status").read_text():
        assert time.monotonic() < deadline, "it outlives its parent"


def _of_its_own() -> object:
    global Own  # noqa: PLW0603  only the copy has it

    class Own: ...

    Own.__qualname__ = "Own"
    return Own()


def test_what_only_the_copy_knows_cannot_come_back(cup: Object) -> None:
    outcome = project(_of_its_own)
    assert isinstance(outcome.failure, ProjectionDied)
    assert "returned a value that this process can't load" in str(outcome.failure)


@pytest.mark.parametrize("limit", [{"timeout": 0}, {"timeout": -1}, {"memory": 0}, {"memory": -1}, {"memory": 1e30}])
def test_limits_that_are_none_are_refused(limit: dict[str, float]) -> None:
    with pytest.raises(BadArgument):
        project(len, "abc", **limit)


def test_a_small_limit_of_memory_ends_a_recorded_copy(cup: Object, tmp_path: Path) -> None:
    with recorder.record(tmp_path / "run.mcap"):
        outcome = project(lambda: bytearray(10**8), memory=1)
    assert isinstance(outcome.failure, ProjectionDied)


@pytest.mark.slow
def test_the_first_that_succeeds_is_the_first_of_the_candidates(cup: Object) -> None:
    def slow() -> str:
        cup.world.simulate(1)
        return "slow"

    def never() -> None:
        cup.world.simulate(10_000)

    outcomes = project_all([(fails, cup), slow, lambda: "quick", never])
    assert [outcome.succeeded for outcome in outcomes] == [False, True]
    assert outcomes[-1].result == "slow"
    outcomes = project_all([slow, (cup.set_position, [1, 1, 1]), (fails, cup)], until="all")
    assert [outcome.succeeded for outcome in outcomes] == [True, True, False]
    assert [outcome.succeeded for outcome in project_all([(fails, cup)] * 3)] == [False] * 3
    assert project_all([]) == []


@pytest.mark.slow
def test_in_a_branch_the_others_stand_still_in_the_copy(world: BulletWorld, cup: Object) -> None:
    moved: list[str] = []

    def other() -> None:
        for number in range(5):
            moved.append(f"{number} in {os.getpid()}")
            cup.set_position([0, 0, 1 + number])

    def imagined() -> tuple[list[str], list[float]]:
        with par as s:  # blocks, timeouts and failures work in the copy as they do here
            s(world.simulate, 0.1)
            s(world.simulate, 0.1)
        with pytest.raises(PlanFailure), timeout(0.1, simulated=True):
            world.simulate(1)
        with try_in_order as t:
            t(fails, cup)
            t(cup.get_position)
        return moved[:], cup.get_position()

    for seed in (None, 1, 2):
        seed_order(seed)
        moved.clear()
        with par as s:
            s(other)
            outcome = s(project, imagined)
        seen, at = outcome.result().result
        assert seen == moved[: len(seen)]
        assert at[2] < 6
        assert len(moved) == 5


class Holding(ProcessModule):
    """Does what its designator says, with the left arm."""

    def resources(self, designator: Designator) -> Resources:
        return Resources(moves={"left-arm"})

    def _execute(self, designator: Designator) -> object:
        return designator.reference()["act"]()


def test_who_waits_in_the_copy_for_a_branch_that_stands_still_is_told_so(world: BulletWorld, cup: Object) -> None:
    outcomes: list[Outcome] = []
    begun = Fluent()

    def look_ahead() -> None:
        outcomes.extend(project_all([waited.result, begun.wait_for, lambda: par(begun.wait_for)], "all", timeout=60))
        begun.set_value(1)

    with par as s:
        waited = s(begun.wait_for)
        s(look_ahead)
    assert [type(each.failure) for each in outcomes] == [DeadlockedBranches] * 3
    assert project(begun.wait_for).result
    assert project(Fluent().wait_for, 0.01).result is False, "a deadline wakes"
    assert project(in_thread, Fluent).succeeded, "so does a thread"


def test_ctrl_c_ends_a_projection_in_a_branch(cup: Object) -> None:
    def takes_long() -> None:
        os.kill(os.getppid(), signal.SIGINT)
        time.sleep(600)

    outcomes: list[Outcome] = []
    with pytest.raises(KeyboardInterrupt):
        par(lambda: outcomes.append(project(takes_long, timeout=60)))
    assert not outcomes


def test_what_other_branches_claim_is_free_in_the_copy(world: BulletWorld) -> None:
    gate, module = Gate(), Holding()
    holding, moving = (MotionDesignator([("type", "holding"), ("act", act)]) for act in (gate.pass_through, lambda: 7))

    def imagine() -> Outcome:
        try:
            return project(ProcessModule.perform, moving, timeout=60)
        finally:
            gate.open()

    with (
        MotionDesignator.resolvers.added(lambda designator: [dict(designator.description)]),
        ProcessModule.resolvers.added(lambda _: module),
        par as s,
    ):
        s(ProcessModule.perform, holding)
        imagined = s(imagine)
    assert imagined.result().result == 7
    assert s.branches[0].result()


@pytest.mark.slow
def test_the_outcome_and_the_copy_s_recording_are_on_record(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "plan.mcap", output=True), BulletWorld() as world:
        cup = Object("cup", "cup", "cup.stl", [0, 0, 0.3], world=world)
        outcome = project(drop, cup, 0.5)
        project(fails, cup)
        project(print, "in the copy")
    with replay.open(tmp_path / "plan.mcap") as log:
        assert verify(log).exact
        tasks = [task for task in log.records(Task) if task.kind == "projection" and task.phase == Task.FINISHED]
        assert [task.name for task in tasks] == ["drop", "fails", "print"]
        assert '"succeeded":true' in tasks[0].result_json
        assert "Unreachable" in tasks[1].result_json
        assert not list(log.records("output"))
    assert outcome.recording == tmp_path / "plan.projection-1.mcap"
    with replay.open(outcome.recording) as log:
        steps = [record for record in log.records(Mutation) if record.HasField("simulate")]
        assert [record.simulate.steps for record in steps] == [96]
        began = [task for task in log.records(Task) if task.kind == "projection" and task.began_ns]
        assert len(began) == 1  # whose part it is
    with replay.open(tmp_path / "plan.projection-3.mcap") as log:
        assert [record.text for record in log.records("output")] == ["in the copy"]


@pytest.mark.slow
def test_on_record_is_one_after_the_other_in_the_candidates_order(cup: Object, sink: MemorySink) -> None:
    def after(seconds: float, failing: str) -> None:
        time.sleep(seconds)
        if failing:
            raise PlanFailure(failing)

    orders = []
    for waits in ((0.0, 0.2, 0.2, 0.0), (0.3, 0.0, 0.0, 0.2)):
        before = len(sink.of(Task))
        project_all(list(zip((after,) * 4, waits, ("a", "b", "", ""), strict=True)))
        tasks = sink.of(Task)[before:]
        orders.append([(each.phase, json.loads(each.result_json or "{}").get("failure")) for each in tasks])
    assert orders[0] == orders[1]
    begun, ended = Task.STARTED, Task.FINISHED
    assert [phase for phase, _ in orders[0]] == [begun, ended] * 3
    assert [failure for phase, failure in orders[0] if phase == ended] == ["PlanFailure: a", "PlanFailure: b", None]


@contextmanager
def running_thread() -> Iterator[None]:
    release = threading.Event()
    thread = threading.Thread(target=release.wait, name="my thread")
    thread.start()
    try:
        yield
    finally:
        release.set()
        thread.join()


def test_what_can_not_be_projected_is_said_before(world: BulletWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    with running_thread(), pytest.raises(NotProjectable, match="lack the thread my thread; use branches of `with par`"):
        project(world.simulate, 1)
    with pytest.raises(NotProjectable, match="MainThread"):
        in_thread(project, world.simulate, 1)
    with world.lock, pytest.raises(LockHeld):
        project(world.simulate, 1)
    for wrong in (3, "simulate"):
        with pytest.raises(BadArgument):
            project(wrong)  # type: ignore[arg-type]
    with pytest.raises(BadArgument):
        project_all([world.reset], until="some")  # type: ignore[arg-type]
    world.set_realtime(True)
    with pytest.raises(NotProjectable, match="real time"):
        project(world.simulate, 1)
    world.set_realtime(False)
    monkeypatch.delattr(os, "fork")
    with pytest.raises(NotProjectable, match=r"os\.fork"):
        project(world.simulate, 1)


DYING = """
import os, random, sys, time
from pycram.bullet_world import BulletWorld, Object
from pycram.projection import project, project_all
def imagined(depth):
    while True:
        if depth:
            project_all([(imagined, depth - 1)] * 2)
        milk.set_position([0, 0, random.random()])
with BulletWorld():
    milk = Object("milk", "milk", "milk.stl")
    print("began", flush=True)
    while True:
        project(milk.set_position, [1, 1, 1])
        print("once", flush=True)
        if random.Random(int(sys.argv[1])).random() < 0.5:
            project_all([(imagined, 1), (imagined, 0)])
"""


def members(session: int) -> list[int]:
    """The processes of a session that haven't ended."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, _, of = file.read_text().rpartition(")")[2].split()[:4]
            if int(of) == session and state not in "ZX":
                found.append(int(file.parent.name))
    return found


@seeded("parents killed while they imagine", range(50), 3)
def test_no_copy_outlives_a_parent_that_is_killed(seeds: range, record_property: Callable[[str, object], None]) -> None:
    most = 0
    for seed in seeds:
        dice = random.Random(seed)
        command = [sys.executable, "-c", DYING, str(seed)]
        with subprocess.Popen(command, cwd=REPO, stdout=subprocess.PIPE, start_new_session=True) as parent:
            assert parent.stdout is not None
            assert parent.stdout.readline() == b"began\n"
            assert parent.stdout.readline() == b"once\n"
            moment = time.monotonic() + dice.uniform(0, 0.3)
            while time.monotonic() < moment:
                most = max(most, len(members(parent.pid)))
            parent.kill()
            parent.wait()
            deadline = time.monotonic() + 60
            while left := members(parent.pid):
                assert time.monotonic() < deadline, f"{len(left)} copies outlive their parent"
    record_property("processes at once", most)


@pytest.mark.slow
def test_a_copy_that_ends_leaves_its_parent_s_models() -> None:
    code = (
        "import os, sys; from pycram.bullet_world import *; from pycram.models import store\n"
        "w = BulletWorld(); Object('cup', 'cup', 'cup.stl')\n"
        "if not os.fork(): sys.exit()\n"
        "os.wait(); assert store.folder().is_dir(); Object('bowl', 'bowl', 'bowl.stl')"
    )
    subprocess.run([sys.executable, "-c", code], cwd=REPO, check=True, timeout=100)
