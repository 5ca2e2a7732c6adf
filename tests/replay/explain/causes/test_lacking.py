"""What a motion lacked: for an earlier failure that the plan swallowed, or by what else was done."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from replay.explain import causes as kinds
from tests.replay.explain.causes.explaining import WITH_PR2, line_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.explain.causes.case import Cause
    from replay.explain.why import Why


NO_MILK = f"""
        {WITH_PR2}
        try:
            perform(type="pick-up", object=milk, arm="left")
        except PlanFailure:
            pass
"""


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
    explained: Callable[..., Why], since: str, cause: type[Cause]
) -> None:
    why = explained(f"""
        {NO_MILK}
        {since}
        perform(type="place", object=milk, target=[1, 0, 0.1], arm="left")
    """)
    assert [type(each) for each in why.causes] == [cause]


def test_the_other_hand_that_took_it_in_the_end_is_told_instead(explained: Callable[..., Why]) -> None:
    why = explained(f"""
        {NO_MILK}
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
    (far,) = [each for each in why.causes if isinstance(each, kinds.UnreachedTarget)]
    assert ("pr2", "command") in [(each.body, each.how) for each in far.changes]


@pytest.mark.parametrize("name", ["lab", "another"])
def test_a_failure_in_another_world_explains_nothing(explained: Callable[..., Why], name: str) -> None:
    why = explained(f"""
        {NO_MILK}
        world.exit()
        world = BulletWorld(name="{name}")
        robot = world.robot = Object("pr2", "robot", "pr2.urdf")
        milk = Object("milk", "milk", "milk.stl", [7, 0, 0.1])
        perform(type="place", object=milk, target=[1, 0, 0.1], arm="left")
    """)
    assert [type(each) for each in why.causes] == [kinds.HandState]


@pytest.mark.parametrize("taken", [False, True])
def test_what_was_skipped_for_want_of_a_perception_is_told_with_it(
    explained: Callable[..., Why], tmp_path: Path, taken: bool
) -> None:
    why = explained(f"""
        {WITH_PR2}
        def seen(kind):
            try:
                return [perform(type="detecting", object_type=kind)]
            except PlanFailure:
                return []
        milk.set_position([-7, 0, 0.1])  # behind it
        cartons = seen("milk")
        for carton in cartons:
            robot.attach(carton, tool)
        if {taken}:
            robot.attach(milk, tool)
            robot.detach(milk)
        perform(type="place", object=milk, target=[1, 0, 0.1], arm="left")
    """)
    found = [each for each in why.causes if isinstance(each, kinds.Swallowed)]
    if taken:
        assert not found
        return
    (cause,) = found
    assert (cause.precondition, cause.subject, cause.failed.name) == ("result", "cartons", "detecting")
    assert cause.skipped.number == line_of(tmp_path, "for carton in cartons:")


@pytest.mark.parametrize(
    ("to", "motion", "is_cause"),
    [
        ("[1, 3, 1]", 'type="place", object=milk, target=[7, 0.2, 0.9]', True),
        ("robot.get_link_position(tool)", 'type="place", object=milk, target=[7, 0.2, 0.9]', False),
        ("[1, 3, 1]", 'type="move-tcp", target=[9, 9, 1]', False),
    ],
    ids=["place", "nearly as it was", "has nothing to do with it"],
)
def test_what_was_moved_out_of_the_hand_that_holds_it_is_told(
    explained: Callable[..., Why], tmp_path: Path, to: str, motion: str, is_cause: bool
) -> None:
    why = explained(f"""
        {WITH_PR2}
        world.set_gravity([0, 0, 0])  # the milk stands on nothing
        milk.set_position([7, 0, 0.9])
        robot.set_position([6.35, -0.2, 0])
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        perform(type="pick-up", object=milk, arm="left")
        milk.set_position({to})
        perform({motion}, arm="left")
    """)
    moved = [each for each in why.causes if isinstance(each, kinds.NoLonger)]
    assert [(each.asked.name, each.changes[0].how) for each in moved] == ([("pick-up", "in-hand")] if is_cause else [])
    assert not is_cause or moved[0].changes[0].line.number == line_of(tmp_path, f"milk.set_position({to})")


@pytest.mark.parametrize("again", [False, True])
def test_what_was_removed_is_told_also_where_another_has_its_name(
    explained: Callable[..., Why], tmp_path: Path, again: bool
) -> None:
    why = explained(f"""
        {WITH_PR2}
        milk.remove()  # here
        if {again}:
            Object("milk", "milk", "milk.stl", [7, 0, 0.1])
        perform(type="pick-up", object=milk, arm="left")
    """)
    gone = next(each for each in why.causes if isinstance(each, kinds.Gone))
    assert (gone.body, gone.change.line.number) == ("milk", line_of(tmp_path, "# here"))
    assert (gone.loaded is not None) is again


