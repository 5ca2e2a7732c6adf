"""Actions are tried choice by choice, until one does or the budget is spent; if asked, they are imagined first."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import pytest

import recorder
import replay
from pycram import tasks
from pycram.action_designators import fetching, picking_up
from pycram.actions import ActionFailed, action, perform, projecting, replaced
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import ActionDesignator, DesignatorError, MotionDesignator, ObjectDesignator
from pycram.failures import BadArgument, GraspFailed, MissingPart, NoPlace, PlanFailure, ReasoningError, UnknownName
from pycram.knowledge import learn
from pycram.language import par
from pycram.motion_designators import move_arm_joints
from pycram.process_module import ProcessModule
from pycram.projection import project
from pycram.reasoning.collision.ray_cast import center
from recorder import geometry
from recorder.records import Task
from recorder.tasks.tree import walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

NUMBERS = ("one", "two", "three", "four", "five", "six")


@pytest.fixture(autouse=True)
def world() -> Iterator[BulletWorld]:
    """A world with a gripper for a robot, and a cup."""
    world = BulletWorld()
    world.robot = Object("gripper", "robot", "two_finger_gripper.urdf")
    Object("cup", "cup", "cup.stl", [1, 0, 0])
    yield world
    world.exit()


class Counting:
    """An action that tries numbers, of which some do."""

    def __init__(self, *does: str) -> None:
        self.does = does
        self.offered: list[str] = []
        self.tried: list[str] = []

    def numbers(self) -> Iterator[Mapping[str, Any]]:
        for number in NUMBERS:
            self.offered.append(number)
            yield {"number": number}

    def count(self, number: str = "", unit: str = "m") -> str:
        """Counts.

        Args:
            number: What is counted
                up to.
            unit: Of what.
        """
        self.tried.append(number)
        if number not in self.does:
            raise GraspFailed("left", number, "it slips")
        return f"{number} {unit}"


def test_choices_are_tried_in_their_order_each_as_a_task_and_no_more_are_found_than_needed() -> None:
    counting = Counting("three", "four")
    with replaced("counting", counting.count, choices=counting.numbers):
        assert perform(ActionDesignator(type="counting", unit="s")) == "three s"
    assert counting.tried == counting.offered == ["one", "two", "three"]
    (*_, act) = tasks.tree().find(kind="action", name="counting")
    (handling,) = act.children
    assert [(each.name, each.status) for each in handling.children] == [
        ("attempt 1", tasks.State.FAILED),
        ("attempt 2", tasks.State.FAILED),
        ("attempt 3", tasks.State.SUCCEEDED),
    ]
    assert handling.children[1].failure.message == "left gripper can't grasp two: it slips"


def test_what_was_tried_is_told_when_there_is_nothing_else() -> None:
    counting = Counting()
    with (
        replaced("counting", counting.count, choices=counting.numbers),
        pytest.raises(ActionFailed) as raised,
    ):
        perform(ActionDesignator(type="counting"))
    assert [each.choice for each in raised.value.tried] == [{"number": number} for number in NUMBERS]
    assert {type(each.failure) for each in raised.value.tried} == {GraspFailed}
    assert (raised.value.action, raised.value.spent, raised.value.last) == ("counting", False, None)
    assert "counting failed after 6 tries, there is nothing else to try: GraspFailed: left" in str(raised.value)


def test_the_budget_is_that_of_an_action_with_those_that_it_is_made_of() -> None:
    inner, tried = Counting(), []

    def outer(way: str = "") -> None:
        tried.append(way)
        perform(ActionDesignator(type="counting", budget=5))

    def ways() -> Iterator[Mapping[str, Any]]:
        yield from ({"way": way} for way in "abcdef")

    with (
        replaced("counting", inner.count, choices=inner.numbers),
        replaced("going", outer, choices=ways),
        pytest.raises(ActionFailed) as raised,
    ):
        perform(ActionDesignator(type="going", budget=8))
    # a: all five of its own, and itself; b: the two that are left
    assert (tried, len(inner.tried), raised.value.spent) == (["a", "b"], 7, True)
    assert str(raised.value).startswith(
        "going failed after 2 tries, other actions spent the rest of the budget of 8 tries"
    )
    assert str(raised.value.tried[0].failure).startswith("counting failed after 5 tries, the budget is spent: ")


def test_where_all_is_said_nothing_is_tried_and_the_failure_is_raised_as_it_is() -> None:
    counting = Counting("one")

    def one(number: str) -> Iterator[Mapping[str, Any]]:
        yield {"number": number}

    with replaced("counting", counting.count, choices=one):
        assert perform(ActionDesignator(type="counting", number="one")) == "one m"
        with pytest.raises(GraspFailed):
            perform(ActionDesignator(type="counting", number="two"))
    (*_, act) = tasks.tree().find(kind="action", name="counting")
    assert not act.children


def test_why_there_is_nothing_to_choose_is_raised_as_it_is() -> None:
    def none() -> Iterator[Mapping[str, Any]]:
        raise ReasoningError("there is nothing")
        yield {}

    counting = Counting("one")
    with (
        replaced("counting", counting.count, choices=none),
        pytest.raises(ReasoningError, match="there is nothing"),
    ):
        perform(ActionDesignator(type="counting"))
    assert not counting.tried


def test_an_error_of_the_program_is_no_reason_to_try_the_next_choice() -> None:
    counting = Counting("two")

    def broken(number: str = "") -> None:
        counting.count(number)
        raise UnknownName("joint", "elbo", "the arm", ["elbow"])

    with (
        replaced("counting", broken, choices=lambda: ({"number": number} for number in ("two", "three"))),
        pytest.raises(UnknownName),
    ):
        perform(ActionDesignator(type="counting"))
    assert counting.tried == ["two"]


def test_users_put_their_own_action_in_the_place_of_another() -> None:
    mine = Counting("six")

    def take(object: Any, arm: str | None = None, grasp: str | None = None, number: str = "") -> str:  # noqa: A002
        return f"{object.name}: {mine.count(number, unit=str(arm))}"

    with replaced("picking-up", take, choices=mine.numbers):
        cup = BulletWorld.current_bullet_world.get_object("cup")
        assert perform(ActionDesignator(type="picking-up", object=cup, arm="left")) == "cup: six left"
    with pytest.raises(DesignatorError, match="unknown slot number"):
        perform(ActionDesignator(type="picking-up", object="cup", number="six"))


def test_a_given_slot_keeps_its_value_unless_the_choices_know_about_it() -> None:
    """An action of a user's own was asked for one value, and its choices tried others."""
    counting = Counting("two")

    def numbers() -> Iterator[Mapping[str, Any]]:
        yield from ({"number": number} for number in ("one", "two"))

    with replaced("counting", counting.count, choices=numbers):
        assert perform(ActionDesignator(type="counting", number="two")).startswith("two")
        assert counting.tried == ["two"]
        with pytest.raises(PlanFailure):
            perform(ActionDesignator(type="counting", number="one"))
        assert counting.tried == ["two", "one"], "tried once, as there is one choice"


