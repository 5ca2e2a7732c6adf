"""Plans that were stopped: by a deadline, by Ctrl-C or a signal, or by the end of their process."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.running import RunSpec, run
from recorder.records import Run
from replay.cli.main import main
from replay.explain import causes as kinds
from tests.replay.explain.causes.explaining import line_of, words

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.explain.why import Why


WAITING = """
    ready = Fluent(None, "apple ready")
    done = Fluent(None, "all done")
    def fetch():
        done.set_value(True)
        if world.sim_step:
            ready.set_value(True)
    def serve():
        with timeout(0.05):
            ready.wait_for()
    with par as s:
        s(fetch)
        s(serve)
"""


def test_a_timeout_tells_the_fluent_its_value_and_who_sets_it(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (cause,) = explained(WAITING).causes
    assert (cause.kind, cause.seconds) == ("timeout", 0.05)
    (pending,) = cause.pending
    assert pending.task.name == "apple ready"
    assert pending.values == {"apple ready": None}
    (fulfiller,) = pending.fulfillers
    assert fulfiller.line.number == line_of(tmp_path, "ready.set_value")
    assert (fulfiller.task.name, fulfiller.task.failed, fulfiller.step) == ("fetch", False, None)
    assert "after 0.05 s the plan was still waiting for apple ready" in words(tmp_path, capsys)


def test_a_deadlock_tells_the_fluent_its_value_and_who_sets_it(explained: Callable[..., Why], tmp_path: Path) -> None:
    (cause,) = explained("""
        held = Fluent(0, "held")
        def take():
            held.set_value(held.get_value() - 1)
        def leave():
            (held == 1).wait_for()
        with par as s:
            s(take)
            s(leave)
    """).causes
    (pending,) = cause.pending
    assert (pending.values, pending.fulfillers[0].line.number) == ({"held": -1}, line_of(tmp_path, "held.set_value"))
    assert next(cause.lines()) == "in a deadlock, the plan was waiting for held == 1 in leave"


def test_a_deadlock_tells_a_setter_with_another_name_and_the_joint_that_moved_too_little(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A function sets its parameter, and one assignment makes two fluents."""
    explained("""
        from pycram.fluents.world import joint
        from pycram.fluent import whenever
        from pycram.language import pursue
        robot = Object("pr2", "robot", "pr2.urdf")
        high, seen = (joint(robot, "torso_lift_joint") > 0.2).rising(), Fluent(name="seen")
        def watch(signal, flag):
            for _ in whenever(signal):
                flag.set_value(True)
        def lift():
            robot.set_joint_position("torso_lift_joint", 0.1)
            seen.wait_for()
        with pursue as s:
            s(watch, high, seen)
            s(lift)
    """)
    said = words(tmp_path, capsys)
    setter, lifting = line_of(tmp_path, "flag.set_value"), line_of(tmp_path, "set_joint_position")
    assert f"watch at plan.py:{setter} perhaps sets it: flag.set_value(True)" in said
    assert "a branch waits for torso_lift_joint of pr2, which is at 0.1; step" in said
    assert f"pr2.torso_lift_joint was moved, by lift branch, at plan.py:{lifting}" in said.replace(f"{tmp_path}/", "")


