"""What blocks, against brute force: every posture of every grasp, every link against every thing, without boxes."""

from __future__ import annotations

import itertools
import math
import random
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.optimize import linprog

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.reasoning.collision import boxes, checker
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import grasps
from pycram.reasoning.kinematics.inverse import Solver
from pycram.world import attachment
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.reasoning.collision.simulation_clone import SimulationClone

LEFT, RIGHT = "l_gripper_tool_frame", "r_gripper_tool_frame"
FILES = ["milk", "cup", "bowl", "spoon", "apple", "plate", "bottle", "breakfast_cereal", "pot", "glass", "knife"]


@pytest.fixture(scope="module")
def kitchen() -> Iterator[BulletWorld]:
    with BulletWorld() as world:
        Object("floor", "environment", "plane.urdf")
        Object("kitchen", "environment", "kitchen.urdf")
        robot = world.robot = Object("pr2", "robot", "pr2.urdf")
        for arm in robot.description.arms.values():
            robot.set_joint_positions(arm.posture("park"))
        yield world


def clutter(world: BulletWorld, seed: int) -> list[Object]:
    """The robot somewhere before the counter, things close together on it, sometimes something in the hand."""
    rng = random.Random(seed)
    robot = world.robot
    robot.set_position_and_orientation(
        [rng.uniform(0.45, 0.8), rng.uniform(0.4, 1.1), 0], geometry.from_rpy(0, 0, rng.uniform(-0.4, 0.4))
    )
    x, y = rng.uniform(1.25, 1.5), rng.uniform(0.5, 1.1)
    things = []
    for index in range(rng.randint(3, 7)):
        file = rng.choice(FILES)
        turn = geometry.from_rpy(0, 0, rng.uniform(-3, 3)) if rng.random() < 0.6 else (0, 0, 0, 1)
        body = Object(f"{file}_{index}", file, f"{file}.stl", [0, 0, 2], list(turn))
        height = 2.85 - body.get_AABB()[0][2]
        body.set_position([x + rng.uniform(-0.22, 0.22), y + rng.uniform(-0.25, 0.25), height])
        things.append(body)
    if rng.random() < 0.3:
        held = Object("held", "held", f"{rng.choice(FILES)}.stl", robot.get_link_position(LEFT))
        robot.attach(held, LEFT)
        things.append(held)
    return things


def by_brute_force(body: Object, robot: Object, link: str) -> tuple[str | None, tuple[float, ...]]:
    """The grasp that touches least, and what it costs; without a grasp if none is reached without self-collision."""
    arm = robot.description.arm_of(link)
    found = cheapest(body, robot, link, grasps.candidates(body, robot, arm))
    if found[0] is None or any(found[1][1:3]):  # something long may be taken beside its middle, if nothing is there
        other = cheapest(body, robot, link, grasps.candidates(body, robot, arm, off_center=True))
        found = other if other[0] is not None and not any(other[1]) else found
    return found


def cheapest(
    body: Object, robot: Object, link: str, options: Sequence[grasps.Grasp]
) -> tuple[str | None, tuple[float, ...]]:
    arm = robot.description.arm_of(link)
    solver = Solver(robot, link)
    targets = [(grasp.position, grasp.orientation, None) for grasp in options]
    found = solver.closed_form(targets)
    if not any(found):
        found = [solver.search([target])[0] for target in targets]
    opened = arm.gripper.positions("open")
    clone = clone_of(robot.world, "reach")
    clone.sync()
    moving = attachment.moved_links(robot.urdf, [*solver.joints, *opened])
    held = [(attachment.body, attachment.carrier_link) for attachment in robot.carried]
    pose_in_hand = {
        other: geometry.multiply(
            geometry.invert(robot.get_link_position_and_orientation(at)), other.get_position_and_orientation()
        )
        for other, at in held
    }
    best: tuple[tuple[float, ...], str | None] = ((math.inf,), None)
    try:
        for grasp, postures in zip(options, found, strict=True):
            for posture in postures:
                if not posture.reaches():
                    continue
                clone.engine.pose_joints(clone.body(robot.name), {**posture.positions, **opened})
                for other, at in held:
                    pose = clone.engine.link_pose(clone.body(robot.name), at)
                    clone.engine.set_pose(clone.body(other.name), geometry.multiply(pose, pose_in_hand[other]))
                swung = [other for other, at in held if at in moving]
                depths = overlaps(clone, robot, moving, swung, [*pose_in_hand])
                counted = {other: depth for other, depth in depths.items() if other is not body}
                furniture = sum(other.fixed for other in counted)
                cost = (body in depths, furniture, len(counted) - furniture, sum(counted.values()))
                if cost < best[0] and not hits_itself(clone, robot, [*solver.joints, *opened], moving):
                    best = cost, grasp.name
    finally:
        clone.invalidate()
    return best[1], best[0]