@pytest.mark.parametrize("held", [True, False])
def test_what_was_removed_while_a_hand_held_it_is_told_before_the_empty_hand(
    explained: Callable[..., Why], held: bool
) -> None:
    why = explained(f"""
        {WITH_PR2}
        world.set_gravity([0, 0, 0])  # the milk stands on nothing
        milk.set_position([7, 0, 0.9])
        robot.set_position([6.35, -0.2, 0])
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        perform(type="pick-up", object=milk, arm="left")
        if not {held}:
            robot.detach(milk)
        milk.remove()
        Object("milk", "milk", "milk.stl", [9, 0, 0.1])
        perform(type="place", object=milk, target=[7, 0, 0.1], arm="left")
    """)
    (gone,) = why.causes
    if not held:
        assert isinstance(gone, kinds.HandState)
        return
    assert (gone.kind, gone.body, gone.loaded.how) == ("removed", "milk", "load")


def test_of_a_kind_that_is_not_there_the_one_that_was_removed_is_told(explained: Callable[..., Why]) -> None:
    why = explained(f"""
        {WITH_PR2}
        milk.remove()
        perform(type="detecting", object_type="milk")
    """)
    (gone,) = why.causes
    assert (gone.kind, gone.body) == ("removed", "milk")


def test_a_joint_that_was_misspelt_is_the_one_that_was_meant(explained: Callable[..., Why]) -> None:
    why = explained(f"""
        {WITH_PR2}
        from pycram.failures import UsageError
        try:
            robot.set_joint_position("torso_lift_jiont", 0.3)
        except UsageError:
            pass
        perform(type="move-tcp", target=[0.5, 0.2, 3], arm="left")
    """)
    (refused,) = (each for each in why.causes if isinstance(each, kinds.RefusedRequest))
    assert (refused.precondition, refused.subject) == ("joint-moved", "torso_lift_joint of pr2")


def test_out_of_reach_tells_that_the_torso_was_moved(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained(f"""
        {WITH_PR2}
        robot.set_joint_position("torso_lift_joint", 0.1)
        perform(type="move-tcp", target=[0.5, 0.2, 3], arm="left")
    """)
    far = next(each for each in why.causes if isinstance(each, kinds.UnreachedTarget))
    assert [(each.joint, each.line.number) for each in far.changes] == [
        ("torso_lift_joint", line_of(tmp_path, "set_joint_position"))
    ]


def test_an_object_of_another_world_leads_to_its_loading(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained(f"""
        {WITH_PR2}
        spare = BulletWorld(name="spare")
        cup = Object("cup", "cup", "cup.stl", [0.6, 0, 0.1], world=spare)
        BulletWorld.current_bullet_world = world
        perform(type="detecting", object_type="cup")
    """)
    other = next(each for each in why.causes if isinstance(each, kinds.OtherWorld))
    assert (other.body, other.world, other.needed) == ("cup", "spare", "lab")
    assert other.change.line.number == line_of(tmp_path, "cup = Object")
    assert other.opened.line.number == line_of(tmp_path, "spare =")


def test_a_gravity_that_pulls_upwards_explains_what_moves(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained(f"""
        {WITH_PR2}
        world.set_gravity([0, 0, 9.8])
        world.simulate(0.1)
        perform(type="pick-up", object=milk, arm="left")
    """)
    assert why.causes[0].kind == "gravity"
    (trial,) = why.causes[0].trials(why.case)
    assert (trial.step, trial.settings) == (why.causes[0].steps[0], ("gravity=0.0,0.0,-9.81",))
    assert why.causes[0].change.line.number == line_of(tmp_path, "[0, 0, 9.8]")


def test_the_other_hand_has_it_since_a_step(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained(f"""
        {WITH_PR2}
        robot.attach(milk, "r_gripper_tool_frame")
        perform(type="place", object=milk, target=[0.6, 0, 0], arm="left")
    """)
    (hand,) = why.causes
    assert hand.holder == "right"
    assert hand.change.line.number == line_of(tmp_path, "robot.attach")
    assert "the right gripper did, taken at step" in str([*hand.lines()])


@pytest.mark.slow
def test_a_closed_container_tells_the_line_that_opens_it_too_late(
    explained: Callable[..., Why], tmp_path: Path
) -> None:
    why = explained("""
        from pycram import perform
        from pycram.action_designators import opening, parking_arms, transporting
        from pycram.designator import LocationDesignator
        Object("kitchen", "environment", "kitchen.urdf")
        milk = Object("milk", "milk", "milk.stl", [1.3, 1.0, 0.96])
        world.robot = Object("pr2", "robot", "pr2.urdf")
        world.settle()
        def put_away():
            perform(parking_arms())
            perform(transporting(object=milk, target=LocationDesignator(in_="fridge")))
            perform(opening(container="fridge"))
        put_away()
    """)
    cause, *_ = why.causes
    assert (cause.kind, cause.container) == ("closed", "fridge")
    assert cause.opening.number == line_of(tmp_path, "perform(opening")
    assert why.sources[0].number == line_of(tmp_path, "perform(transporting")
