"""Where a robot can stand: proved by driving there and doing what it was for."""

from __future__ import annotations

import itertools
import math
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, MissingPart, NoPlace, UnknownName
from pycram.process_module import ProcessModule
from pycram.reasoning.choosing import UNRECORDED
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import choice, fingers
from pycram.reasoning.grasping.choice import holding_grasps
from pycram.reasoning.places import Pull, free_places, goals, standing_places
from pycram.world.transaction import take_snapshot
from recorder import geometry
from recorder.records import Query, argument_values
from recorder.records.text import rejections
from recorder.viewer.queries import scores_of

if TYPE_CHECKING:
    from recorder.geometry import Pose
    from tests.conftest import MemorySink

BEFORE_THE_COUNTER = (0.3, 1.0)


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def random_bases(count: int, seed: int) -> list[Pose]:
    random = np.random.default_rng(seed)
    at = random.uniform([0.2, 0.5], [0.9, 1.5], (count, 2)).round(3).tolist()
    return [((x, y, 0.0), geometry.from_rpy(0, 0, float(random.uniform(-0.7, 0.7)))) for x, y in at]


@pytest.mark.slow
def test_an_arm_reaches_the_same_from_an_assumed_pose_as_from_the_real_pose(scene: BulletWorld) -> None:
    """The reasoning with another pose of the base, and without after the robot was put there, answer the same."""
    robot, milk = scene.robot, scene.get_object("milk")
    arm = robot.description.arm("left")
    reached = 0
    for base in random_bases(10, 1):
        foreseen = choice.best_grasp(milk, robot, arm.tool_frame, base=base)
        held = [str(grasp) for grasp, *_ in holding_grasps(robot, arm, milk, None, [], UNRECORDED, base)]
        start = robot.get_position_and_orientation()
        robot.set_position_and_orientation(*base)
        there = choice.best_grasp(milk, robot, arm.tool_frame)
        assert foreseen.grasp == (there.grasp and pytest.approx(there.grasp)) or str(foreseen.grasp) == str(there.grasp)
        assert set(foreseen.obstacles) == set(there.obstacles)
        assert held == [str(grasp) for grasp, *_ in holding_grasps(robot, arm, milk, None, [], UNRECORDED)]
        if there.posture is not None and there.grasp is not None:
            reached += 1
            closing = fingers.close_around(robot, arm, there.posture.positions, milk)
            robot.set_position_and_orientation(*start)
            from_afar = fingers.close_around(robot, arm, there.posture.positions, milk, base)
            assert (closing is None) == (from_afar is None)
            assert closing is None or closing.sides == from_afar.sides
        robot.set_position_and_orientation(*start)
    assert 3 <= reached < 10


@pytest.mark.long
def test_the_robot_fits_at_offered_places_and_collides_at_rejected_ones(scene: BulletWorld, sink: MemorySink) -> None:
    robot = scene.robot
    places = list(itertools.islice(standing_places(robot, near=[1.0, 0.6], seed=2), 3))
    with pytest.raises(NoPlace):  # it lies in a drawer, so the robot would have to stand as near as it can
        next(standing_places(robot, reach=[scene.get_object("spoon")], seed=2))
    for place in places:
        base = place.position, place.orientation
        assert not checker.touched(robot, {}, base, all_links=True)
    collided = 0
    for record in sink.of(Query):
        for spot in record.grid.spots:
            reason = record.candidates[spot.candidate] if 0 <= spot.candidate != record.chosen else None
            touching = argument_values(reason.data).get("pairs", []) if reason else []
            if collided < 5 and any(pair["link"].startswith(("base", "fl_caster", "fr_caster")) for pair in touching):
                base = tuple(spot.position), geometry.from_rpy(0, 0, spot.yaw)
                assert checker.touched(robot, {}, base, all_links=True), rejections(record)
                collided += 1
    assert collided
    robot.set_position_and_orientation([-5, 0, 0], [0, 0, 0, 1])
    for place in places:
        perform(type="moving", target=place.position, orientation=place.orientation)