def test_what_replaces_an_action_takes_its_slots() -> None:
    """Others may give it any of them: they would fail in the middle of a plan."""

    def take(object: Any, arm: str | None = None) -> None:  # noqa: A002
        """Takes no grasp."""

    with (
        pytest.raises(BadArgument, match=r"takes all slots of picking-up; it lacks grasp"),
        replaced("picking-up", take),
    ):
        pytest.fail("it was replaced")
    with pytest.raises(DesignatorError, match="one of front, top, left, right"):  # as before
        perform(ActionDesignator(type="picking-up", object="cup", grasp="below"))


def test_a_choice_of_a_slot_that_there_is_not_is_an_error() -> None:
    counting = Counting("one")

    def wrong() -> Iterator[Mapping[str, Any]]:
        yield {"nunber": "one"}

    with replaced("counting", counting.count, choices=wrong), pytest.raises(DesignatorError) as raised:
        perform(ActionDesignator(type="counting"))
    assert "a choice has the unknown slot nunber; did you mean number?" in str(raised.value)
    assert counting.tried == []


def test_a_process_module_says_what_performs_an_action() -> None:
    with pytest.raises(DesignatorError, match=r"is performed by pycram\.actions\.perform, not by ProcessModule"):
        ProcessModule.perform(ActionDesignator(type="picking-up", object="cup"))


