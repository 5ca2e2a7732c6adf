"""What made a plan fail, beyond the task that failed: each kind of cause, found in the recording of a plan that has it."""

from __future__ import annotations

import ast
import contextlib
import json
import re
from dataclasses import fields
from pathlib import Path
from textwrap import dedent
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld
from pycram.cli import run
from pycram.designator import DesignatorError
from pycram.failures import PlanFailure, UsageError
from pycram.language import timeout
from pycram.motions.modules.simulated import NoDescription
from pycram.projection import NotProjectable
from recorder.records import Run
from recorder.tracing.span import span
from replay.cli.main import main
from replay.explain.causes import cause as kinds
from replay.explain.causes.raised import USAGE_ERRORS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from replay.explain.causes.why_data import Why
    from replay.recording import Recording

DOCS = Path(__file__).parents[2] / "docs" / "why.md"

START = """
    import os, signal
    from pycram import bullet_world_reasoning as btr
    from pycram.bullet_world import BulletWorld, Object
    from pycram.failures import PlanFailure
    from pycram.fluent import Fluent
    from pycram.language import par, timeout
    world = BulletWorld(name="lab")
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
"""


WITH_PR2 = """
        from pycram.designator import MotionDesignator
        from pycram.process_module import ProcessModule
        def perform(**slots):
            return ProcessModule.perform(MotionDesignator(list(slots.items())))
        robot = world.robot = Object("pr2", "robot", "pr2.urdf")
        milk = Object("milk", "milk", "milk.stl", [7, 0, 0.1])
        tool = "l_gripper_tool_frame"
"""


@pytest.fixture
def explained(tmp_path: Path) -> Callable[..., Why]:
    """Run a plan, and explain why it failed; its file is plan.py."""

    def explain(text: str, code: int = 1) -> Why:
        file = tmp_path / "plan.py"
        file.write_text(dedent(START) + dedent(text))
        assert executed(file) == code
        with replay.open(tmp_path / "x.mcap") as log:
            return log.why()

    return explain


def executed(file: Path) -> int:
    """Run a plan, close the worlds that it left open, and return its exit code."""
    code = run(file, file.parent / "x.mcap")
    while BulletWorld.current_bullet_world is not None:
        BulletWorld.current_bullet_world.exit()
    return code


def line_of(tmp_path: Path, text: str) -> int:
    return next(n for n, line in enumerate((tmp_path / "plan.py").read_text().splitlines(), 1) if text in line)


def words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    main(["why", str(tmp_path / "x.mcap")])
    return capsys.readouterr().out


