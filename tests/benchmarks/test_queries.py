"""What the reasoning queries cost, against calls of the engine in the same run: ``make bench`` prints the table.

Units are the engine's own work in the same world: one step of the whole scene, one default call of inverse kinematics,
one camera image of 256x256. It is the processor's time that counts, since others run on the machine as well, and noise only
adds: each query is timed in turn with its unit, and the fastest of each are compared.
"""

from __future__ import annotations

import statistics
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.models import shapes
from pycram.models.shapes import solids_of
from pycram.physics.engine import bullet
from pycram.reasoning.collision import boxes, simulation_clone
from pycram.reasoning.kinematics import forward
from pycram.vision import FAR, NEAR
from recorder import geometry
from tests import large_kitchen
from tests.benchmarks.timing import amount, goal, ratio, seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demos"))

import set_the_table

pytestmark = pytest.mark.slow

LEFT, RIGHT, FRAME = "l_gripper_tool_frame", "r_gripper_tool_frame", "wide_stereo_optical_frame"
CLUTTER = ["milk", "cup", "bowl", "apple", "plate", "bottle", "breakfast_cereal", "pot", "glass", "spoon"]
MANY = 40  # objects far away: ten times those that are near


@pytest.fixture
def kitchen() -> Iterator[Object]:
    """The demo's scene, the robot before the counter."""
    with redirect_stdout(StringIO()):
        made = set_the_table.build_scene()
        set_the_table.go(set_the_table.COUNTER)
    made.world.simulate(0.5)
    yield made
    made.world.exit()


def cost_of(query: Callable[[], object], unit: Callable[[], object], times: int = 11) -> float:
    """What a query costs, in units that are measured in turn with it."""
    query()
    return ratio(lambda: seconds(query), lambda: seconds(unit), times)


def with_visuals(world: BulletWorld) -> tuple[int, dict[str, int]]:
    """A client of the engine's where a world's bodies can be seen, as PyCRAM's own are without; and their numbers there."""
    client = bullet.connect(bullet.DIRECT)
    numbers = {}
    for body in world.objects:
        pose = body.get_position_and_orientation()
        numbers[body.name] = number = bullet.loadURDF(
            str(body.model.path), *pose, useFixedBase=True, physicsClientId=client
        )
        joints = [bullet.getJointInfo(number, j, client) for j in range(bullet.getNumJoints(number, client))]
        for joint in joints:
            if (name := joint[1].decode()) in body.joints:
                bullet.resetJointState(number, joint[0], body.get_joint_position(name), physicsClientId=client)
    return client, numbers


def units(world: BulletWorld) -> dict[str, Callable[[], object]]:
    client, body = world.engine._client, world.robot.handle
    visible, _ = with_visuals(world)
    view = bullet.computeViewMatrix([0.3, 0.6, 1.3], [1.4, 1, 0.9], [0, 0, 1])
    lens = bullet.computeProjectionMatrixFOV(60, 1, 0.02, 20)

    def image() -> object:
        return bullet.getCameraImage(256, 256, view, lens, renderer=bullet.ER_TINY_RENDERER, physicsClientId=visible)

    def kinematics() -> object:
        return bullet.calculateInverseKinematics(
            body.id, body.links[LEFT], [1.4, 1, 0.9], [0, 0, 0, 1], physicsClientId=client
        )

    return {"step": lambda: world.engine.step(1), "IK call": kinematics, "image": image}


def queries(kitchen: Object) -> dict[str, tuple[Callable[[], object], str, float]]:
    """Each query with its unit and its goal."""
    world = kitchen.world
    robot, milk, cereal = world.robot, world.get_object("milk"), world.get_object("cereal")
    x, y, z = milk.get_position()
    within = [x - 0.75, y + 0.3, z + 0.2]  # inside of what the arm could reach, but for the hand's orientation
    falling = Object("falling", "box", "milk.stl", [1.5, 0, 1.4])
    return {
        "contact": (lambda: btr.contact(kitchen, milk), "step", 0.1),
        "supporting": (lambda: btr.supporting(kitchen, milk), "step", 0.1),
        "stable, falls": (lambda: btr.stable(falling), "step", 5),
        "visible": (lambda: btr.visible(milk, FRAME), "image", 0.2),
        "occluding": (lambda: btr.occluding(cereal, [0.3, 0.6, 1.3]), "image", 0.2),
        "reachable": (lambda: btr.reachable(milk, robot, LEFT), "IK call", 3),
        "not reachable, far": (lambda: btr.reachable([1.8, 1, 1], robot, LEFT), "IK call", 3),
        "reachable pose": (
            lambda: btr.reachable_pose([x, y, z], robot, LEFT, orientation=[0, 0, 0, 1]),
            "IK call",
            3,
        ),
        "not reachable, turned": (
            lambda: btr.reachable_pose(within, robot, LEFT, orientation=[0, 0, 1, 0]),
            "IK call",
            3,
        ),
        "blocking": (lambda: btr.blocking(cereal, robot, LEFT), "IK call", 5),
        "blocking, blocked": (lambda: btr.blocking(milk, robot, LEFT), "IK call", 5),
    }


