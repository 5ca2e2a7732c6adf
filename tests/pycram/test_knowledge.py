"""What a robot believes of objects: by looking, holding and putting down; in the plan, and in recordings of it."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, PlanFailure
from pycram.knowledge import Belief, beliefs, believed, learn
from pycram.process_module import ProcessModule
from pycram.projection import project
from pycram.world import transaction
from recorder.records import Keyframe
from replay.cli.main import main
from replay.errors import NoSuchName
from replay.report.question import BadQuestion
from replay.restore.verify import verify
from tests.replay.copies import rewritten_by_mcap

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.state.state import State

TOOL = "tool0"


class Bench:
    """An arm, a cup and a milk carton in a world without gravity."""

    def __init__(self, world: BulletWorld) -> None:
        self.world = world
        self.arm = world.robot = Object("arm", "robot", "ur5.urdf", world=world)
        self.cup = Object("cup", "cup", "cup.stl", [1, 0, 0.5], world=world)
        self.milk = Object("milk", "milk", "milk.stl", [1, 1, 0.5], world=world)

    def seen(self) -> dict[str, str]:
        return {belief.object.name: belief.source for belief in beliefs()}


@pytest.fixture
def bench(world: BulletWorld) -> Bench:
    return Bench(world)


def look(*bodies: Object) -> None:
    learn({body: body.get_position_and_orientation() for body in bodies})


def at(belief: Belief | None) -> list[float]:
    assert belief is not None
    return [round(part, 6) for part in belief.position]


def test_what_was_never_seen_is_not_believed(bench: Bench) -> None:
    assert believed("cup") is None
    assert believed(bench.milk) is None
    assert beliefs() == []


def test_an_object_is_believed_where_it_was_seen_until_it_is_seen_elsewhere(bench: Bench) -> None:
    look(bench.cup)
    bench.cup.set_position([0, 2, 0.5])
    assert at(believed("cup")) == [1, 0, 0.5]
    assert believed(bench.milk) is None
    look(bench.cup)
    assert at(believed(bench.cup)) == [0, 2, 0.5]


def test_of_several_of_a_type_the_one_that_was_seen_last_comes_first(bench: Bench) -> None:
    other = Object("other", "cup", "cup.stl", [2, 0, 0.5])
    look(bench.cup)
    look(other)
    assert [belief.object for belief in beliefs("cup")] == [other, bench.cup]
    look(bench.cup)
    assert believed("cup").object is bench.cup
    assert believed("other").object is other


def test_what_is_held_is_in_the_hand_and_stays_where_it_is_put_down(bench: Bench) -> None:
    arm, cup = bench.arm, bench.cup
    arm.attach(cup, TOOL)
    assert believed("cup").source == "held"
    arm.set_joint_position(arm.joints[0], 1.0)
    held = believed("cup")
    assert list(held.position) == cup.get_position()
    look(cup)
    assert believed("cup").source == "held"
    arm.detach(cup)
    put = cup.get_position()
    cup.set_position([5, 5, 5])
    assert believed("cup").source == "placed"
    assert list(believed("cup").position) == put


def test_what_stands_attached_on_something_held_is_held_too(bench: Bench) -> None:
    bench.milk.attach(bench.cup)
    assert beliefs() == []
    bench.arm.attach(bench.milk, TOOL)
    assert bench.seen() == {"milk": "held", "cup": "held"}
    bench.arm.detach(bench.milk)
    assert bench.seen() == {"milk": "placed", "cup": "placed"}


def test_each_robot_has_beliefs_of_its_own(bench: Bench) -> None:
    other = Object("other", "robot", "ur5.urdf", [3, 0, 0])
    look(bench.cup)
    learn({bench.milk: bench.milk.get_position_and_orientation()}, robot=other)
    assert [belief.object for belief in beliefs()] == [bench.cup]
    assert [belief.object for belief in beliefs(robot=other)] == [bench.milk]
    bench.world.set_robot(other)
    assert believed("cup") is None
    other.remove()
    assert [belief.object for belief in beliefs(robot=bench.arm)] == [bench.cup]


def test_a_saved_state_brings_back_what_was_believed_and_a_reset_nothing(bench: Bench) -> None:
    look(bench.cup)
    saved = bench.world.save()
    look(bench.milk)
    bench.arm.attach(bench.cup, TOOL)
    bench.world.restore(saved)
    assert bench.seen() == {"cup": "seen"}
    bench.world.reset()
    assert beliefs() == []


def test_what_is_removed_is_not_believed_any_more(bench: Bench) -> None:
    look(bench.cup, bench.milk)
    bench.cup.remove()
    assert bench.seen() == {"milk": "seen"}


def test_a_projection_begins_with_what_is_believed_and_keeps_what_it_learns(bench: Bench) -> None:
    look(bench.cup)

    def learned() -> list[str]:
        look(bench.milk)
        return sorted(bench.seen())

    outcome = project(learned)
    assert outcome.result == ["cup", "milk"]
    assert sorted(bench.seen()) == ["cup"]


def test_wrong_arguments_say_what_is_wrong(bench: Bench) -> None:
    with pytest.raises(BadArgument, match="an Object, or a type or a name of objects"):
        believed(3)
    with pytest.raises(BadArgument, match='an object of type "robot"'):
        believed("cup", robot=bench.cup)
    with BulletWorld() as elsewhere:
        stranger = Object("cup", "cup", "cup.stl", world=elsewhere)
        BulletWorld.current_bullet_world = bench.world
        with pytest.raises(BadArgument, match="objects of"):
            look(stranger)
    assert beliefs() == []


# --- recordings -------------------------------------------------------------------------------------------------------


def believed_in(state: State) -> list[tuple[object, ...]]:
    """What a recording says is believed."""
    return [
        (belief.object, belief.source, belief.position, belief.orientation, belief.sim_step, belief.step)
        for belief in state.world("bench").believed()
    ]


def now() -> list[tuple[object, ...]]:
    """What the plan says."""
    return [
        (each.object.name, each.source, each.position, each.orientation, each.sim_step, each.step) for each in beliefs()
    ]


def plan(bench: Bench) -> Iterator[list[tuple[object, ...]]]:
    """What happens to an arm; yields what it believes after each change."""
    arm, cup, milk, world = bench.arm, bench.cup, bench.milk, bench.world
    look(cup, milk)
    yield now()
    milk.set_position([2, 2, 2])
    yield now()
    arm.attach(cup, TOOL)
    yield now()
    arm.set_joint_position(arm.joints[1], -0.5)
    yield now()
    saved = world.save()
    arm.detach(cup)
    yield now()
    world.simulate(0.1)
    look(milk)
    yield now()
    world.restore(saved)
    yield now()
    ProcessModule.perform(MotionDesignator([("type", "world-state-detecting"), ("object-type", "milk")]))
    yield now()
    milk.remove()
    yield now()
    world.reset()
    yield now()


@pytest.fixture(params=[1, 2, 1000], ids="a keyframe each {} changes".format)
def keyframes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(transaction, "TRANSACTIONS_PER_KEYFRAME", request.param)
    return request.param


def test_a_recording_has_at_each_step_what_was_believed(tmp_path: Path, keyframes: int) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld(name="bench") as world:
        expected = list(plan(Bench(world)))
    with replay.open(path) as log:
        assert verify(log).exact
        assert bool(list(log.records(Keyframe))) == (keyframes < 1000)
        states = [believed_in(log.state_at(step)) for step in range(1, log.final_step() + 1)]
        assert [each for each, _ in groupby(states) if each] == [each for each, _ in groupby(expected) if each]
        assert states[-1] == []


def test_a_copy_by_another_program_whose_channels_name_no_world_tells_the_same(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld(name="bench") as world:
        for _ in plan(Bench(world)):
            pass
    copy = rewritten_by_mcap(path, tmp_path / "copy.mcap", bare_channels=True)
    with replay.open(path) as log, replay.open(copy) as other:
        steps = range(1, log.final_step() + 1)
        assert [believed_in(other.state_at(step)) for step in steps] == [
            believed_in(log.state_at(step)) for step in steps
        ]


def moved_unseen(bench: Bench) -> int:
    """Looks at the cup and moves it by half a metre; returns the step at which it was seen."""
    look(bench.cup)
    seen = believed("cup").step
    bench.cup.set_position([1, 0.5, 0.5])
    return seen


def test_state_prints_what_is_believed_and_how_far_that_is_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld(name="bench") as world:
        seen = moved_unseen(Bench(world))
    main(["state", str(path), str(seen + 1)])
    line = capsys.readouterr().out.splitlines()[-1]
    expected = f"arm believes cup at [1.0000, 0.0000, 0.5000]: seen at step {seen}, at 0.000 s; its true position is 0.500 m away"
    assert line.strip() == expected


def test_what_is_believed_is_asked_of_a_step_and_compared_between_steps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld(name="bench") as world:
        bench = Bench(world)
        seen = moved_unseen(bench)
        look(bench.cup)
        again = believed("cup").step
    with replay.open(path) as log:
        answer = log.ask(again - 1, "believed('cup')")
        assert (answer.answer, answer.evidence["step"], answer.evidence["away"]) == (True, seen, 0.5)
        assert answer.evidence["position"] == [1.0, 0.0, 0.5]
        assert log.ask(again, "believed(cup, robot=arm)").evidence["away"] == 0.0
        assert log.ask(again, "believed(milk)").answer is False
        with pytest.raises(NoSuchName, match="did you mean cup"):
            log.ask(again, "believed(cupp)")
        for wrong in ("believed()", "believed(1)", "believed(cup, what=milk)", "believed(cup, arm, 3)"):
            with pytest.raises(BadQuestion, match=r"believed\(what, robot\)"):
                log.ask(again, wrong)
    main(["ask", str(path), str(again - 1), "believed('cup')"])
    assert "believed('cup'): yes" in capsys.readouterr().out.splitlines()
    main(["diff", str(path), str(seen - 1), str(again)])
    lines = capsys.readouterr().out.splitlines()
    assert "bench: where arm believes cup unknown -> [1, 0.5, 0.5]" in lines
    main(["diff", str(path), str(seen), str(again)])
    assert "bench: where arm believes cup [1, 0, 0.5] -> [1, 0.5, 0.5]" in capsys.readouterr().out


def test_a_restored_world_has_the_beliefs_of_its_step(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld(name="bench") as world:
        bench = Bench(world)
        look(bench.cup, bench.milk)
        bench.arm.attach(bench.cup, TOOL)
        expected, step = now(), believed("cup").step
        world.simulate(0.05)
    with replay.open(path) as log:
        for exact in (False, True):
            with log.world_at(step, exact=exact):
                assert now() == expected
                BulletWorld.robot.detach(believed("cup").object)
                assert believed("cup").source == "placed"
        assert log.believed(step, "milk").source == "seen"
        assert log.believed(step - 1, "cup").source == "seen"
        assert log.believed(step, "spoon") is None


def test_a_recording_that_begins_later_knows_what_was_believed_before(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with BulletWorld(name="bench") as world:
        bench = Bench(world)
        look(bench.cup)
        assert believed("cup").step == -1
        with recorder.record(path):
            look(bench.milk)
            during = believed("milk").step
            assert believed("cup").step == -1
        assert during > 0
        assert believed("milk").step == -1
    with replay.open(path) as log:
        assert verify(log).sound
        assert [(each[0], each[-1]) for each in believed_in(log.state_at(-1))] == [("milk", during), ("cup", -1)]


def test_why_says_what_was_believed_and_what_had_moved_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder.record(path), BulletWorld(name="bench") as world:
        bench = Bench(world)
        look(bench.cup)
        seen = believed("cup").step
        bench.cup.set_position([5, 0, 0.5])
        with pytest.raises(PlanFailure):
            ProcessModule.perform(MotionDesignator([("type", "pick-up"), ("object", bench.cup)]))
    with replay.open(path) as log:
        cause = next(each for each in log.why().causes if each.kind == "misbelief")
        assert (cause.body, cause.source, cause.learned, cause.distance) == ("cup", "seen", seen, 4.0)
        assert cause.change.how == "command"
        assert seen < cause.change.step < cause.steps[-1]