def test_resolvers_of_users_are_asked_first() -> None:
    counting = Counting("six", "five")

    def resolver(designator: ActionDesignator) -> list[dict[str, str]] | None:
        if designator.type != "numbering":
            return None
        return [{"action": "counting", "number": number} for number in ("six", "five")]

    with (
        replaced("counting", counting.count, choices=counting.numbers),
        ActionDesignator.resolvers.added(resolver),
    ):
        designator = ActionDesignator(type="numbering", what="cups")
        assert perform(designator) == "six m"
        following = designator.next_solution()
        assert following is not None
        assert following.reference() == {"action": "counting", "number": "five"}
        assert following.equal(designator)
        assert perform(following) == "five m"


def test_actions_are_branches_of_blocks_and_wait_for_what_their_slots_stand_for() -> None:
    counting = Counting("one", "two")
    with replaced("counting", counting.count):
        with par:
            first = perform(ActionDesignator(type="counting", number="one"))
            second = perform(ActionDesignator(type="counting", number="two", unit=first))
        assert second.result() == "two one m"


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        ({"type": "pickin-up"}, "unknown type 'pickin-up'; did you mean picking-up?"),
        ({}, "has no slot type"),
        ({"type": "picking-up"}, "missing slot object"),
        ({"type": "picking-up", "object": "cup", "amr": "left"}, "unknown slot amr; did you mean arm?"),
        ({"type": "picking-up", "object": "cpu"}, "no object of type 'cpu'; did you mean cup?"),
        ({"type": "picking-up", "object": "cup", "grasp": "below"}, "one of front, top, left, right"),
        ({"type": "picking-up", "object": "cup", "budget": -1}, "a whole number from 0 up"),
        ({"type": "placing", "object": "cup", "target": [0, 0]}, "3 finite numbers"),
        ({"type": "fetching", "object": "cup", "place": [0, 0, 0]}, "a LocationDesignator"),
    ],
)
def test_wrong_slots_are_refused_before_anything_is_done(slots: dict[str, Any], message: str) -> None:
    before = len(tasks.tree())
    with pytest.raises(DesignatorError) as raised:
        perform(ActionDesignator(slots))
    assert message in str(raised.value)
    assert len(tasks.tree()) == before


def test_a_robot_without_arms_is_told_so_before_anything_moves(world: BulletWorld) -> None:
    learn({world.get_object("cup"): ([1, 0, 0], [0, 0, 0, 1])})
    with pytest.raises(MissingPart, match="gripper has no arm"):
        perform(ActionDesignator(type="transporting", object="cup", target=[0, 1, 0]))


def test_what_isn_t_to_be_performed_is_refused() -> None:
    with pytest.raises(DesignatorError, match="perform takes a designator of an action or a motion"):
        perform(ObjectDesignator(type="cup"))


def test_slots_are_given_as_pairs_or_by_keyword(world: BulletWorld) -> None:
    pairs = ActionDesignator([("type", "x"), ("reachable-for", 1), ("in", 2)])
    assert ActionDesignator(type="x", reachable_for=1, in_=2).description == pairs.description
    assert ActionDesignator({"type": "x"}, reachable_for=1, in_=2).description == pairs.description


def test_an_object_designator_stands_for_what_is_believed_also_in_motions(world: BulletWorld) -> None:
    cup = world.get_object("cup")
    with pytest.raises(PlanFailure, match="cup was never seen"):
        ObjectDesignator(type="cup").reference()
    learn({cup: ([1, 0, 0.5], [0, 0, 0, 1])})
    assert ObjectDesignator(type="cup").reference()["object"] is cup
    assert ObjectDesignator(type="cup").reference()["position"] == [1, 0, 0.5]
    assert MotionDesignator(type="pick-up", object=ObjectDesignator(type="cup")).reference()["object"] is cup
    second = Object("cup 2", "cup", "cup.stl", [0, 1, 0])
    learn({second: ([0, 1, 0], [0, 0, 0, 1])})
    motion = MotionDesignator(type="pick-up", object=ObjectDesignator(type="cup"), arm="left")
    assert [each["object"] for each in motion.solutions()] == [second, cup]  # what was seen last comes first