def test_a_raise_in_a_branch_is_the_plan_s_own_line(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained("""
        apple = Object("apple", "apple", "apple.stl", [0, 0, 0.04])
        def check(body):
            if btr.contact(body, body.world.get_object("floor")):
                raise PlanFailure(f"{body.name} lies on the floor")
        with par as s:
            s(check, apple)
    """)
    (cause,) = (cause for cause in why.causes if isinstance(cause, kinds.Raised))
    assert cause.own
    assert cause.line.number == line_of(tmp_path, "raise PlanFailure")
    assert cause.task.name == "check"
    assert [answer.name for answer in cause.answers] == ["contact"]
    assert [involved.body.name for involved in why.bodies] == ["apple"]


@pytest.mark.parametrize("succeeds", [False, True])
def test_a_raise_after_a_failed_motion_names_that(explained: Callable[..., Why], succeeds: bool) -> None:
    why = explained(f"""
        {WITH_PR2}
        def took():
            try:
                perform(type="pick-up", object=milk, arm="left")
            except PlanFailure:
                return False
        gone = not took()
        if {succeeds}:
            perform(type="moving", target=[1, 1, 0])
        if gone:
            raise PlanFailure("no milk for you")
    """)
    (cause,) = why.causes
    assert isinstance(cause, kinds.Raised)
    assert [answer.name for answer in cause.answers] == ([] if succeeds else ["pick-up"])
    assert set(cause.steps) >= {answer.seq for answer in cause.answers}


def test_a_mistake_of_the_plan_s_is_its_line_and_not_a_raise(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained("""
        apple = Object("apple", "apple", "apple.stl", [0, 0, 0.04])
        def lift(body):
            body.set_position([0, 0])
        lift(apple)
    """)
    (cause,) = why.causes
    assert not cause.own
    assert cause.type == "BadArgument"
    assert cause.line.number == line_of(tmp_path, "set_position([0, 0])")


def test_all_of_pycram_s_usage_errors_are_known_as_mistakes() -> None:
    def below(kind: type) -> Iterator[str]:
        for each in kind.__subclasses__():
            if each.__module__.startswith("pycram."):
                yield each.__name__
                yield from below(each)

    assert {DesignatorError, NoDescription, NotProjectable} <= set(UsageError.__subclasses__())
    assert timeout  # the words of the plan language are loaded, with what they refuse
    assert {*below(UsageError), "UsageError"} == USAGE_ERRORS


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
    assert "after 0.05 s it was still waiting for apple ready" in words(tmp_path, capsys)


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
    import signal  # noqa: PLC0415

    before = signal.getsignal(signal.SIGTERM)
    (tmp_path / "plan.py").write_text("import signal\nassert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN\n")
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        assert run(tmp_path / "plan.py", tmp_path / "x.mcap") == 0
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


SHELF = """
    shelf = Object("shelf", "environment", "plane.urdf", [0, 0, 1])
    milk = Object("milk", "milk", "milk.stl", [0, 0, 1.11])
    assert world.settle()
    {change}
    world.simulate(1)
    raise PlanFailure(f"{{milk.name}} isn't on the shelf")
"""


@pytest.mark.parametrize(
    ("change", "how"),
    [
        ("shelf.remove()", "removed"),
        ("milk.set_position([0, 0, 1.8])", "command"),
        ("shelf.attach(milk); milk.set_position([0, 0, 2]); shelf.detach(milk)", "detached"),
    ],
)
def test_what_let_an_object_fall_is_the_change_before(
    explained: Callable[..., Why], tmp_path: Path, change: str, how: str
) -> None:
    why = explained(SHELF.format(change=change))
    fell = next(cause for cause in why.causes if isinstance(cause, kinds.Physics))
    assert (fell.body, fell.how) == ("milk", "fell")
    assert fell.fall > 0.5
    assert [each.how for each in fell.lets] == [how]
    assert fell.lets[0].line.number == line_of(tmp_path, change)
    assert {fell.lets[0].step, why.step} <= set(fell.steps)


def test_an_object_that_settled_is_no_cause(explained: Callable[..., Why]) -> None:
    why = explained(SHELF.format(change="pass"))
    assert [cause.kind for cause in why.causes] == ["raised"]


def test_what_let_go_of_an_object_tells_how_it_turned(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.6])
        shelf = Object("shelf", "environment", "plane.urdf", [0, 0, 0.45])
        shelf.attach(milk)
        milk.set_position_and_orientation([0, 0, 0.5], [0.3, 0, 0, 0.95])  # a corner of it is inside of the shelf
        shelf.detach(milk)
        world.simulate(0.3)
        raise PlanFailure("where is the milk")
    """)
    threw = next(cause for cause in why.causes if isinstance(cause, kinds.Physics))
    assert threw.spin > 1
    text = words(tmp_path, capsys)
    assert f"it left its hold at step {threw.lets[0].step} while turning at {threw.spin:.0f} rad/s" in text


# --- refusals, handlers, and very many tasks ---------------------------------------------------------------------------


def refusals(why: Why) -> list[kinds.Refused]:
    return [cause for cause in why.causes if isinstance(cause, kinds.Refused)]


@pytest.mark.parametrize("done", ["", "milk.set_position([1, 0.5, 0.1])"])
def test_a_refusal_counts_until_the_same_is_done_after_all(
    explained: Callable[..., Why], tmp_path: Path, done: str
) -> None:
    why = explained(f"""
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        try:
            milk.set_position([1, float("nan"), 0.1])
        except UsageError:
            pass
        world.simulate(0.1)
        {done}
        with span("motion", "take", {{"object": milk}}):
            raise PlanFailure("milk isn't at [1, 0, 0.1]")
    """)
    if done:
        assert not refusals(why)
        return
    (refused,) = refusals(why)
    assert (refused.precondition, refused.subject) == ("moved", "milk")
    assert refused.line.number == line_of(tmp_path, "nan")
    assert refused.went_on.number == line_of(tmp_path, "simulate")
    assert refused.asked.seq in refused.steps


def test_a_refusal_about_another_object_is_no_cause(explained: Callable[..., Why]) -> None:
    why = explained("""
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        cup = Object("cup", "cup", "cup.stl", [1, 0, 0.1])
        try:
            cup.set_position([1, 2])
        except UsageError:
            pass
        with span("motion", "take", {"object": milk}):
            raise PlanFailure("milk isn't there")
    """)
    assert not refusals(why)


def test_a_refusal_in_a_handler_names_the_event(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        from pycram.event import Event
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        def bring(who):
            try:
                milk.set_position("here")
            except UsageError:
                pass
        bell = Event("bell", "door")
        bell += bring
        bell.fire("guest")
        with span("motion", "take", {"object": milk}):
            raise PlanFailure("milk isn't there")
    """)
    (refused,) = refusals(why)
    assert refused.handler.name == "__main__.bring"
    assert refused.handler.cause in refused.steps
    assert f"the handler __main__.bring of event bell of step {refused.handler.cause}" in words(tmp_path, capsys)


