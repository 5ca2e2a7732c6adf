"""Contact and support: scenes whose truth is known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable

    Scene = Callable[[], tuple[Object, Object, bool, bool]]

LYING = list(geometry.from_rpy(0, math.pi / 2, 0))
SURFACE = 0.85  # m, the counter of the kitchen


@pytest.fixture
def floor(world: BulletWorld) -> Object:
    return Object("floor", "environment", "plane.urdf")


def put(name: str, position: list[float], orientation: list[float] | None = None, kind: str | None = None) -> Object:
    file = {"cereal": "breakfast_cereal.stl"}.get(name, f"{name}.stl")
    return Object(name, kind or name, file, position, orientation or [0, 0, 0, 1])


def rests(seconds: float = 0.75) -> None:
    BulletWorld.current_bullet_world.simulate(seconds)


# Each gives the lower and the upper object, whether they touch, and whether the first carries the second.


def milk_on_the_floor() -> tuple[Object, Object, bool, bool]:
    milk = put("milk", [0, 0, 0.1])
    rests()
    return milk.world.get_object("floor"), milk, True, True


def the_other_way_round() -> tuple[Object, Object, bool, bool]:
    floor, milk, _, _ = milk_on_the_floor()
    return milk, floor, True, False


def a_centimetre_above() -> tuple[Object, Object, bool, bool]:
    milk = put("milk", [0, 0, 0.107])
    return milk.world.get_object("floor"), milk, False, False


def side_by_side() -> tuple[Object, Object, bool, bool]:
    milk, cereal = put("milk", [0, 0, 0.097]), put("cereal", [0.1, 0, 0.1115])
    gap = min(touch.distance for touch in milk.world.engine.closest_points(milk.handle, cereal.handle, 0.1))
    x, y, z = cereal.get_position()
    cereal.set_position([x - gap, y, z])
    return milk, cereal, True, False


def side_by_side_and_lower() -> tuple[Object, Object, bool, bool]:
    milk, cereal, _, _ = side_by_side()
    return cereal, milk, True, False


def apart() -> tuple[Object, Object, bool, bool]:
    return put("milk", [0, 0, 0.097]), put("cereal", [0.3, 0, 0.1115]), False, False


def above_but_carried_by_another() -> tuple[Object, Object, bool, bool]:
    """Over it without touching it."""
    low = put("plate", [0, 0, 0.02])
    base = put("cereal", [0.13, 0, 0.112], kind="environment")
    put("bottle", [0.13, 0, 0.4])
    upper = put("milk", [0.06, 0, base.get_AABB()[1][2] + 0.04], LYING)
    rests(0.3)
    return low, upper, False, False


def milk_on_cereal() -> tuple[Object, Object, bool, bool]:
    cereal = put("cereal", [0, 0, 0.113])
    rests()
    milk = put("milk", [0, 0, cereal.get_AABB()[1][2] + 0.099])
    rests()
    return cereal, milk, True, True


def below_the_one_below() -> tuple[Object, Object, bool, bool]:
    _, milk, _, _ = milk_on_cereal()
    return milk.world.get_object("floor"), milk, False, False


def spoon_in_bowl() -> tuple[Object, Object, bool, bool]:
    bowl, spoon = put("bowl", [0, 0, 0.036]), put("spoon", [0, 0, 0.1])
    rests(1.5)
    return bowl, spoon, True, True


def apple_in_bowl() -> tuple[Object, Object, bool, bool]:
    """Its origin is hardly higher than the bowl's."""
    bowl, apple = put("bowl", [0, 0, 0.036]), put("apple", [0, 0, 0.09])
    rests(1.5)
    return bowl, apple, True, True


def knife_leaning_on_a_rim() -> tuple[Object, Object, bool, bool]:
    """It is carried above its middle."""
    bowl = put("bowl", [0, 0, 0.0355], kind="environment")
    knife = put("knife", [0.09, 0, 0.06], list(geometry.from_rpy(0, 0.75, 0)))
    for _ in range(40):  # down along z until it touches
        if btr.contact(bowl, knife):
            break
        x, y, z = knife.get_position()
        knife.set_position([x, y, z - 0.001])
    return bowl, knife, True, True