def test_a_wait_for_more_than_a_joint_can_do_tells_its_limits(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    explained("""
        from pycram.fluents.world import joint
        robot = Object("pr2", "robot", "pr2.urdf")
        if not (joint(robot, "torso_lift_joint") > 0.9).wait_for(timeout=0.01):
            raise RuntimeError("it isn't up")
    """)
    said = words(tmp_path, capsys)
    assert "torso_lift_joint of pr2 goes from 0 to 0.31, so it never becomes true" in said
    assert "gravity" not in said


def test_a_timeout_tells_what_took_the_time_in_a_block(explained: Callable[..., Why]) -> None:
    why = explained("""
        import time
        from pycram.language import seq
        def cook():
            time.sleep(0.3)
        with timeout(0.2):
            with par as kitchen:
                kitchen(cook)
                with seq as table:
                    table(world.simulate, 0.1)
    """)
    (cause,) = why.causes
    assert isinstance(cause, kinds.Timeout)
    assert "cook" in [task.name for task in cause.took]


def test_a_timeout_in_simulated_time_tells_which_lines_took_it(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        from pycram.language import failure_handling
        def pause(failure):
            world.simulate(0.25)
        with timeout(0.6, simulated=True):
            for attempt in failure_handling(9).on(PlanFailure, pause):
                with attempt:
                    raise PlanFailure("it sticks")
    """)
    (cause,) = why.causes
    (simulated,) = cause.simulated
    assert (simulated.line.number, simulated.seconds, len(simulated.steps)) == (
        line_of(tmp_path, "world.simulate(0.25)"),
        0.75,
        3,
    )
    text = words(tmp_path, capsys)
    assert "attempt 1, attempt 2 and attempt 3 failed: it sticks" in text
    assert "timeout of 0.6 s of simulated time failed" in text
    main(["tree", str(tmp_path / "x.mcap")])
    assert "X timeout of 0.6 s of simulated time" in capsys.readouterr().out


def test_a_wait_in_vain_is_told_where_the_plan_raised_for_it(explained: Callable[..., Why]) -> None:
    why = explained("""
        door = Fluent("shut", "door")
        if not (door == "open").wait_for(timeout=0.02):
            raise PlanFailure("the door stays shut")
    """)
    timeout, raised = why.causes
    assert timeout.pending[0].values == {"door": "shut"}
    assert raised.line.text.startswith("raise PlanFailure")


@pytest.mark.parametrize(("name", "by", "code"), [("SIGINT", "Ctrl-C", 130), ("SIGTERM", "SIGTERM", 143)])
def test_an_interrupt_is_no_failure_of_the_plan(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, by: str, code: int
) -> None:
    why = explained(
        f"""
        ready = Fluent(None, "apple ready")
        def stop():
            os.kill(os.getpid(), signal.{name})
        with par as s:
            s(ready.wait_for)
            s(stop)
    """,
        code,
    )
    (cause,) = why.causes
    assert (cause.kind, cause.by) == ("interrupted", by)
    assert "apple ready" in [pending.task.name for pending in cause.pending]
    with replay.open(tmp_path / "x.mcap") as log:
        assert isinstance(log[-1], Run)
        assert log[-1].interrupted_by == name
    assert words(tmp_path, capsys).startswith(f"plan was interrupted by {by} while")


def test_an_interrupt_after_a_failure_is_not_taken_for_it(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained(
        """
        from pycram.language import failure_handling
        def give_up(failure):
            os.kill(os.getpid(), signal.SIGINT)
        for attempt in failure_handling(3).on(PlanFailure, give_up):
            with attempt:
                raise PlanFailure("the milk is gone")
    """,
        130,
    )
    (cause,) = why.causes
    assert why.run.outcome == "interrupted"
    assert (cause.kind, cause.line.number) == ("interrupted", line_of(tmp_path, "os.kill"))
    with replay.open(tmp_path / "x.mcap") as log:
        (earlier,) = log.why("task:attempt 1@end").causes
    assert (earlier.kind, earlier.line.text) == ("raised", 'raise PlanFailure("the milk is gone")')
    assert why.task is None or why.task.name == "failure-handling"
    assert words(tmp_path, capsys).startswith("plan was interrupted by Ctrl-C while in failure-handling")


def test_a_program_s_own_handler_of_sigterm_stays(explained: Callable[..., Why], tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)
    (tmp_path / "plan.py").write_text("import signal\nassert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN\n")
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        assert run(RunSpec(tmp_path / "plan.py"), tmp_path / "x.mcap") == 0
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_killed_plan_tells_what_it_was_doing(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    explained(WAITING)
    content = (tmp_path / "x.mcap").read_bytes()
    ends, why = [0, len(content)], None
    while ends[1] - ends[0] > 1:  # the longest beginning of it in which nothing failed: so a killed process leaves it
        size = sum(ends) // 2
        (tmp_path / "x.mcap").write_bytes(content[:size])
        try:
            with replay.open(tmp_path / "x.mcap") as log:
                found = log.why()
        except replay.NotALog:
            ends[0] = size
            continue
        ends[found.failure is not None] = size
        why = why if found.failure is not None else found
    (cause,) = why.causes
    assert (cause.kind, cause.by) == ("interrupted", "")
    assert "apple ready" in [pending.task.name for pending in cause.pending]


def test_a_line_that_set_a_fluent_too_rarely_has_the_step_of_its_last_change(explained: Callable[..., Why]) -> None:
    why = explained("""
        served = Fluent(0, "served")
        for _ in range(2):
            served.set_value(served.get_value() + 1)
        if not (served >= 3).wait_for(timeout=0.1):
            raise RuntimeError("not all are served")
    """)
    (setter,) = why.causes[0].pending[0].fulfillers
    assert "it was last set there at step" in str(setter)
    assert "no record shows" not in str(setter)