def test_a_wait_in_vain_tells_what_was_refused_where_it_should_have_been_fulfilled(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        from pycram.failures import UsageError
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        full = Fluent(None, "full")
        def fill():
            try:
                milk.set_position([1, 2])
            except UsageError:
                return
            full.set_value(True)
        with timeout(0.3):
            par(full.wait_for, fill)
    """)
    (cause,) = why.causes
    ((fulfiller,),) = (pending.fulfillers for pending in cause.pending)
    assert fulfiller.refused.name == "set_position"
    assert fulfiller.refused.seq in cause.steps
    assert f"was refused at step {fulfiller.refused.seq}: BadArgument" in words(tmp_path, capsys)


def test_a_refusal_in_another_world_or_before_a_removal_is_no_cause(explained: Callable[..., Why]) -> None:
    why = explained("""
        from contextlib import suppress
        from pycram.failures import UsageError
        from recorder.tracing.span import span
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        other = BulletWorld(name="other")
        with suppress(UsageError):
            Object("milk", "milk", "milk.stl", world=other).set_position([1, 2])
        with suppress(UsageError):
            milk.set_position([1, 2])
        milk.remove()
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1], world=world)
        with span("motion", "take", {"object": milk}):
            raise PlanFailure("milk isn't there")
    """)
    assert not refusals(why)


def test_a_mistake_rests_on_its_refusal(explained: Callable[..., Why]) -> None:
    why = explained("""
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
        milk.set_position([1, 2])
    """)
    (raised,) = why.causes
    with_refusal = [step for step in raised.steps if step != why.step]
    assert with_refusal


def test_of_very_many_failures_the_last_are_looked_at_and_the_others_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replay.explain.failures._MAX_KEPT", 10)
    with contextlib.suppress(PlanFailure), recorder.record(tmp_path / "x.mcap"), span("plan", "long", {}):
        for number in range(40):
            with (
                contextlib.suppress(PlanFailure) if number < 39 else contextlib.nullcontext(),
                span("motion", "take", {}),
            ):
                raise PlanFailure(f"no {number}")
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        assert why.failure.message == "no 39"
        assert len(why.attempts) == 10
        assert why.forgotten == 30
    text = words(tmp_path, capsys)
    assert "take was attempted at least 10 times" in text
    assert "30 earlier failures aren't looked at here" in text


# --- plans of a robot ------------------------------------------------------------------------------------------------

ROBOT = """
    from pycram.designator import MotionDesignator
    from pycram.process_module import ProcessModule
    def perform(**slots):
        slots = [(key.replace("_", "-"), value) for key, value in slots.items()]
        return ProcessModule.perform(MotionDesignator(slots))
    def tried(**slots):
        try:
            return perform(**slots)
        except PlanFailure:
            return None
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    robot = world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
    cup = Object("cup", "cup", "cup.stl", [1.75, 0.9, 0.92])
    bowl = Object("bowl", "bowl", "bowl.stl", [1.4, 0.4, 0.9])
    world.settle()
    perform(type="move-arm-joints", left_arm="park", right_arm="park")

    tried(type="pick-up", object=cup, arm="left")  # 1: too far
    perform(type="move-arm-joints", left_arm="park")
    tried(type="place", object=cup, target=[1.3, 0.6, 0.9], arm="left")  # 1: so it holds nothing

    cup.set_position([1.35, 0.9, 0.9])
    world.settle()
    assert btr.reachable(cup, robot, "l_gripper_tool_frame")
    cup.set_position([1.75, 0.9, 0.9])
    tried(type="pick-up", object=cup, arm="left")  # 2: no longer there

    cup.set_position([1.35, 0.9, 0.9])
    world.settle()
    perform(type="pick-up", object=cup, arm="left")
    tried(type="place", object=cup, target=[1.9, 0.9, 0.9], arm="left")  # a wall
    drawer = {"drawer_joint": "sink_area_left_upper_drawer_main_joint", "part_of": kitchen}
    drawer["drawer_handle"] = "sink_area_left_upper_drawer_handle"
    tried(type="accessing", **drawer, arm="left")  # 3: the hand isn't free

    bowl.set_position([1.3, 0.88, 0.88])
    tried(type="place", object=cup, target=[1.3, 0.9, 0.9], arm="left")  # 4: the bowl is there

    perform(type="pick-up", object=cup, arm="left")
    perform(type="move-tcp", target=[0.6, 1.2, 1.1], arm="left")
    perform(type="opening-gripper", gripper="left")
    milk = tried(type="detecting", object_type="milk")  # 5: there is none
    try:
        with par as s:
            perform(type="pick-up", object=cup, arm="left")  # 6: it fell
            perform(type="pick-up", object=bowl, arm="right", grasp="left")
    except PlanFailure:
        pass
    perform(type="pick-up", object=milk, arm="right")
