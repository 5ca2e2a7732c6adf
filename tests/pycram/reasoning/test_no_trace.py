"""Queries leave no trace: neither now nor later, nor when they fail, nor when many threads ask at once."""

from __future__ import annotations

import random
import struct
import threading
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import ChangeRefused
from pycram.language import par
from pycram.reasoning.collision import checker
from pycram.reasoning.queries import contact, stability, visibility
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable

LEFT, FRAME = "l_gripper_tool_frame", "wide_stereo_optical_frame"
FILES = ["milk", "cup", "bowl", "spoon", "apple", "plate", "bottle"]


def bits(world: BulletWorld) -> list[bytes]:
    """The whole state as raw numbers."""
    packed = []
    for body in world.objects:
        position, turn = world.engine.pose(body.handle)
        joints, speeds = world.engine.joints(body.handle)
        numbers = [*position, *turn, *world.engine.velocity(body.handle), *joints, *speeds]
        packed.append(struct.pack(f"{len(numbers)}d", *numbers))
    return packed


def build(seed: int, *, robot: bool) -> BulletWorld:
    """Things at random places, some falling, one held, one attached to another."""
    rng = random.Random(seed)
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    for index in range(6):
        file = rng.choice(FILES)
        position = [rng.uniform(0.3, 0.9), rng.uniform(-0.4, 0.4), rng.uniform(0.1, 1.0)]
        turn = geometry.from_rpy(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-3, 3))
        Object(f"{file}_{index}", file, f"{file}.stl", position, list(turn))
    a, b = rng.sample(world.objects[1:], 2)
    a.attach(b)
    if robot:
        pr2 = world.robot = Object("pr2", "robot", "pr2.urdf", [rng.uniform(-0.2, 0.1), 0, 0])
        held = Object("held", "cup", "cup.stl", pr2.get_link_position(LEFT))
        pr2.attach(held, LEFT)
    world.simulate(rng.uniform(0.05, 0.3))
    return world