def overlaps(
    clone: SimulationClone, robot: Object, moving: list[str], swung: list[Object], held: list[Object]
) -> dict[Object, float]:
    depths: dict[Object, float] = {}
    movers = [(robot, link) for link in moving] + [(other, link) for other in swung for link in other.links]
    for (mover, link), other in itertools.product(movers, robot.world.objects):
        if other is robot or other in held:
            continue
        for touch in clone.engine.link_closest_points(clone.body(mover.name), link, clone.body(other.name)):
            if touch.distance <= -checker.DEPTH:
                depths[other] = max(depths.get(other, 0.0), -touch.distance)
    return depths


def hits_itself(clone: SimulationClone, robot: Object, joints: list[str], moving: list[str]) -> bool:
    depth = {
        link: sum(joint.name in joints for joint in robot.urdf.chain(robot.urdf.root, link)) for link in robot.links
    }
    body = clone.body(robot.name)
    return any(
        touch.distance <= -0.02 and abs(depth[link] - depth[touch.link_b]) > 3
        for link in moving
        for touch in clone.engine.link_closest_points(body, link, body)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [3, *range(100, 106), *(pytest.param(seed, marks=pytest.mark.costly) for seed in range(106, 130))]
)
def test_the_posture_that_touches_least_is_found(kitchen: BulletWorld, seed: int) -> None:
    robot = kitchen.robot
    things = clutter(kitchen, seed)
    try:
        for body, link in itertools.product(things[:2], (LEFT, RIGHT)):
            grasp, cost = by_brute_force(body, robot, link)
            found = btr.blocking(body, robot, link)
            assert found.evidence["reached"] is (grasp is not None)
            if grasp is None:
                continue
            obstacles = found.evidence["obstacles"]
            furniture = sum(other.fixed for other in found)
            assert (furniture, len(found) - furniture) == cost[1:3]
            assert sum(info["depth"] for info in obstacles.values()) == pytest.approx(cost[3], abs=1e-6)
            assert found.evidence["grasp"] == grasp
    finally:
        for body in reversed(things):
            if body.attachments:
                robot.detach(body)
            body.remove()


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2, 3, 4, 5))])
def test_collisions_at_another_pose_agree_with_the_engine(kitchen: BulletWorld, seed: int) -> None:
    """The whole robot at other places, also leaning, with its load and other values of the joints."""
    robot, rng = kitchen.robot, random.Random(seed)
    things = clutter(kitchen, seed)
    held = Object("load", "load", "pot.stl", robot.get_link_position(RIGHT))
    robot.attach(held, RIGHT)
    try:
        joints = {
            name: value + rng.uniform(-0.4, 0.4)
            for name, value in robot.description.arm("right").posture("park").items()
        }
        low_high = {name: robot.joint_limits(name) for name in joints}
        joints = {name: min(max(value, low_high[name][0]), low_high[name][1]) for name, value in joints.items()}
        lean = rng.uniform(-0.05, 0.05) if seed % 2 else 0.0
        base = (rng.uniform(0.3, 1.2), rng.uniform(0.3, 1.2), 0.0), geometry.from_rpy(lean, 0, rng.uniform(-3, 3))
        found = checker.touched(robot, joints, base, all_links=True)
        clone = clone_of(kitchen, "reach")
        clone.sync()
        clone.engine.set_pose(clone.body(robot.name), base)
        clone.engine.pose_joints(clone.body(robot.name), joints)
        for load in robot.carried:
            hand = clone.engine.link_pose(clone.body(robot.name), load.carrier_link)
            clone.engine.set_pose(clone.body(load.body.name), geometry.multiply(hand, load.pose))
        loads = [load.body for load in robot.carried]
        depths = overlaps(clone, robot, list(robot.links), loads, loads)
        clone.invalidate()
        floor = kitchen.get_object("floor")  # the wheels stand on it
        predicted = {other: info["depth"] for other, info in found.items() if other is not floor}
        assert predicted == pytest.approx(
            {other: depth for other, depth in depths.items() if other is not floor}, abs=1e-6
        )
    finally:
        for body in (held, *reversed(things)):
            if body.attachments:
                robot.detach(body)
            body.remove()


