"""Stability: the query is asked first, then the whole world is simulated to see what is true."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.reasoning.queries import stability
from recorder import geometry
from tests.measures import seeded

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.physics.body import LoadedBody

LYING = geometry.from_rpy(0, math.pi / 2, 0)
CEREAL = 0.112  # m from the middle of the cereal to its underside
MILK = 0.097


@pytest.fixture
def floor(world: BulletWorld) -> Object:
    return Object("floor", "environment", "plane.urdf")


def stays(body: Object) -> bool:
    """The truth: two seconds of the whole world."""
    before = body.get_position_and_orientation()
    furthest = turned = 0.0
    for _ in range(80):
        body.world.simulate(0.025)
        after = body.get_position_and_orientation()
        furthest = max(furthest, math.dist(before[0], after[0]))
        turned = max(turned, geometry.angle(before[1], after[1]))
    return furthest <= 0.01 and turned <= math.radians(5)


def settled(name: str, file: str, position: list[float], orientation: tuple[float, ...] = (0, 0, 0, 1)) -> Object:
    body = Object(name, name, file, position, list(orientation))
    body.world.simulate(0.5)
    return body


def standing() -> tuple[Object, bool]:
    return settled("milk", "milk.stl", [0, 0, MILK + 0.001]), True


def in_the_air() -> tuple[Object, bool]:
    return Object("milk", "milk", "milk.stl", [0, 0, 0.5]), False


def a_millimetre_above() -> tuple[Object, bool]:
    return Object("milk", "milk", "milk.stl", [0, 0, MILK + 0.001]), True


def tilted_beyond_its_edge() -> tuple[Object, bool]:
    return Object("milk", "milk", "milk.stl", [0, 0, 0.115], list(geometry.from_rpy(0.45, 0, 0))), False


def tilted_a_little() -> tuple[Object, bool]:
    # it falls back on its foot, which turns it by 9 degrees
    return Object("milk", "milk", "milk.stl", [0, 0, 0.103], list(geometry.from_rpy(0.16, 0, 0))), False


def pushed() -> tuple[Object, bool]:
    milk = settled("milk", "milk.stl", [0, 0, MILK + 0.001])
    milk.world.engine.set_velocity(milk.handle, [1.0, 0, 0, 0, 0, 0])
    return milk, False


def hanging_over(beyond: float) -> Object:
    base = Object("base", "environment", "breakfast_cereal.stl", [0, 0, CEREAL])
    edge = base.get_AABB()[1][0]
    return Object("box", "box", "milk.stl", [edge + beyond, 0, 2 * CEREAL + 0.034], list(LYING))


def cantilever_that_holds() -> tuple[Object, bool]:
    return hanging_over(-0.02), True


def cantilever_that_tips() -> tuple[Object, bool]:
    return hanging_over(0.02), False


def cantilever_under_load() -> tuple[Object, bool]:
    """It would hold, but for what stands on its far end."""
    box = hanging_over(-0.015)
    top, edge = box.get_AABB()[1][2], box.get_AABB()[1][0]
    Object("load", "load", "milk.stl", [edge - 0.035, 0, top + MILK])
    return box, False


def spoon_in_a_bowl() -> tuple[Object, bool]:
    Object("bowl", "bowl", "bowl.stl", [0, 0, 0.0345])
    spoon = settled("spoon", "spoon.stl", [0, 0, 0.1])
    spoon.world.simulate(1.5)
    return spoon, True


def bowl_with_a_spoon() -> tuple[Object, bool]:
    spoon_in_a_bowl()
    return BulletWorld.current_bullet_world.get_object("bowl"), True


def stack() -> tuple[Object, bool]:
    settled("below", "breakfast_cereal.stl", [0, 0, CEREAL + 0.001])
    return settled("above", "milk.stl", [0, 0, 2 * CEREAL + MILK + 0.002]), True


def below_what_tips() -> tuple[Object, bool]:
    """A stack whose top falls, and pushes what is below aside."""
    below = settled("below", "plate.stl", [0, 0, 0.02])
    Object("above", "milk", "milk.stl", [0, 0, below.get_AABB()[1][2] + 0.13], list(geometry.from_rpy(0.5, 0, 0)))
    return below, False


def hit_by_what_falls() -> tuple[Object, bool]:
    """Nothing touches it yet."""
    cup = settled("cup", "cup.stl", [0, 0, 0.06])
    Object("bomb", "bomb", "pot.stl", [0.02, 0.03, 0.9])
    return cup, False


def hit_by_what_slides() -> tuple[Object, bool]:
    cup = settled("cup", "cup.stl", [0, 0, 0.06])
    pot = settled("pot", "pot.stl", [-0.8, 0, 0.1])
    pot.world.engine.set_velocity(pot.handle, [3.0, 0, 0, 0, 0, 0])
    return cup, False


def without_gravity() -> tuple[Object, bool]:
    BulletWorld.current_bullet_world.set_gravity([0, 0, 0])
    return Object("milk", "milk", "milk.stl", [0, 0, 1]), True


def gravity_from_the_side() -> tuple[Object, bool]:
    milk = settled("milk", "milk.stl", [0, 0, MILK + 0.001])
    milk.world.set_gravity([9.8, 0, -1])
    return milk, False


def furniture() -> tuple[Object, bool]:
    return Object("shelf", "environment", "milk.stl", [0, 0, 3]), True


def on_what_it_is_fixed_to() -> tuple[Object, bool]:
    base = Object("base", "environment", "milk.stl", [0, 0, MILK])
    flag = Object("flag", "flag", "spoon.stl", [0, 0, 0.5])
    base.attach(flag)
    return flag, True


def on_a_tray_that_falls() -> tuple[Object, bool]:
    tray = Object("tray", "tray", "plate.stl", [0, 0, 0.6])
    cup = Object("cup", "cup", "cup.stl", [0, 0, 0.7])
    tray.attach(cup)
    return cup, False


SCENES: list[Callable[[], tuple[Object, bool]]] = [
    in_the_air,
    cantilever_that_holds,
    cantilever_that_tips,
    hit_by_what_falls,
    standing,
    a_millimetre_above,
    tilted_beyond_its_edge,
    tilted_a_little,
    pushed,
    cantilever_under_load,
    spoon_in_a_bowl,
    bowl_with_a_spoon,
    stack,
    below_what_tips,
    hit_by_what_slides,
    without_gravity,
    gravity_from_the_side,
    furniture,
    on_what_it_is_fixed_to,
    on_a_tray_that_falls,
]


QUICK = SCENES[:4]  # for the inner loop


@pytest.mark.parametrize(
    "scene",
    [*QUICK, *(pytest.param(scene, marks=pytest.mark.slow) for scene in SCENES[len(QUICK) :])],
    ids=lambda scene: scene.__name__,
)
def test_the_answer_agrees_with_the_simulated_world(floor: Object, scene: Callable[[], tuple[Object, bool]]) -> None:
    body, expected = scene()
    verdict = btr.stable(body)
    assert stays(body) is expected, "the scene is not what it is meant to be"
    assert bool(verdict) is expected, verdict.evidence
    if not verdict:
        assert verdict.evidence["moved"] > 0.01 or verdict.evidence["turned"] > math.radians(5)
        assert 0 < verdict.evidence["moved_after_steps"] <= 480


@pytest.mark.parametrize(
    "scene",
    [
        cantilever_that_holds,
        *(pytest.param(scene, marks=pytest.mark.slow) for scene in (spoon_in_a_bowl, stack, hit_by_what_falls)),
    ],
    ids=lambda scene: scene.__name__,
)
def test_the_same_query_gets_the_same_bits_after_other_queries(
    floor: Object, scene: Callable[[], tuple[Object, bool]]
) -> None:
    body, _ = scene()
    things = [other for other in body.world.objects if not other.fixed]
    evidence = {other: btr.stable(other).evidence for other in things}
    assert {other: btr.stable(other).evidence for other in reversed(things)} == evidence


def test_a_held_object_is_stable_until_it_is_released(scene: BulletWorld) -> None:
    robot, milk, bowl = scene.robot, scene.get_object("milk"), scene.get_object("bowl")
    milk.set_position(robot.get_link_position("l_gripper_tool_frame"))
    robot.attach(milk, "l_gripper_tool_frame")
    assert btr.stable(milk)
    assert btr.stable(bowl).evidence["simulated_steps"] < 60
    robot.detach(milk)
    assert not btr.stable(milk)


@pytest.mark.slow
def test_a_robots_arms_carry_the_objects_on_them(world: BulletWorld, floor: Object) -> None:
    robot = Object("pr2", "robot", "pr2.urdf")
    arms = [joint for arm in robot.description.arms.values() for joint in arm.joints]
    robot.set_joint_positions(dict.fromkeys(arms, 0.0) | {"l_shoulder_pan_joint": -0.35, "r_shoulder_pan_joint": 0.35})
    x, _, _ = robot.get_link_position("l_forearm_link")
    top = robot.get_AABB("l_forearm_link")[1][2]
    tray = Object("tray", "tray", "breakfast_cereal.stl", [x, 0, top + 0.05], list(LYING))
    world.simulate(1.0)
    assert tray.get_position()[2] > top, "it lies on the arms"
    assert btr.stable(tray)
    assert stays(tray)


def test_distant_bodies_are_not_simulated(floor: Object) -> None:
    milk = settled("milk", "milk.stl", [0, 0, MILK + 0.001])
    alone = btr.stable(milk).evidence["simulated_steps"]
    Object("falling", "box", "milk.stl", [30, 0, 0.5])
    assert btr.stable(milk).evidence["simulated_steps"] == alone


@pytest.mark.parametrize("name", ["knife", "spoon", "bottle", "cup", "milk", "breakfast_cereal", "apple", "plate"])
@pytest.mark.parametrize("turn", [LYING, geometry.from_rpy(math.pi / 2, 0, 0), (0.0, 0.0, 0.0, 1.0)])
def test_a_body_at_rest_may_be_about_to_fall_or_roll(
    world: BulletWorld, floor: Object, name: str, turn: tuple[float, ...]
) -> None:
    """Balanced on an end it stands still at first: the answer is what two seconds show."""
    body = Object(name, name, f"{name}.stl", [0, 0, 1], list(turn))
    gap = min(touch.distance for touch in world.engine.closest_points(floor.handle, body.handle, 2.0))
    x, y, z = body.get_position()
    body.set_position([x, y, z - gap + 1e-4])
    verdict = btr.stable(body)
    assert bool(verdict) == stays(body)


@pytest.mark.slow
def test_a_firm_body_is_stable_after_a_few_steps(world: BulletWorld, floor: Object) -> None:
    pile = settled("pot", "pot.stl", [1, 0, 0.08]), settled("plate", "plate.stl", [1, 0, 0.17])
    for body in (settled("milk", "milk.stl", [0, 0, MILK + 0.001]), settled("bowl", "bowl.stl", [0.4, 0, 0.04]), *pile):
        assert btr.stable(body)
        assert btr.stable(body).evidence["simulated_steps"] <= 48, body


def test_a_spoon_that_leans_on_a_bowl_is_stable_after_a_few_steps(floor: Object) -> None:
    """Three points carry it, none of them on flat ground."""
    spoon, _ = spoon_in_a_bowl()
    assert btr.stable(spoon).evidence["simulated_steps"] <= 48
    assert btr.stable(spoon.world.get_object("bowl")).evidence["simulated_steps"] <= 48


def crowd(count: int) -> list[Object]:
    """Cartons at rest, far apart from each other and from the middle."""
    places = [(1.0 + row * 0.4, column * 0.4) for row in range(5) for column in range(count // 5)]
    return [Object(f"milk_{x:.1f}_{y:.1f}", "milk", "milk.stl", [x, y, MILK + 0.001]) for x, y in places]


def simulated(query: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> tuple[object, list[int]]:
    """The answer of a query, and how many bodies are awake after each period that the clone simulates."""
    awake = []
    update = stability._Sleepers.update

    def counted(self: stability._Sleepers, moving: list[LoadedBody]) -> None:
        update(self, moving)
        awake.append(len(self.standing) - len(self.asleep))

    with monkeypatch.context() as patch:
        patch.setattr(stability._Sleepers, "update", counted)
        return query(), awake


@pytest.mark.parametrize("scene", [hit_by_what_slides, hit_by_what_falls])
def test_of_many_bodies_those_at_rest_sleep_until_something_comes_near(
    floor: Object, scene: Callable[[], tuple[Object, bool]], monkeypatch: pytest.MonkeyPatch
) -> None:
    others = crowd(30)
    body, truth = scene()
    answer, awake = simulated(lambda: btr.stable(body), monkeypatch)
    assert bool(answer) == truth
    assert min(awake) <= 2  # the target, and what falls or slides
    again, _ = simulated(lambda: btr.stable(others[0]), monkeypatch)
    assert again
    with monkeypatch.context() as patch:
        patch.setattr(stability, "_MANY", math.inf)
        assert bool(btr.stable(body)) == truth  # all bodies of the clone are awake again


@seeded("stable: verdicts in piles of the whole scene", range(12), 1, always=2)
def test_answers_in_piles_agree_with_a_simulation_of_the_whole_scene(
    world: BulletWorld, floor: Object, seeds: range
) -> None:
    """What lies anyhow on, in and against each other, some of it still moving.

    Contacts that the engine keeps from step to step are no part of a state, and a few such answers depend on them: both
    sides begin with contacts as they are found.
    """
    rng = random.Random(seeds[0])
    things, height = [], 0.15
    for index in range(rng.randint(3, 6)):
        turn = [
            rng.uniform(-3, 3) * (rng.random() < 0.4),
            rng.uniform(-3, 3) * (rng.random() < 0.4),
            rng.uniform(-3, 3),
        ]
        at = [rng.uniform(-0.07, 0.07), rng.uniform(-0.07, 0.07), height]
        file = rng.choice(["milk", "cup", "bowl", "spoon", "apple", "plate", "pot", "glass", "knife"])
        things.append(Object(f"{file}_{index}", file, f"{file}.stl", at, list(geometry.from_rpy(*turn))))
        height += rng.uniform(0.08, 0.2)
    world.simulate(rng.choice([0.7, 1.0, 2.0]))
    said = {body: bool(btr.stable(body)) for body in things}
    for body in world.objects:
        world.engine.reset_collision_filter(body.handle, fixed=body.fixed)
    before = {body: body.get_position_and_orientation() for body in things}
    moved = dict.fromkeys(things, 0.0)
    turned = dict.fromkeys(things, 0.0)
    for _ in range(80):
        world.simulate(0.025)
        for body, (old_position, old_orientation) in before.items():
            position, orientation = body.get_position_and_orientation()
            moved[body] = max(moved[body], math.dist(old_position, position))
            turned[body] = max(turned[body], geometry.angle(old_orientation, orientation))
    assert said == {body: moved[body] <= 0.01 and turned[body] <= math.radians(5) for body in things}