def ask(world: BulletWorld, seed: int, count: int) -> list[object]:
    """Random queries about random things."""
    rng = random.Random(seed)
    things = [body for body in world.objects if not body.is_robot]
    robot = world.robot
    answers: list[object] = []
    for _ in range(count):
        a, b = rng.sample(things, 2)
        eye = [rng.uniform(-1, 2), rng.uniform(-1, 1), rng.uniform(0, 2)]
        choices: list[Callable[[], object]] = [
            lambda a=a: btr.stable(a),
            lambda a=a, b=b: btr.contact(a, b, margin=rng.uniform(0, 0.1)),
            lambda a=a, b=b: btr.supporting(a, b),
            lambda a=a, eye=eye: btr.visible(a, eye),
            lambda a=a, eye=eye: btr.occluding(a, eye),
        ]
        if robot is not None:
            choices += [
                lambda a=a: btr.visible(a, FRAME),
                lambda eye=eye: btr.reachable_pose(eye, robot, LEFT, collision_free=rng.random() < 0.5),
                lambda a=a: btr.reachable_object(a, robot, LEFT, grasp=rng.choice(["front", "top", None])),
                lambda a=a: btr.blocking(a, robot, LEFT),
                lambda eye=eye: btr.reachable_poses([eye], robot, LEFT, bases=[([*eye[:2], 0], [0, 0, 0, 1])] * 2),
            ]
        answers.append(rng.choice(choices)())
    return answers


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "robot"),
    [
        pytest.param(1, False, marks=pytest.mark.costly),
        (3, True),
        *(pytest.param(seed, bool(seed % 2), marks=pytest.mark.long) for seed in (2, 4, 5)),
    ],
)
def test_a_world_evolves_bit_for_bit_as_without_queries(seed: int, robot: bool) -> None:
    futures = []
    for asks in (0, 12):
        with build(seed, robot=robot) as world:
            before = bits(world)
            ask(world, seed, asks)
            assert bits(world) == before
            world.simulate(1.0)
            ask(world, seed + 100, asks // 2)
            world.simulate(1.0)
            futures.append(bits(world))
    assert futures[0] == futures[1]


@pytest.mark.slow
def test_queries_of_one_world_do_not_affect_others() -> None:
    with build(5, robot=False) as first, build(6, robot=False) as second:
        before = bits(first), bits(second)
        alone = [repr(answer) for answer in ask(first, 7, 8)]
        ask(second, 8, 8)
        assert [repr(answer) for answer in ask(first, 7, 8)] == alone
        assert (bits(first), bits(second)) == before
        second.simulate(0.5)
        assert bits(first) == before[0]


@pytest.mark.slow
def test_threads_that_ask_in_parallel_get_the_same_answers() -> None:
    with build(9, robot=False) as world:
        before = bits(world)
        expected = [[repr(answer) for answer in ask(world, seed, 5)] for seed in range(4)]
        answers: dict[int, list[str]] = {}

        def run(seed: int) -> None:
            answers[seed] = [repr(answer) for answer in ask(world, seed, 5)]

        threads = [threading.Thread(target=run, args=(seed,)) for seed in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert [answers[seed] for seed in range(4)] == expected
        assert bits(world) == before


def test_branches_ask_while_others_change_the_world() -> None:
    with build(10, robot=False) as world:
        things = [body for body in world.objects if not body.fixed]
        with par:
            things[0].set_position([0, 0, 2])
            btr.stable(things[1])
            things[2].set_position([0, 1, 2])
            btr.visible(things[3], [2, 2, 2])
        assert things[0].get_position() == pytest.approx([0, 0, 2])
        assert not btr.stable(things[0])


FAILING: list[tuple[object, str, Callable[[BulletWorld, Object], object]]] = [
    (stability, "_simulate", lambda world, body: btr.stable(body)),
    (visibility, "_inside", lambda world, body: btr.visible(body, [2, 2, 2])),
    (contact, "evidence", lambda world, body: btr.contact(body, world.get_object("floor"))),
]


@pytest.mark.parametrize(("module", "name", "query"), FAILING, ids=lambda value: str(value)[:12])
def test_a_failing_query_leaves_no_trace(
    monkeypatch: pytest.MonkeyPatch, module: object, name: str, query: Callable[[BulletWorld, Object], object]
) -> None:
    with build(11, robot=False) as world:
        body = next(body for body in world.objects if not body.fixed and not body.attachments)
        before, right = bits(world), repr(query(world, body))
        with monkeypatch.context() as patch:

            def fails(*_args: object) -> None:
                raise RuntimeError("in the middle")

            patch.setattr(module, name, fails)
            with pytest.raises(RuntimeError, match="in the middle"):
                query(world, body)
        assert bits(world) == before
        assert repr(query(world, body)) == right
        body.set_position([0, 0, 3])  # nothing is refused any more
        assert body.get_position() == pytest.approx([0, 0, 3])


def test_a_failing_check_of_reach_leaves_no_trace(scene: BulletWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    before, right = bits(scene), btr.blocking(milk, robot, LEFT).evidence
    with monkeypatch.context() as patch:
        patch.setattr(checker.CollisionChecker, "touched", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            btr.blocking(milk, robot, LEFT)
    assert bits(scene) == before
    assert btr.blocking(milk, robot, LEFT).evidence == right


def test_a_change_inside_a_query_is_refused_with_both_names(
    world: BulletWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    milk = Object("milk", "milk", "milk.stl", [0, 0, 1])
    before = bits(world)
    attempts: list[tuple[str, Callable[[], object]]] = [
        ("move body", lambda: milk.set_position([1, 1, 1])),
        ("simulate", lambda: world.simulate(0.1)),
        ("remove", milk.remove),
        ("load", lambda: Object("other", "milk", "milk.stl")),
        ("color", lambda: milk.set_color([1, 0, 0, 1])),
        ("gravity", lambda: world.set_gravity([0, 0, -1])),
    ]
    for words, attempt in attempts:
        with monkeypatch.context() as patch:
            patch.setattr(visibility, "_inside", lambda *_args, attempt=attempt: attempt())
            with pytest.raises(ChangeRefused, match=words) as refused:
                btr.visible(milk, [2, 2, 2])
            assert "visible" in str(refused.value)
    assert bits(world) == before
    assert [body.name for body in world.objects] == ["milk"]