def moves(world: BulletWorld, *does: str) -> Any:
    """An action that moves the cup, and then says whether that was right."""

    def move(number: str = "") -> str:
        cup = world.get_object("cup")
        assert list(cup.get_position()) == [1, 0, 0], "something has been moved before"
        cup.set_position([0, 0, float(NUMBERS.index(number))])
        if number not in does:
            raise GraspFailed("left", number, "it slips")
        return number

    return replaced("moving-cup", move, choices=lambda: ({"number": number} for number in NUMBERS))


def test_what_was_imagined_first_is_done_and_what_failed_so_is_not(world: BulletWorld) -> None:
    with moves(world, "three", "four"), projecting():
        assert perform(ActionDesignator(type="moving-cup")) == "three"
    assert world.get_object("cup").get_position()[2] == 2.0
    (*_, act) = tasks.tree().find(kind="action", name="moving-cup")
    imagined = [node for node in act.children if node.kind == "projection"]
    assert [node.parameters["number"] for node in imagined] == ["one", "two", "three"]
    (handling,) = (node for node in act.children if node.kind == "failure-handling")
    assert [node.parameters for node in handling.children] == [{"number": "three"}]


def test_if_nothing_succeeds_in_imagination_nothing_is_done(world: BulletWorld) -> None:
    with moves(world), pytest.raises(ActionFailed) as raised:
        perform(ActionDesignator(type="moving-cup", projected=True))
    assert list(world.get_object("cup").get_position()) == [1, 0, 0]
    assert [(each.choice["number"], each.imagined) for each in raised.value.tried] == [
        (number, True) for number in NUMBERS
    ]


def test_no_more_is_imagined_than_the_budget_allows(world: BulletWorld) -> None:
    with moves(world, "six"), projecting(budget=3), pytest.raises(ActionFailed) as raised:
        perform(ActionDesignator(type="moving-cup"))
    assert len(raised.value.tried) == 3

    def wait(number: str = "") -> None:
        world.simulate(1.0)
        raise GraspFailed("left", number, "it slips")

    with (
        replaced("waiting", wait, choices=lambda: ({"number": number} for number in (*NUMBERS, *NUMBERS))),
        projecting(budget=12, seconds=3.5),
        pytest.raises(ActionFailed) as raised,
    ):
        perform(ActionDesignator(type="waiting"))
    assert len(raised.value.tried) == 5  # one, then four that are begun at once


def test_what_was_found_before_there_is_nothing_more_is_imagined_too(world: BulletWorld) -> None:
    def few() -> Iterator[Mapping[str, Any]]:
        yield {"number": "one"}
        yield {"number": "two"}
        raise ReasoningError("there are no others")

    counting = Counting("two")
    with replaced("counting", counting.count, choices=few), projecting():
        assert perform(ActionDesignator(type="counting")) == "two m"
    counting.does = ()
    with replaced("counting", counting.count, choices=few), projecting(), pytest.raises(ActionFailed) as raised:
        perform(ActionDesignator(type="counting"))
    assert len(raised.value.tried) == 2
    assert isinstance(raised.value.last, ReasoningError)


def test_what_is_imagined_imagines_nothing_itself(world: BulletWorld) -> None:
    def outer(way: str = "") -> str:
        return f"{way} {perform(ActionDesignator(type='moving-cup', projected=True))}"

    with (
        moves(world, "one"),
        replaced("going", outer, choices=lambda: ({"way": way} for way in "ab")),
        projecting(),
    ):
        assert perform(ActionDesignator(type="going")) == "a one"
    (*_, act) = tasks.tree().find(kind="action", name="going")
    assert [node.kind for _, node in walk([act])].count("projection") == 1


@pytest.mark.parametrize(("budget", "seconds"), [(0, None), (1.5, None), (True, None), (3, 0), (3, "long")])
def test_wrong_limits_of_thinking_are_refused(budget: Any, seconds: Any) -> None:
    with pytest.raises(ValueError, match=r"budget|seconds"):
        projecting(budget, seconds=seconds)


def test_slots_and_texts_are_those_of_the_function() -> None:
    counting = Counting()
    with replaced("counting", counting.count), pytest.raises(DesignatorError) as raised:
        perform(ActionDesignator(type="counting", size=1))
    message = str(raised.value)
    assert "number (optional): What is counted up to\n" in message
    assert "unit (optional): Of what\n" in message


def test_an_action_has_a_name() -> None:
    with pytest.raises(ValueError, match="name"):
        action("")