def cup_over_a_post() -> tuple[Object, Object, bool, bool]:
    """Upside down on a bottle: what carries it is inside of it, above its middle."""
    post = put("bottle", [0, 0, 0.125], kind="environment")
    glass = put("pot", [0, 0, 0.3], list(geometry.from_rpy(math.pi, 0, 0)))
    rests()
    return post, glass, True, True


def leaning_on_a_wall() -> tuple[Object, Object, bool, bool]:
    wall = put("cereal", [0.15, 0, 0.112], kind="environment")
    milk = put("milk", [0.02, 0, 0.11], list(geometry.from_rpy(0, 0.3, 0)))
    for _ in range(80):
        if btr.contact(wall, milk):
            break
        x, y, z = milk.get_position()
        milk.set_position([x + 0.001, y, z])
    return wall, milk, True, False


def held_by_a_hand() -> tuple[Object, Object, bool, bool]:
    """Attached without touching."""
    post, flag = put("bottle", [0, 0, 0.125]), put("spoon", [0, 0, 0.4])
    post.attach(flag)
    return post, flag, False, False


def plate_under_glass() -> tuple[Object, Object, bool, bool]:
    plate = put("plate", [0, 0, 0.015])
    rests()
    glass = put("glass", [0, 0, plate.get_AABB()[1][2] + 0.064])
    rests()
    return plate, glass, True, True


SCENES: list[Scene] = [
    milk_on_the_floor,
    the_other_way_round,
    a_centimetre_above,
    side_by_side,
    side_by_side_and_lower,
    apart,
    above_but_carried_by_another,
    milk_on_cereal,
    below_the_one_below,
    spoon_in_bowl,
    apple_in_bowl,
    knife_leaning_on_a_rim,
    cup_over_a_post,
    leaning_on_a_wall,
    held_by_a_hand,
    plate_under_glass,
]


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_contact_and_support(floor: Object, scene: Scene) -> None:
    lower, upper, touching, carrying = scene()
    forth, back = btr.contact(lower, upper), btr.contact(upper, lower)
    assert bool(forth) is bool(back) is touching
    assert [links[::-1] for links in back.evidence["links"]] == forth.evidence["links"]
    verdict = btr.supporting(lower, upper)
    assert bool(verdict) is carrying, verdict.evidence
    assert not verdict or forth, "what carries touches"
    assert not btr.supporting(upper, lower) or not carrying, "nothing carries what carries it"
    assert all(normal[2] > 0 for normal in verdict.evidence["normals"])


@pytest.mark.parametrize("gap", [0.002, 0.005, 0.01, 0.05])
def test_a_gap_within_the_margin_counts_as_contact(floor: Object, gap: float) -> None:
    milk = put("milk", [0, 0, 0.097])
    rests()
    x, y, z = milk.get_position()
    milk.set_position([x, y, z + gap])
    assert not btr.contact(milk, floor)
    assert not btr.contact(milk, floor, margin=gap - 0.0015)
    found = btr.contact(milk, floor, margin=gap)
    assert found
    assert found.evidence["distance"] == pytest.approx(gap, abs=1e-3)


def test_the_supporting_drawer_is_named_even_if_it_is_open(scene: BulletWorld) -> None:
    kitchen, spoon, milk = (scene.get_object(name) for name in ("kitchen", "spoon", "milk"))
    drawer = "sink_area_left_upper_drawer_main"
    assert btr.supporting(kitchen, milk).evidence["links"] == ["sink_area_surface"]
    assert btr.supporting(kitchen, spoon).evidence["links"] == [drawer]
    kitchen.set_joint_position(f"{drawer}_joint", 0.3)
    assert btr.supporting(kitchen, spoon).evidence["links"] == [drawer]
    spoon.set_position([spoon.get_position()[0] - 0.4, 0.89, 0.72])
    assert not btr.supporting(kitchen, spoon)


def test_no_time_is_simulated_and_nothing_carries_itself(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    x, y, z = milk.get_position()
    milk.set_position([x, y, z + 0.05])
    assert not btr.contact(milk, scene.get_object("kitchen"))
    assert milk.get_position() == [x, y, z + 0.05]
    assert not btr.contact(milk, milk, margin=1.0)
    assert not btr.supporting(milk, milk)