UPRIGHT, BROAD, FLAT = (0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2), (math.pi / 2, 0.0, 0.0)
BEFORE, BEHIND = ((0.46, 0.3, 0.8), BROAD), ((0.75, 0.3, 0.8), BROAD)
BESIDE, BEYOND = ((0.6, 0.15, 0.8), UPRIGHT), ((0.6, 0.45, 0.8), UPRIGHT)
ABOVE, BELOW = ((0.6, 0.3, 1.0), FLAT), ((0.6, 0.3, 0.62), FLAT)

# What stands around the milk, which hangs in the air before the robot's left arm; the side that the hand comes from;
# and which of the things are in its way.
KNOWN = [
    ([], None, []),
    ([], "front", []),
    ([BEFORE], "front", [0]),
    ([BEFORE], None, []),
    ([BEFORE], "top", []),
    ([BEHIND], "front", []),
    ([BEHIND], None, []),
    ([BESIDE], "right", [0]),
    ([BESIDE], "left", []),
    ([BEYOND], "left", [0]),
    ([BEYOND], "right", []),
    ([ABOVE], "top", [0]),
    ([ABOVE], "front", []),
    ([BELOW], "top", []),
    ([BEFORE, BEHIND], "front", [0]),
    ([BEHIND, BEFORE], "front", [1]),
    ([BESIDE, BEYOND], "front", []),
    ([BEFORE, ABOVE], "top", [1]),
    ([BESIDE, BEYOND, ABOVE], None, []),
]


@pytest.fixture(scope="module")
def alone() -> Iterator[Object]:
    with BulletWorld() as world:
        robot = world.robot = Object("pr2", "robot", "pr2.urdf")
        for arm in robot.description.arms.values():
            robot.set_joint_positions(arm.posture("park"))
        yield robot


@pytest.mark.parametrize("arm", [pytest.param(LEFT, marks=pytest.mark.slow), RIGHT])
@pytest.mark.parametrize(("around", "grasp", "expected"), KNOWN)
def test_blocking_finds_known_obstacles(
    alone: Object, around: list[tuple], grasp: str | None, expected: list[int], arm: str
) -> None:
    """For the right arm in a mirror; the robot stands somewhere else, turned, each time."""
    side = 1.0 if arm == LEFT else -1.0
    stand = ([0.3 * len(around), -0.2, 0.0], geometry.from_rpy(0, 0, 0.4 * len(around)))
    alone.set_position_and_orientation(*stand)

    def put(name: str, kind: str, file: str, at: tuple[float, ...], rpy: tuple[float, ...]) -> Object:
        pose = (at[0], side * at[1], at[2]), geometry.from_rpy(side * rpy[0], rpy[1], side * rpy[2])
        return Object(name, kind, file, *(list(part) for part in geometry.multiply(stand, pose)))

    milk = put("milk", "milk", "milk.stl", (0.6, 0.3, 0.8), UPRIGHT)
    walls = [
        put(f"wall {number}", "environment" if number else "box", "breakfast_cereal.stl", *pose)
        for number, pose in enumerate(around)
    ]
    if arm == RIGHT and grasp in {"left", "right"}:
        grasp = "left" if grasp == "right" else "right"
    try:
        found = btr.blocking(milk, alone, arm, grasp=grasp)
        assert found.evidence["reached"] is True
        assert sorted(found, key=walls.index) == [walls[number] for number in expected]
        assert all(body.type == ("environment" if walls.index(body) else "box") for body in found)
        assert all(link.startswith(arm[0]) for info in found.evidence["obstacles"].values() for link in info["links"])
    finally:
        for body in (milk, *walls):
            body.remove()