@pytest.fixture
def counter(world: BulletWorld) -> Iterator[BulletWorld]:
    """A PR2 with folded arms before the counter."""
    world.exit()
    with BulletWorld() as kitchen:
        kitchen.set_gravity([0, 0, -9.81])
        Object("kitchen", "environment", "kitchen.urdf")
        kitchen.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
        perform(move_arm_joints(arms={"left": "park", "right": "park"}))
        yield kitchen


def moved_as_advised(failure: PlanFailure, body: Object) -> None:
    advice = str(failure).rpartition("; ")[2]
    turn, slide = (re.search(pattern, advice) for pattern in (r"turn \w+ by (\d+) degrees", r"to \[(.*?), (.*?)\], at"))
    position, orientation = body.get_position_and_orientation()
    if turn:
        about = geometry.from_rpy(0, 0, math.radians(int(turn[1])))
        middle = center(body)
        from_middle = geometry.multiply(([-x for x in middle], geometry.IDENTITY[1]), (position, orientation))
        body.set_position_and_orientation(*geometry.multiply((middle, about), from_middle))
    elif slide:
        body.set_position([float(slide[1]), float(slide[2]), position[2]])
    assert turn or slide
    assert body.world.settle()


@pytest.mark.parametrize(
    ("body", "where", "yaw", "slots", "advice"),
    [
        ("breakfast_cereal", [1.4, 0.85, 0.98], math.pi / 2, {"grasp": "front"}, "turn cereal by 60 degrees"),
        ("milk", [1.62, 0.6, 0.95], 0.0, {}, "slide milk by 35 cm to [1.27, 0.60], at an edge of counter"),
    ],
)
def test_an_object_that_can_t_be_taken_is_advised_to_be_turned_or_slid_where_that_was_seen_to_help(
    counter: BulletWorld, tmp_path: Path, body: str, where: list[float], yaw: float, slots: dict[str, Any], advice: str
) -> None:
    kind = body.rpartition("_")[2]
    thing = Object(kind, kind, f"{body}.stl", where, geometry.from_rpy(0, 0, yaw))
    assert counter.settle()
    before, stands = counter.sim_step, thing.get_position_and_orientation()
    with recorder.record(tmp_path / "run.mcap"), pytest.raises(PlanFailure) as raised:
        perform(picking_up(object=thing, **slots))
    assert str(raised.value).endswith(f"; {advice}, then the robot can take it")
    assert (counter.sim_step, thing.get_position_and_orientation()) == (before, stands)
    with replay.open(tmp_path / "run.mcap") as log:
        assert "projection" not in {task.kind for task in log.records(Task)}
    assert [each.name for each in tmp_path.iterdir()] == ["run.mcap"]
    moved_as_advised(raised.value, thing)
    perform(picking_up(object=thing, **slots))
    assert thing.carrier is counter.robot


def test_a_failure_that_no_move_mends_and_one_in_a_projection_carry_no_advice(counter: BulletWorld) -> None:
    cup = Object("cup", "cup", "cup.stl", [-0.8, 1.0, 0.9])
    with pytest.raises(PlanFailure, match=r"the nearest posture found stays \d\.\d+ m away$"):
        perform(picking_up(object=cup, arm="left"))  # on the island, behind the robot
    milk = Object("milk", "milk", "milk.stl", [1.62, 0.6, 0.95])
    outcome = project(perform, picking_up(object=milk, arm="left"))
    assert str(outcome.failure).endswith("m away")


@pytest.mark.slow
def test_a_robot_with_a_fixed_base_advises_to_slide_what_it_would_fetch(world: BulletWorld) -> None:
    world.exit()
    with BulletWorld() as room:
        room.set_gravity([0, 0, -9.81])
        Object("table", "environment", "table.urdf")
        room.robot = Object("panda", "robot", "panda.urdf", [0, 1.2, 0.72])
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.82])
        assert room.settle()
        with pytest.raises(NoPlace) as raised:
            perform(fetching(object="milk"))
        advice = "slide milk by 88 cm to [0.00, 0.88], at an edge of table, then the robot can take it"
        assert str(raised.value).endswith(f"bring the target at least 28 cm closer; {advice}")
        moved_as_advised(raised.value, milk)
        assert perform(fetching(object=milk)) is milk