def test_what_queries_cost(kitchen: Object) -> None:
    world = kitchen.world
    milk, unit = world.get_object("milk"), units(world)
    print()
    rows = {"stable": (lambda: btr.stable(milk), "step", 40.0)}  # before anything falls nearby
    costs = {}
    for name, (query, of, most) in rows.items():
        costs[name] = cost_of(query, unit[of]), of, most
    rows = queries(kitchen)
    for name, (query, of, most) in rows.items():
        costs[name] = cost_of(query, unit[of]), of, most
    for name, (cost, of, most) in costs.items():
        goal(f"{name}, in {of}s", cost, most)


def forget() -> None:
    """Begin as if no query had been asked yet, nor anything been loaded for one."""
    for cached in (shapes.shapes_of, shapes._read, shapes._mesh, shapes._mesh_ends, boxes._bounds, solids_of):
        cached.cache_clear()
    for cached in (simulation_clone.divided, simulation_clone.single_link):
        cached.cache_clear()
    for cached in (forward.drivers, boxes._structure, boxes.joint_counts):
        cached.cache_clear()
    for clones in simulation_clone._clones.values():
        for clone in clones.values():
            clone.close()
        clones.clear()


def test_what_queries_cost_in_a_large_kitchen(tmp_path: Path) -> None:
    """Many links that never move cost little, the first time neither: then shapes are read and clones made."""
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        large_kitchen.furnish(world, tmp_path)
        for name, x, y, height in (("milk", 1.3, 0.3, 0.099), ("bowl", 1.3, -0.1, 0.037), ("cup", 1.16, 0.3, 0.06)):
            Object(name, name, f"{name}.stl", [x, y, large_kitchen.TOP + height])
        world.simulate(0.5)
        milk, robot, unit = world.get_object("milk"), world.robot, units(world)
        assert [body.name for body in btr.blocking(milk, robot, LEFT)] == ["cup"]
        assert btr.stable(milk)
        print()
        goal("stable, in steps", cost_of(lambda: btr.stable(milk), unit["step"]), 10)

        def first(query: Callable[[], object]) -> float:
            forget()
            return seconds(query)

        for name, query in {
            "visible": lambda: btr.visible(milk, FRAME),
            "blocking": lambda: btr.blocking(milk, robot, LEFT),
            "stable": lambda: btr.stable(milk),
        }.items():
            cost = ratio(lambda query=query: first(query), lambda: seconds(unit["step"]))
            goal(f"first {name}, in steps", cost, 150 if name == "stable" else 50)


def test_what_blocking_costs_in_clutter(kitchen: Object) -> None:
    """Random things close together on the counter, one after the other the target, for both arms."""
    world = kitchen.world
    robot, unit = world.robot, units(world)["IK call"]
    for body in [body for body in world.objects if not body.fixed]:
        body.remove()
    rng = np.random.default_rng(0)
    costs: dict[str, list[float]] = {"blocked": [], "free": [], "out of reach": []}
    for _ in range(amount(8, 4)):
        things = []
        for index, file in enumerate(rng.choice(CLUTTER, 6)):
            body = Object(
                f"{file}_{index}", str(file), f"{file}.stl", [0, 0, 2], geometry.from_rpy(0, 0, rng.uniform(-3, 3))
            )
            x, y = rng.uniform([1.1, 0.5], [1.5, 0.9])
            body.set_position([float(x), float(y), 2.85 - body.get_AABB()[0][2]])
            things.append(body)
        for body in things[:3]:
            for arm in (LEFT, RIGHT):
                found = btr.blocking(body, robot, arm)
                kind = "blocked" if found else "free" if found.evidence["reached"] else "out of reach"
                costs[kind].append(cost_of(lambda body=body, arm=arm: btr.blocking(body, robot, arm), unit, 3))
        for body in things:
            body.remove()
    print()
    for kind, each in costs.items():
        goal(f"blocking, {kind}, in IK calls, the median of {len(each)}", statistics.median(each), 5)


