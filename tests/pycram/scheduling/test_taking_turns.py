"""Branches take turns: one runs at a time, switches come at checkpoints only, and in the same order each time."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import gc
import os
import sys
import threading
import traceback
from contextlib import ExitStack
from contextvars import ContextVar
from typing import TYPE_CHECKING

import pytest
from greenlet import greenlet

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import Unreachable
from pycram.fluent import Fluent, whenever
from pycram.fluents import expressions
from pycram.language import State, failure_handling, finally_, par, pursue, seq, timeout, try_all, try_in_order
from pycram.language.timeouts import TimedOut
from pycram.process_module import ProcessModule
from pycram.scheduling.cancellation import checkpoint, wait
from pycram.scheduling.schedule import Condition, LockHeld
from recorder.records import Event, Mutation, Task
from recorder.tracing import context, journal
from tests.conftest import MemorySink
from tests.pycram.language.gates import Gate, Meeting, fails, succeeds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType


def greenlets() -> list[greenlet]:
    """Return those that run, without those of threads."""
    return [g for g in gc.get_objects() if type(g) is greenlet and g and g.parent is not None]


@pytest.mark.parametrize(
    "move",
    [
        lambda cup, x: cup.set_position([x, 0, 1]),
        lambda cup, x: cup.set_orientation([0, 0, x, 1]),
        lambda cup, x: cup.set_position_and_orientation([x, 0, 1], [0, 0, 0, 1]),
    ],
)
def test_others_run_before_an_object_is_moved(world: BulletWorld, move: Callable[[Object, float], None]) -> None:
    order: list[str] = []
    cups = [Object(f"cup {number}", "cup", "cup.stl", [0, number, 1]) for number in range(2)]

    def branch(cup: Object) -> None:
        for x in (1.0, 2.0):
            move(cup, x)
            order.append(cup.name)

    par(lambda: branch(cups[0]), lambda: branch(cups[1]))
    assert order == ["cup 0", "cup 1"] * 2


def test_what_is_not_given_of_a_pose_is_that_of_the_moment_of_the_change(world: BulletWorld) -> None:
    cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
    par(lambda: cup.set_orientation([0, 0, 1, 0]), lambda: cup.set_position([1, 0, 1]))
    assert cup.get_position() == pytest.approx([1, 0, 1])
    assert cup.get_orientation() == pytest.approx([0, 0, 1, 0])


def test_one_branch_runs_at_a_time_from_checkpoint_to_checkpoint() -> None:
    order: list[str] = []

    def branch(name: str) -> None:
        for part in "12":
            order.append(name + part + " begins")
            order.append(name + part + " ends")
            checkpoint()

    with par as s:
        s(branch, "a")
        s(branch, "b")
        order.append("body")  # asks for branches, and lets them go on when it has ended
    assert order == [
        "body",
        *("a1 begins", "a1 ends", "b1 begins", "b1 ends"),
        *("a2 begins", "a2 ends", "b2 begins", "b2 ends"),
    ]


def busy_plan() -> None:
    """Motions, blocks in blocks, changes of a world, fluents, failures and timeouts."""
    with BulletWorld(name="lab") as world:
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        box = Object("box", "box", "breakfast_cereal.stl", [1, 0, 1])
        robot = Object("pr2", "robot", "pr2.urdf", [3, 0, 0])
        world.set_robot(robot)
        raised, lowered = Fluent(0, "raised"), Fluent(0, "lowered")

        def move(body: Object, times: int) -> None:
            for number in range(times):
                body.set_position([number, 0, 1])
                raised.set_value(number)

        def follow() -> None:
            for _ in whenever(raised.pulsed()):
                lowered.set_value(lowered.get_value() + 1)

        with pursue as race:
            race(follow)
            with par as s:
                s(move, cup, 5)
                ProcessModule.perform(MotionDesignator([("type", "move-arm-joints"), ("left-arm", "park")]))
                with seq as t:
                    t(move, box, 3)
                    t((raised >= 0).wait_for)
                ProcessModule.perform(MotionDesignator([("type", "moving"), ("target", [2, 3, 0])]))
                with try_in_order as t:
                    t(fails)
                    t(lambda: try_all(fails, succeeds, succeeds))
                s(lambda: failure_handling(1).run(move, box, 2))
        with finally_(box.set_position, [9, 9, 9]), pytest.raises(TimedOut), timeout(0.5, simulated=True), par as s:
            s(Gate().pass_through)
            s(lambda: [world.simulate(0.1) for _ in range(9)])


def contents(sink: MemorySink) -> list[tuple[object, ...]]:
    """Return the records without times, and with task numbers relative to the first."""
    first = min((record.task for record in sink.of(Task)), default=0)
    entries: list[tuple[object, ...]] = []
    for record in sink.records:
        content = (type(record).__name__, record.thread, max(record.task - first, -1), record.sim_step)
        if isinstance(record, Task):
            content += (record.phase, record.status, record.kind, record.name, record.source_line, record.result_json)
        if isinstance(record, Mutation):
            content += (record.WhichOneof("command"), record.effect.SerializeToString())
        entries.append(content)
    return entries


@pytest.mark.slow
def test_the_same_plan_makes_the_same_records_in_the_same_order() -> None:
    runs = []
    for _ in range(3):
        sink = MemorySink()
        log = journal.Journal([sink])
        journal.open_journal(log)
        try:
            busy_plan()
        finally:
            journal.close_journal(log)
        runs.append(contents(sink))
    assert len(runs[0]) > 80
    assert runs[0] == runs[1] == runs[2]
    assert len({record[1] for record in runs[0]}) > 8  # branches have names of their own


def test_no_greenlet_is_left_of_a_block_however_it_ends() -> None:
    gate = Gate()
    before = len(greenlets())
    for kind in (par, pursue, try_all):
        for end in (succeeds, fails):
            with pytest.raises(Unreachable) if end is fails and kind is not try_all else timeout(60), kind as s:
                s(end)
                with seq as t:
                    t(gate.pass_through) if kind is not par else t(succeeds)
                s(succeeds)
    with pytest.raises(ZeroDivisionError), par as s:
        s(gate.pass_through)
        s(checkpoint)
        s(lambda: 1 / 0)
    assert len(greenlets()) == before


def test_a_branch_must_not_wait_with_a_lock_held(world: BulletWorld) -> None:
    condition = Condition()
    for lock in (world.lock, expressions.lock):
        for action in (
            checkpoint,
            lambda: wait(condition, lambda: False, 0.01),
            lambda: Fluent().wait_for(0.01),
            lambda: par(succeeds),
        ):
            with pytest.raises(LockHeld), lock:
                action()
    with BulletWorld() as second, second.lock:
        world.set_gravity([0, 0, -1])  # is part of what the lock is held for
    with par as s:
        s(world.set_gravity, [0, 0, -2])
        s(world.set_gravity, [0, 0, -3])
    assert world.gravity == (0, 0, -3)


def test_a_block_that_ends_with_a_lock_held_is_over(world: BulletWorld) -> None:
    done = []
    with ExitStack() as held, pytest.raises(LockHeld), par as s:
        s(succeeds)
        held.enter_context(world.lock)
    par(lambda: done.append(1))  # would be a branch of the block that is over
    assert done == [1]


def test_handlers_of_events_may_wait_while_other_branches_change_the_world(world: BulletWorld) -> None:
    cup, box = Object("cup", "cup", "cup.stl", [0, 0, 1]), Object("box", "box", "breakfast_cereal.stl", [1, 0, 1])
    begun, gate, order = Gate(), Gate(), []

    def handler(*_: object) -> None:
        order.append("waits")
        begun.open()
        assert gate.pass_through(20)
        order.append("goes on")

    def moves_the_box() -> None:
        begun.pass_through()
        box.set_position([2, 0, 1])
        order.append("moved")
        gate.open()

    event = world.get_attachment_event()
    event += handler
    with par as s:
        s(box.attach, cup)
        s(moves_the_box)
    assert order == ["waits", "moved", "goes on"]


def test_branches_nest_and_recur_up_to_the_recursion_limit() -> None:
    def nested(levels: int) -> int:
        if not levels:
            return 0
        with par as s:
            deeper = s(nested, levels - 1)
            s(checkpoint)
        return 1 + deeper.result()

    assert nested(150) == 150
    gate = Gate()

    def recur(levels: int) -> int:
        if not levels:
            gate.pass_through()
            return 0
        return 1 + recur(levels - 1)

    deep = sys.getrecursionlimit() * 2 // 3
    with par as s:
        results = [s(recur, deep) for _ in range(3)]
        s(gate.open)
    assert [result.result() for result in results] == [deep] * 3
    with pytest.raises(RecursionError), par as s:
        s(recur, 10**6)


def test_tracebacks_show_the_plan_s_lines() -> None:
    def reach_for_it() -> None:
        checkpoint()
        fails()

    def in_a_block() -> None:
        with par as s:
            s(succeeds)
            s(reach_for_it)

    with pytest.raises(Unreachable) as raised:
        par(in_a_block, checkpoint)
    text = "".join(traceback.format_exception(raised.value))
    for line in ("par(in_a_block, checkpoint)", "with par as s:", "in reach_for_it", "in fails"):
        assert line in text or line in str(raised.traceback), line


def test_each_branch_has_its_own_context_and_exception() -> None:
    variable: ContextVar[str] = ContextVar("variable", default="outside")
    meeting = Meeting(2)
    seen = []

    def branch(name: str) -> None:
        variable.set(name)
        try:
            int(name)
        except ValueError:
            meeting.wait()
            seen.append((variable.get(), str(sys.exc_info()[1])))

    with par as s:
        s(branch, "a")
        s(branch, "b")
    assert [(name, name in error) for name, error in sorted(seen)] == [("a", True), ("b", True)]
    assert variable.get() == "outside"


def test_a_generator_may_be_resumed_by_another_branch() -> None:
    def numbers() -> Iterator[int]:
        for number in range(4):
            checkpoint()
            yield number

    shared, taken = numbers(), []

    def take(times: int) -> None:
        taken.extend(next(shared) for _ in range(times))

    with par as s:
        first = s(take, 2)
        s(lambda: (first.result(), take(2)))
    assert taken == [0, 1, 2, 3]


def test_a_wait_ends_in_time_while_others_are_busy() -> None:
    over: list[bool] = []

    def busy() -> None:
        while not over:
            checkpoint()

    with timeout(20), par as s:
        s(busy)
        s(lambda: over.append(Gate().pass_through(0.01)))
    assert over == [False]
    with pytest.raises(TimedOut), timeout(0.01):
        while True:
            checkpoint()


def test_threads_of_the_plan_s_own_wake_and_add_branches() -> None:
    gate, done = Gate(), []
    with par as s:

        def beside() -> None:
            s(lambda: done.append(threading.get_ident()))
            s(gate.open)

        thread = threading.Thread(target=beside)
        s(gate.pass_through)
        thread.start()
    thread.join()
    assert done == [threading.get_ident()]  # branches run where the block was opened


def test_each_thread_has_branches_of_its_own() -> None:
    together = threading.Barrier(2)
    results = []

    def plan() -> None:
        together.wait(20)
        meeting = Meeting(3)
        results.append(sorted(par(meeting.wait, meeting.wait, meeting.wait)))

    threads = [threading.Thread(target=plan) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [[0, 1, 2], [0, 1, 2]]


def test_a_branch_has_no_more_room_on_the_stack_than_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(context, "_outside", 0)

    def recursive(left: int) -> None:
        if left:
            recursive(left - 1)
        else:
            par(lambda: context.require_stack_room(220))

    recursive(20)
    with pytest.raises(RecursionError):
        recursive(sys.getrecursionlimit() - 260)


def test_a_process_that_a_branch_forks_continues_all_branches() -> None:
    order: list[str] = []
    meeting = Meeting(2)
    child = -1

    def branch(name: str) -> None:
        nonlocal child
        for number in range(3):
            order.append(f"{name}{number}")
            checkpoint()
            if (name, number) == ("a", 1):
                child = os.fork()
        meeting.wait()

    code = 1
    try:
        with par as s:
            s(branch, "a")
            s(branch, "b")
        code = 0 if order == ["a0", "b0", "a1", "b1", "a2", "b2"] else 2
    finally:
        if child == 0:
            os._exit(code)
    assert code == 0
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_a_debugger_sees_the_lines_of_branches() -> None:
    lines: list[str] = []

    def trace(frame: FrameType, event: str, _: object) -> object:
        if frame.f_code.co_name == "watched" and event == "line":
            lines.append(str(frame.f_locals.get("name")))
        return trace

    def watched(name: str) -> None:
        checkpoint()
        del name

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        par(lambda: watched("a"), lambda: watched("b"))
    finally:
        sys.settrace(before)
    assert sorted(lines) == ["a", "a", "b", "b"]


def test_records_of_a_thread_that_a_branch_starts_have_its_own_name(sink: MemorySink) -> None:
    def branch() -> None:
        journal.emit(Event(name="of the branch"))
        thread = threading.Thread(target=lambda: journal.emit(Event(name="of the thread")), name="helper")
        thread.start()
        thread.join()

    with par as s:
        s(branch)
    assert [(event.name, event.thread) for event in sink.of(Event)] == [
        ("of the branch", f"par-1 {branch.__name__}"),
        ("of the thread", "helper"),
    ]
    assert s.state is State.SUCCEEDED