@pytest.mark.slow
def test_an_object_is_taken_carried_and_put_down_from_offered_places(scene: BulletWorld) -> None:
    robot, cereal, kitchen = scene.robot, scene.get_object("cereal"), scene.get_object("kitchen")
    robot.set_position_and_orientation([0.0, 2.0, 0], [0, 0, 1, 0])
    place = next(standing_places(robot, reach=[cereal], seed=5))
    perform(type="moving", target=place.position, orientation=place.orientation)
    for arm in place.arms:
        assert choice.best_grasp(cereal, robot, robot.description.arm(arm).tool_frame, (place.grasps[arm],)).grasp
    arm = place.arms[0]
    perform(type="pick-up", object=cereal, arm=arm, grasp=place.grasps[arm])
    perform(type="move-arm-joints", **{f"{arm}_arm": "park"})
    island = (kitchen, kitchen.surface("island"))
    free = next(free_places(cereal, on=[island], reachable_for=robot, arms=[arm], seed=5))
    place = next(standing_places(robot, reach=[(free.position, None)], arms=[arm], seed=5))
    assert place.arms == (arm,)
    perform(type="moving", target=place.position, orientation=place.orientation)
    perform(type="place", object=cereal, target=free.position, arm=arm)
    assert math.dist(cereal.get_position(), free.position) < 0.02