"""


@pytest.fixture(scope="module")
def robot_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    (folder / "plan.py").write_text(dedent(START) + dedent(ROBOT))
    assert executed(folder / "plan.py") == 1
    return folder / "x.mcap"


@pytest.fixture
def robot(robot_log: Path) -> Iterator[Recording]:
    with replay.open(robot_log) as log:
        yield log


def numbered(log: Recording, text: str) -> int:
    lines = (log.path.parent / "plan.py").read_text().splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


@pytest.mark.slow
def test_a_swallowed_failure_explains_the_later_one(robot: Recording) -> None:
    (cause,) = robot.why("task:place#1@end").causes
    assert (cause.kind, cause.precondition) == ("swallowed-failure", "held")
    assert (cause.subject, cause.arm) == ("cup", "left")
    assert cause.failed.last_step == robot.step("task:pick-up#1@end")
    assert cause.went_on.number == numbered(robot, "# 1: too far") + 1
    assert cause.steps[0] == cause.failed.last_step
    assert robot.step("task:place#1@start") < cause.steps[-1] <= robot.step("task:place#1@end")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("since", "cause"),
    [
        ("robot.attach(milk, tool); robot.detach(milk)", kinds.HandState),
        ("pass", kinds.Swallowed),
    ],
    ids=["taken after all", "nothing"],
)
def test_a_failure_explains_nothing_once_the_same_was_done(
    explained: Callable[..., Why], since: str, cause: type[kinds.Cause]
) -> None:
    why = explained(f"""
        {WITH_PR2}
        try:
            perform(type="pick-up", object=milk, arm="left")
        except PlanFailure:
            pass
        {since}
        perform(type="place", object=milk, target=[1, 0, 0.1], arm="left")
    """)
    assert [type(each) for each in why.causes] == [cause]


def test_the_other_hand_that_took_it_in_the_end_is_told_instead(explained: Callable[..., Why]) -> None:
    why = explained(f"""
        {WITH_PR2}
        try:
            perform(type="pick-up", object=milk, arm="left")
        except PlanFailure:
            pass
        robot.attach(milk, "r_gripper_tool_frame")
        perform(type="place", object=milk, target=[1, 0, 0.1], arm="left")
    """)
    (cause,) = why.causes
    assert isinstance(cause, kinds.HandState)
    assert cause.holder == "right"


def test_a_failed_drive_is_no_cause_once_the_robot_was_moved_otherwise(explained: Callable[..., Why]) -> None:
    why = explained(f"""
        {WITH_PR2}
        crate = Object("crate", "crate", "breakfast_cereal.stl", [6.5, 0, 0.2])
        try:
            perform(type="moving", target=[6.5, 0, 0])
        except PlanFailure:
            pass
        robot.set_position([-9, 0, 0])
        perform(type="pick-up", object=milk, arm="left")
    """)
    assert not [each for each in why.causes if isinstance(each, kinds.Swallowed)]
    (far,) = [each for each in why.causes if isinstance(each, kinds.OutOfReach)]
    assert ("pr2", "command") in [(each.body, each.how) for each in far.changes]


@pytest.mark.parametrize("name", ["lab", "another"])
def test_a_failure_in_another_world_explains_nothing(explained: Callable[..., Why], name: str) -> None:
    why = explained(f"""
        {WITH_PR2}
        try:
            perform(type="pick-up", object=milk, arm="left")
        except PlanFailure:
            pass
        world.exit()
        world = BulletWorld(name="{name}")
        robot = world.robot = Object("pr2", "robot", "pr2.urdf")
        milk = Object("milk", "milk", "milk.stl", [7, 0, 0.1])
        perform(type="place", object=milk, target=[1, 0, 0.1], arm="left")
    """)
    assert [type(each) for each in why.causes] == [kinds.HandState]


def test_what_no_longer_held_is_told_with_the_change(robot: Recording) -> None:
    (cause,) = robot.why("task:pick-up#2@end").causes
    assert cause.kind == "no-longer-true"
    assert cause.asked.name == "reachable_object"
    (change,) = cause.changes
    assert (change.body, change.how) == ("cup", "command")
    assert change.line.number == numbered(robot, "# 2: no longer") - 1


@pytest.mark.slow
def test_a_hand_that_is_not_free_is_told_with_what_should_have_freed_it(robot: Recording) -> None:
    why = robot.why("task:accessing@end")
    (cause,) = why.causes
    assert (cause.kind, cause.precondition, cause.subject) == ("swallowed-failure", "hand-free", "cup")
    assert cause.failed.last_step == robot.step("task:place#3@end")
    kitchen = next(involved for involved in why.bodies if involved.body.name == "kitchen")
    assert set(kitchen.joints) == {"sink_area_left_upper_drawer_main_joint"}
    assert set(kitchen.links) == {"sink_area_left_upper_drawer_handle"}
    cup = next(involved for involved in why.bodies if involved.body.name == "cup")
    assert cup.hands == {"cup": "left"}


@pytest.mark.slow
def test_what_is_in_the_way_is_in_the_scene_with_its_link_and_what_put_it_there(robot: Recording) -> None:
    why = robot.why("task:place#5@end")
    let_go, cause = why.causes
    assert (let_go.kind, let_go.body, let_go.how) == ("physics", "cup", "tipped")
    assert (cause.kind, cause.body, cause.mover) == ("in-the-way", "bowl", "cup")
    assert cause.change.line.number == numbered(robot, "bowl.set_position")
    assert "bowl" in [involved.body.name for involved in why.bodies]


@pytest.mark.slow
def test_all_failing_branches_have_their_scene_and_their_causes(robot: Recording) -> None:
    why = robot.why(robot.step("task:pick-up#-2@end"))
    (branch,) = why.branches
    by_arm = {why.task.motion.parameters["arm"]: why.causes, branch.task.motion.parameters["arm"]: branch.causes}
    fell = next(cause for cause in by_arm["left"] if isinstance(cause, kinds.Physics))
    assert (fell.body, fell.how, fell.hand) == ("cup", "fell", "left")
    assert fell.lets[0].task.name == "opening-gripper"
    names = {involved.body.name for involved in branch.bodies}
    assert names >= {"pr2", *([] if branch.task.motion.parameters["arm"] == "left" else ["bowl"])}


@pytest.mark.slow
def test_a_variable_without_a_value_leads_to_the_failure_that_left_it_so(robot: Recording) -> None:
    cause, mistake = robot.why().causes
    assert (cause.kind, cause.precondition, cause.subject) == ("swallowed-failure", "result", "milk")
    assert cause.failed.name == "detecting"
    assert (mistake.kind, mistake.own) == ("raised", False)
    assert mistake.line.text == 'perform(type="pick-up", object=milk, arm="right")'


@pytest.mark.slow
def test_json_has_the_kinds_and_fields_that_the_page_documents(
    robot_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for step in ("task:place#1@end", "task:pick-up#2@end", "task:accessing@end", "task:place#5@end", "failure"):
        assert main(["why", "--json", str(robot_log), step]) == 0
        for cause in json.loads(capsys.readouterr().out)["causes"]:
            assert set(cause) == documented()[cause["kind"]] | {"kind", "steps", "text"}
            assert cause["text"]


@pytest.mark.slow
def test_the_page_shows_what_a_reader_gets(
    robot_log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(robot_log.parent)
    assert main(["why", str(robot_log), "task:place@end"]) == 0
    output = {without_numbers(line) for line in capsys.readouterr().out.splitlines()}
    shown = DOCS.read_text().partition("$ pycram-replay why")[2].partition("```")[0].splitlines()[1:]
    assert len(shown) > 5
    for line in shown:
        assert line == "..." or without_numbers(line) in output, line


def without_numbers(line: str) -> str:
    return re.sub(r"\d+(?:\.\d+)?", "#", line)


def documented() -> dict[str, set[str]]:
    """The fields of each kind of cause by the page's table."""
    rows = re.findall(r"^\| `([a-z-]+)` \|[^|]*\|([^|]*)\|$", DOCS.read_text(), re.MULTILINE)
    return {kind: set(re.findall(r"`(\w+)`", text)) for kind, text in rows}


def test_the_page_documents_every_kind_of_cause_with_its_fields() -> None:
    tree = ast.parse(Path(kinds.__file__).read_text())
    classes = [getattr(kinds, node.name) for node in tree.body if isinstance(node, ast.ClassDef)]
    causes = [each for each in classes if issubclass(each, kinds.Cause) and each is not kinds.Cause]
    assert documented() == {each.kind: {field.name for field in fields(each)} - {"steps"} for each in causes}