@pytest.mark.parametrize(("rpy", "places"), [((0, 0, 0.3), 0), ((math.pi / 2, 0, 0.3), 2), ((math.pi / 4, 0, 0), 2)])
def test_only_lying_or_leaning_objects_are_taken_beside_their_middle(
    kitchen: BulletWorld, rpy: tuple[float, float, float], places: int
) -> None:
    """From the top, the ends of something that stands are where its middle is."""
    robot = kitchen.robot
    robot.set_position_and_orientation([0.6, 0.7, 0], [0, 0, 0, 1])
    milk = Object("milk", "milk", "milk.stl", [1.3, 0.7, 1.2], geometry.from_rpy(*rpy))
    try:
        arm = robot.description.arm_of(LEFT)
        middle = milk.get_AABB()
        x, y = ((low + high) / 2 for low, high in zip(middle[0][:2], middle[1][:2], strict=True))
        found = grasps.candidates(milk, robot, arm, off_center=True)
        away = {round(math.dist(grasp.position[:2], (x, y)), 2) for grasp in found}
        assert len(found) >= places
        assert bool(found) is bool(places)
        assert all(distance > 0.02 for distance in away)
    finally:
        milk.remove()


def test_held_objects_collide_with_others_but_are_no_obstacles(alone: Object) -> None:
    alone.set_position_and_orientation([0, 0, 0], [0, 0, 0, 1])
    milk = Object("milk", "milk", "milk.stl", [0.6, 0.3, 0.8])
    shelf = Object("shelf", "environment", "breakfast_cereal.stl", [0.6, 0.3, 0.62], list(geometry.from_rpy(*FLAT)))
    assert btr.blocking(milk, alone, LEFT, grasp="front") == []
    tool = alone.get_link_position_and_orientation(LEFT)
    load = Object("load", "load", "breakfast_cereal.stl", *geometry.multiply(tool, ((0, 0, -0.12), (0, 0, 0, 1))))
    other = Object("other", "other", "cup.stl", alone.get_link_position(RIGHT))
    alone.attach(load, LEFT)
    alone.attach(other, RIGHT)
    try:
        found = btr.blocking(milk, alone, LEFT, grasp="front")
        assert found == [shelf], "the load hangs below the hand"
        assert found.evidence["obstacles"]["shelf"]["links"] == ["breakfast_cereal"]
    finally:
        for body in (load, other):
            alone.detach(body)
        for body in (milk, shelf, load, other):
            body.remove()


rotations = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda rpy: geometry.to_matrix(geometry.from_rpy(*rpy)))
positions = st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array)
sizes = st.tuples(*[st.floats(0.005, 0.4)] * 3).map(np.array)


@settings(max_examples=150, deadline=None)
@given(positions, rotations, sizes, positions, st.one_of(st.none(), rotations), sizes, st.floats(-1e-7, 1e-7))
@pytest.mark.slow
def test_boxes_overlap_if_they_share_a_point(
    at: np.ndarray,
    turn: np.ndarray,
    half: np.ndarray,
    other_at: np.ndarray,
    other_turn: np.ndarray | None,
    other_half: np.ndarray,
    skew: float,
) -> None:
    """None for a turn: nearly that of the other box, off by what rounding does."""
    other_axes = turn @ (np.eye(3) + skew * (1.0 - np.eye(3))) if other_turn is None else other_turn
    others = boxes.Boxes(("other",), other_at[None], other_axes[None], other_half[None])
    found = boxes.overlaps(at[None, None], turn[None, None], half[None], others)
    planes = np.vstack([turn.T, -turn.T, other_axes.T, -other_axes.T])
    room = np.concatenate([turn.T @ at + half, half - turn.T @ at, other_axes.T @ other_at + other_half])
    room = np.concatenate([room, other_half - other_axes.T @ other_at])
    solved = linprog([0, 0, 0, 1], np.column_stack([planes, -np.ones(12)]), room, bounds=[(None, None)] * 4)
    assume(solved.status == 0)
    if abs(solved.x[3]) > 1e-5:  # m by which the boxes have to grow to share a point
        assert bool(len(found[0])) is bool(solved.x[3] < 0)