@pytest.mark.slow
def test_a_drawer_is_opened_from_an_offered_place(scene: BulletWorld) -> None:
    robot, kitchen = scene.robot, scene.get_object("kitchen")
    robot.set_position_and_orientation([-0.3, 2.0, 0], [0, 0, 1, 0])
    drawer = kitchen.container("sink left upper drawer")
    place = next(standing_places(robot, reach=[Pull(kitchen, drawer.joint, drawer.handle, 0.3)], seed=1))
    perform(type="moving", target=place.position, orientation=place.orientation)
    perform(
        type="accessing",
        drawer_joint=drawer.joint,
        drawer_handle=drawer.handle,
        part_of=kitchen,
        arm=place.arms[0],
        distance=0.3,
    )
    assert kitchen.get_joint_position(drawer.joint) == pytest.approx(0.3, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sink left bottom drawer", "oven right drawer", "fridge"])
def test_no_arm_opens_a_drawer_or_door_from_a_place_where_it_would_hit_the_robot(scene: BulletWorld, name: str) -> None:
    robot, kitchen = scene.robot, scene.get_object("kitchen")
    opened = kitchen.container(name)
    goal = goals.PullGoal(robot, Pull(kitchen, opened.joint, opened.handle, opened.open))
    arms = list(robot.description.arms.values())
    x, y, _ = goal.position
    bases = [((x + dx - 1.2, y + dy - 1.0, 0.0), turn) for (dx, dy, _), turn in random_bases(25, 3)]
    clone_of(scene, "reach").sync()
    struck = [base for base, touching in zip(bases, goal.struck(arms, bases), strict=True) if touching is not None]
    assert not any(isinstance(goal.reached(arm, base), str) for base in struck for arm in arms)
    assert 3 <= len(struck) < len(bases)


@pytest.mark.slow
def test_an_object_is_visible_from_an_offered_place(scene: BulletWorld) -> None:
    robot, bowl = scene.robot, scene.get_object("bowl")
    robot.set_position_and_orientation([-0.3, 2.0, 0], [0, 0, 1, 0])
    for place in itertools.islice(standing_places(robot, see=bowl, seed=0), 2):
        perform(type="moving", target=place.position, orientation=place.orientation)
        perform(type="looking", object=bowl)
        assert btr.visible(bowl, robot.description.camera.frame)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_places_and_nothing_moves(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    before = {body.name: take_snapshot(body) for body in scene.objects}
    first, again, other = (
        list(itertools.islice(standing_places(robot, reach=[milk], seed=seed), 3)) for seed in (7, 7, 8)
    )
    assert first == again
    assert first[1:] != other[1:]
    assert {body.name: take_snapshot(body) for body in scene.objects} == before
    assert all(math.dist(a.position, b.position) > 0.05 for a, b in itertools.combinations(first, 2))
    elsewhere = next(standing_places(robot, reach=[milk], avoid=[first[0].position], seed=7))
    assert math.dist(elsewhere.position, first[0].position) > 0.05


@pytest.mark.slow
def test_both_arms_reach_if_both_must(scene: BulletWorld) -> None:
    place = next(standing_places(scene.robot, reach=[scene.get_object("milk")], both=True, seed=0))
    assert set(place.arms) == {"left", "right"} == set(place.grasps)


@pytest.mark.costly
@pytest.mark.slow
def test_constraints_that_exclude_each_other_are_counted_and_the_last_is_named(
    scene: BulletWorld, sink: MemorySink
) -> None:
    robot, milk, spoon = scene.robot, scene.get_object("milk"), scene.get_object("spoon")
    with pytest.raises(NoPlace, match=r"reach milk and reach \[-3\.00, 0\.00, 0\.90\]") as far:
        next(standing_places(robot, reach=[milk, [-3.0, 0.0, 0.9]], seed=0))
    assert far.value.last.startswith("reach")
    with pytest.raises(NoPlace) as shut:  # it lies in a drawer
        next(standing_places(robot, reach=[spoon], arms=["left"], seed=0))
    assert shut.value.excluded["reach spoon"] > 20
    (*_, record) = sink.of(Query)
    assert record.failure.type.endswith("NoPlace")
    assert sum(candidate.count for candidate in record.candidates) >= 20
    assert scores_of(record.grid).max() == 1.0


def test_a_robot_that_cannot_drive_has_its_present_place() -> None:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        table = Object("table", "environment", "table.urdf")
        robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 0.72])
        robot.set_joint_positions(robot.description.arm("ur5").posture("park"))
        world.set_robot(robot)
        near, far = (Object(name, "cup", "cup.stl", [0.5, y, 0.77]) for name, y in (("near", 0.1), ("far", 3.0)))
        world.simulate(0.2)
        (place,) = standing_places(robot, reach=[near])
        assert place.position == tuple(robot.get_position())
        assert place.arms == ("ur5",)
        with pytest.raises(NoPlace, match="ur5 to reach far") as refused:
            next(standing_places(robot, reach=[far]))
        assert refused.value.last == "reach far"
        assert re.search(
            r"out of reach by (\d+) cm or more; .* bring the target at least \1 cm closer$", str(refused.value)
        )
        with pytest.raises(MissingPart, match="camera"):
            standing_places(robot, see=near)
        with pytest.raises(UnknownName, match="ur5"):
            standing_places(robot, reach=[near], arms=["left"])
        with pytest.raises(BadArgument, match="robot with a description"):
            standing_places(table)
        with pytest.raises(BadArgument, match="reach"):
            standing_places(robot, reach=[7])
        free = next(free_places(near, on=[(table, table.surface("table"))], reachable_for=robot, seed=1))
        assert free.arms == ("ur5",)
        perform(type="pick-up", object=near, arm="ur5")
        perform(type="place", object=near, target=free.position, arm="ur5")
        assert math.dist(near.get_position(), free.position) < 0.02


def test_an_object_that_does_not_fit_from_the_wanted_side_is_not_called_out_of_reach(scene: BulletWorld) -> None:
    pot = Object("pot", "pot", "pot.stl", [1.4, 0.4, 0.92])
    with pytest.raises(NoPlace, match=r"most often: 1[56]\d mm wide, the fingers hold 0 to 86 mm"):
        next(standing_places(scene.robot, reach=[pot], grasp="front", quickly=True, seed=1))
