"""Stability in a large kitchen: its rigid parts are simulated, and the verdicts are those of its links one by one.

The engine solves contacts in the order in which bodies were loaded, which is no part of a state: in disorderly piles some
verdicts hang on it. So where parts say something else than links, links say it too in another order.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.reasoning.collision import simulation_clone
from pycram.reasoning.queries import stability
from recorder import geometry
from tests import large_kitchen, measures

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

FILES = ["milk", "cup", "bowl", "spoon", "apple", "plate", "pot", "glass", "knife", "bottle", "breakfast_cereal"]
ORDERS = 24  # in which links are tried before a difference is one


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BulletWorld]:
    with BulletWorld() as made:
        made.set_gravity([0, 0, -9.8])
        large_kitchen.furnish(made, tmp_path_factory.mktemp("kitchen"))
        made.robot.remove()  # it only costs time here
        yield made


def pile(world: BulletWorld, rng: random.Random) -> list[Object]:
    """What lies anyhow on a worktop or over its edge, or in an open drawer, some of it still moving."""
    row = world.get_object("kitchen_0")
    for joint in row.joints:
        row.set_joint_position(joint, rng.choice([0.0, large_kitchen.OPEN]))
    x = large_kitchen.FRONT + rng.choice([-0.25, 0.0, 0.1, 0.3])  # over a drawer, the edge, the worktop
    y = rng.uniform(-1.0, 1.0)
    things, height = [], large_kitchen.TOP + 0.1
    for index in range(rng.randint(2, 5)):
        roll, pitch = (rng.uniform(-3, 3) * (rng.random() < 0.4) for _ in range(2))
        at = [x + rng.uniform(-0.07, 0.07), y + rng.uniform(-0.07, 0.07), height]
        file = rng.choice(FILES)
        turn = geometry.from_rpy(roll, pitch, rng.uniform(-3, 3))
        things.append(Object(f"{file}_{index}", file, f"{file}.stl", at, list(turn), world=world))
        height += rng.uniform(0.08, 0.2)
    world.simulate(rng.choice([0.3, 0.7, 1.0, 2.0]))
    return things


def answers(world: BulletWorld, things: Sequence[Object], order: random.Random | None = None) -> list[bool]:
    """Verdicts of clones that nothing was asked before; they load bodies in the given order."""
    for clone in simulation_clone._clones.pop(world, {}).values():
        clone.close()
    participants = stability._participants
    with pytest.MonkeyPatch.context() as patch:
        if order is not None:
            patch.setattr(
                stability, "_participants", lambda body: order.sample(found := participants(body), len(found))
            )
        return [bool(btr.stable(body)) for body in things]


def by_links(world: BulletWorld, things: Sequence[Object], order: random.Random | None = None) -> list[bool]:
    """The same with all links of the kitchen, one by one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation_clone, "_divides", lambda body: False)
        return answers(world, things, order)


@measures.seeded("stable: verdicts in piles, parts against links", range(300), 1)
def test_verdicts_in_piles_agree_with_a_simulation_of_all_links(
    kitchen: BulletWorld, seeds: range, record_property: pytest.RecordProperty
) -> None:
    asked = unlike = unlike_in_another_order = 0
    for seed in seeds:
        rng = random.Random(seed)
        things = pile(kitchen, rng)
        expected, found = by_links(kitchen, things), answers(kitchen, things)
        again = by_links(kitchen, things, rng)
        asked += len(things)
        unlike_in_another_order += sum(a != b for a, b in zip(expected, again, strict=True))
        for number, body in enumerate(things):
            if found[number] != expected[number]:
                unlike += 1
                assert any(by_links(kitchen, [body], rng) == [found[number]] for _ in range(ORDERS)), (seed, body)
        for body in things:
            body.remove()
    record_property("asked", asked)
    record_property("unlike with links", unlike)
    record_property("unlike with links in another order", unlike_in_another_order)