@pytest.mark.costly
def test_what_is_far_away_costs_little(kitchen: Object) -> None:
    """The same queries and changes before and after ten times as many things stand 20 m away."""
    world = kitchen.world
    milk = world.get_object("milk")
    asked = {
        "stable": lambda: btr.stable(milk),
        "a change": lambda: milk.set_position(milk.get_position()),
        "restore": lambda: world.restore(world.save()),
    }
    asked |= {name: query for name, (query, _, _) in queries(kitchen).items()}
    world.get_object("falling").remove()
    del asked["stable, falls"]
    unit = units(world)["IK call"]  # which sees nothing of other bodies
    before = {name: cost_of(query, unit) for name, query in asked.items()}
    for index in range(MANY):
        Object(f"far_{index}", "box", "milk.stl", [20 + index % 7, 20 + index // 7, 0.098])
    world.simulate(0.1)
    after = {name: cost_of(query, unit) for name, query in asked.items()}
    print()
    for name, cost in after.items():
        most = 5 if name == "restore" else 2  # a restoration looks at every object
        goal(f"{name}, {cost:.2f} IK calls with {MANY} far things, of that without", cost / (before[name] + 0.04), most)
    falling, first = Object("falling", "box", "milk.stl", [20.5, 20.5, 1.4]), world.get_object("far_0")
    beside = ratio(lambda: seconds(lambda: btr.stable(first)), lambda: seconds(lambda: btr.stable(falling)))
    goal(f"stable among {MANY} things while another one falls, of stable for the falling one", beside, 12)


@pytest.mark.long
def test_verdicts_are_those_of_full_size_images(kitchen: Object) -> None:
    """500 random views against two images of 256x256, counted as the thesis does."""
    world = kitchen.world
    things = [body for body in world.objects if not body.fixed]
    rng = np.random.default_rng(0)
    lens = bullet.computeProjectionMatrixFOV(60, 1, NEAR, FAR)
    same = asked = 0
    together, numbers = with_visuals(world)
    lone, copies = with_visuals(world)  # each object alone
    while asked < 500:
        body = things[int(rng.integers(len(things)))]
        low, high = body.get_AABB()
        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        eye = [float(c) for c in middle + rng.uniform([-1.2, -1, -0.1], [0.2, 1, 0.9])]
        if np.linalg.norm(np.subtract(eye, middle)) < 0.3:
            continue
        asked += 1
        position, turn = geometry.invert((eye, geometry.look_at(eye, middle)))
        view = np.diag([1.0, -1.0, -1.0, 1.0]) @ geometry.pose_matrix((position, turn))

        def pixels(number: int, where: int, view: np.ndarray = view) -> int:
            picture = bullet.getCameraImage(
                256, 256, view.T.ravel().tolist(), lens, renderer=bullet.ER_TINY_RENDERER, physicsClientId=where
            )
            return int((np.asarray(picture[4]) == number).sum())

        for name, copy in copies.items():
            pose = body.get_position_and_orientation() if name == body.name else ([0, 0, -500], [0, 0, 0, 1])
            bullet.resetBasePositionAndOrientation(copy, *pose, physicsClientId=lone)
        alone, seen = pixels(copies[body.name], lone), pixels(numbers[body.name], together)
        same += bool(btr.visible(body, eye)) == (seen > 0.8 * alone)
    print(f"\n{same} of {asked} verdicts are those of full-size images")
    assert same >= 0.99 * asked


@pytest.mark.costly
def test_many_places_of_the_robot(kitchen: Object) -> None:
    world = kitchen.world
    robot, milk = world.robot, world.get_object("milk")
    rng, count = np.random.default_rng(1), amount(200, 40)
    bases = [
        ([float(x), float(y), 0.0], geometry.from_rpy(0, 0, float(yaw)))
        for x, y, yaw in rng.uniform([0.2, 0.3, -0.6], [0.9, 1.7, 0.6], (count, 3))
    ]
    at = milk.get_position()
    print()
    for name, options in {
        "any orientation": {},
        "from the front": {"orientations": [[0, 0, 0, 1]]},
        "and free": {"orientations": [[0, 0, 0, 1]], "collision_free": True, "ignoring": [milk]},
    }.items():
        took = seconds(lambda options=options: btr.reachable_poses([at], robot, LEFT, bases=bases, **options))
        step = statistics.median(seconds(lambda: world.engine.step(1)) for _ in range(30))
        goal(f"{count} places, {name}: {took:.2f} s, in steps", took / step, 2.5 * count)
