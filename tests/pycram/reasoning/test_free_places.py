"""Where an object can be put down: proved by setting it there and letting time run."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import BadArgument, NoPlace, UnknownName
from pycram.reasoning.places import free_places
from recorder import geometry
from recorder.records import Query
from recorder.records.text import rejections, text_of
from recorder.viewer.queries import scores_of, spots_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.reasoning.places import FoundPlace
    from tests.conftest import MemorySink

TOP = 0.72  # m, the table's
FINGER = 0.02  # m


@pytest.fixture(scope="module")
def room() -> Iterator[BulletWorld]:
    """A table 1.3 x 1.8 m with its middle at [0.35, 0], and a few things on it."""
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("table", "environment", "table.urdf")
        Object("bowl", "bowl", "bowl.stl", [0.35, 0.0, TOP + 0.04])
        Object("cereal", "cereal", "breakfast_cereal.stl", [0.6, 0.5, TOP + 0.115])
        Object("milk", "milk", "milk.stl", [0.3, 0.4, TOP + 0.1])
        Object("cup", "cup", "cup.stl", [3.0, 3.0, 0.1])
        world.simulate(0.3)
        yield world


@pytest.fixture
def table(room: BulletWorld) -> Object:
    return room.get_object("table")


def on(table: Object) -> list[tuple[Object, object]]:
    return [(table, table.surface("table"))]


def some(count: int, places: Iterator[FoundPlace]) -> list[FoundPlace]:
    return list(itertools.islice(places, count))


def apart(body: Object, other: Object) -> float:
    """Return how far two objects are apart, m."""
    points = body.world.engine.closest_points(body.handle, other.handle, 1.0)
    return min((point.distance for point in points), default=1.0)


@pytest.mark.slow
def test_an_object_put_down_there_stays_and_leaves_room_for_fingers(room: BulletWorld, table: Object) -> None:
    cup = room.get_object("cup")
    others = [room.get_object(name) for name in ("bowl", "cereal", "milk")]
    saved = room.save()
    for place in some(8, free_places(cup, on=on(table), seed=3)):
        cup.set_position_and_orientation(place.position, place.orientation)
        assert all(apart(cup, other) > FINGER for other in others)
        room.simulate(0.5)
        assert math.dist(cup.get_position(), place.position) < 0.01
        low, high = cup.get_AABB()
        assert (low[2], place.surface) == (pytest.approx(TOP, abs=5e-3), "table")
        assert -0.3 < low[0] < high[0] < 1.0
        assert -0.9 < low[1] < high[1] < 0.9
        room.restore(saved)


def test_places_are_apart_and_depend_on_the_seed(room: BulletWorld, table: Object) -> None:
    cup = room.get_object("cup")
    first = some(4, free_places(cup, on=on(table), seed=1))
    assert first == some(4, free_places(cup, on=on(table), seed=1))
    assert first[0].position != next(free_places(cup, on=on(table), seed=2)).position
    assert all(math.dist(a.position, b.position) > 0.03 for a, b in itertools.combinations(first, 2))
    cup_was = cup.get_position_and_orientation()
    next(free_places(cup, on=on(table)))
    assert cup.get_position_and_orientation() == cup_was


def test_places_are_near_a_point(room: BulletWorld, table: Object) -> None:
    point = [0.8, -0.7]
    place = next(free_places(room.get_object("cup"), on=on(table), near=point, seed=0))
    assert math.dist(place.position[:2], point) < 0.2


@pytest.mark.parametrize(("side", "axis", "sign"), [("left", 1, 1), ("right", 1, -1), ("front", 0, -1), ("back", 0, 1)])
def test_places_are_on_a_side_as_seen_from_the_origin(
    room: BulletWorld, table: Object, side: str, axis: int, sign: int
) -> None:
    """No robot is there, so the world's origin is where one looks from: along x."""
    bowl, cup = room.get_object("bowl"), room.get_object("cup")
    for place in some(2, free_places(cup, on=on(table), side=(side, bowl), seed=4)):
        offset = np.subtract(place.position, bowl.get_position())
        assert sign * offset[axis] > abs(offset[1 - axis])
    for place in some(2, free_places(cup, on=on(table), side=side, seed=4)):
        assert sign * (place.position[axis] - (0.35, 0.0)[axis]) > 0


def test_a_given_orientation_is_kept(room: BulletWorld, table: Object) -> None:
    turn = geometry.from_rpy(0, 0, 1.0)
    place = next(free_places(room.get_object("cereal"), on=on(table), orientation=turn, seed=0))
    assert place.orientation == pytest.approx(turn)


def test_a_full_surface_has_no_room(room: BulletWorld, table: Object, sink: MemorySink) -> None:
    x, y, _ = room.get_object("bowl").get_position()
    mat = replace(table.surface("table"), name="mat", outline=((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)))
    assert math.dist(table.surface_pose(mat)[0][:2], (x, y)) < 0.01
    with pytest.raises(NoPlace, match="cup on mat") as refused:
        next(free_places(room.get_object("cup"), on=[(table, mat)], seed=0))
    assert refused.value.last == "room"
    assert str(refused.value).endswith("; the surface is full; take objects off it, or name another surface") or str(
        refused.value
    ).endswith("; take objects off the surface, or name another surface")
    assert set(refused.value.excluded) <= {"room", "edge"}
    (*_, record) = sink.of(Query)
    assert record.failure.type.endswith("NoPlace")


def test_constraints_that_exclude_each_other_are_named(room: BulletWorld, table: Object) -> None:
    bowl, cup = room.get_object("bowl"), room.get_object("cup")
    bowl_was = bowl.get_position()
    bowl.set_position([0.95, 0.0, TOP + 0.04])
    try:
        with pytest.raises(NoPlace) as refused:  # nothing of the table is there
            next(free_places(cup, on=on(table), side=("back", bowl), seed=0))
    finally:
        bowl.set_position(bowl_was)
    assert refused.value.last == "side back"
    remedy = "there are places without side back: change or omit this constraint"
    assert str(refused.value).endswith(f"the last place was excluded by side back; {remedy}")
    next(free_places(cup, on=on(table), seed=0))


def test_an_object_too_high_for_a_shelf_has_no_place(room: BulletWorld, table: Object) -> None:
    kitchen = Object("kitchen", "environment", "kitchen.urdf", [10, 0, 0])
    try:
        drawer = kitchen.container("sink left upper drawer")
        kitchen.set_joint_position(drawer.joint, drawer.open)
        surface = (kitchen, kitchen.surface(drawer.surfaces[0]))
        with pytest.raises(NoPlace) as refused:
            next(free_places(room.get_object("cereal"), on=[surface], seed=0))
        assert refused.value.last == "clearance"
        assert "higher than the free height above the surface" in str(refused.value)
    finally:
        kitchen.remove()


def test_a_shelf_with_a_finger_of_room_above_an_object_has_places_for_it(room: BulletWorld, table: Object) -> None:
    kitchen = Object("kitchen", "environment", "kitchen.urdf", [10, 0, 0])
    milk = room.get_object("milk")
    saved = room.save()
    try:
        fridge = kitchen.container("fridge")
        kitchen.set_joint_position(fridge.joint, fridge.open)
        shelf = kitchen.surface("fridge shelf 2")
        low, high = milk.get_AABB()
        assert 0.0 < shelf.clearance - (high[2] - low[2]) < 0.03
        (x, y, z), _ = kitchen.surface_pose(shelf)
        for place in some(3, free_places(milk, on=[(kitchen, shelf)], seed=0)):
            milk.set_position_and_orientation(place.position, place.orientation)
            low, high = milk.get_AABB()
            assert low[2] == pytest.approx(z, abs=5e-3)
            assert max(abs(high[0] - x), abs(low[0] - x)) < shelf.size[0] / 2
            assert max(abs(high[1] - y), abs(low[1] - y)) < shelf.size[1] / 2
    finally:
        room.restore(saved)
        kitchen.remove()


@pytest.mark.parametrize("angle", [0, 25, 60])
def test_a_board_hardly_wider_than_an_object_has_places_along_it(room: BulletWorld, table: Object, angle: int) -> None:
    milk = room.get_object("milk")
    low, high = milk.get_AABB()
    half = min(high[0] - low[0], high[1] - low[1]) / 2 + 0.014  # a centimetre to each side, and a little
    turn = geometry.from_rpy(0.0, 0.0, math.radians(angle))
    corners = tuple(
        geometry.rotate(turn, (x, y, 0.0))[:2] for x, y in ((-0.3, -half), (0.3, -half), (0.3, half), (-0.3, half))
    )
    board = replace(table.surface("table"), name="board", position=(0.3, -0.4, 0.72), outline=corners)
    places = some(2, free_places(milk, on=[(table, board)], seed=0))
    assert len(places) == 2
    for place in places:
        _, across, _ = geometry.transform(geometry.invert((table.surface_pose(board)[0], turn)), place.position)
        assert abs(across) < 0.005
        turned = geometry.to_rpy(place.orientation)[2] - math.radians(angle)
        assert abs(math.sin(2 * turned)) < 1e-3, "a quarter turn is as good"


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_places_are_neither_at_the_foot_of_an_arm_nor_at_its_parked_links(
    room: BulletWorld, table: Object, robot: str
) -> None:
    """Who reaches there isn't asked: the arm is in the way of whoever it is."""
    arm = Object(robot, "robot", f"{robot}.urdf", [0, -0.3, TOP])
    bowl = room.get_object("bowl")
    was = bowl.get_position_and_orientation()
    now, park = arm.get_joint_positions(), arm.description.arm(robot).posture("park")
    try:
        for seed in range(2):
            for place in some(4, free_places(bowl, on=on(table), near=[0.05, -0.3], seed=seed)):
                arm.set_joint_positions(park)
                bowl.set_position_and_orientation(place.position, place.orientation)
                assert apart(bowl, arm) > FINGER
                arm.set_joint_positions({name: now[name] for name in park})
    finally:
        arm.remove()
        bowl.set_position_and_orientation(*was)


def test_the_record_of_a_place_has_the_map_and_the_rejected_candidates(
    room: BulletWorld, table: Object, sink: MemorySink
) -> None:
    place = next(free_places(room.get_object("cup"), on=on(table), near=room.get_object("bowl").get_position(), seed=2))
    (record,) = sink.of(Query)
    scores, spots = scores_of(record.grid), spots_of(record.grid)
    assert scores.max() == 1.0
    column, row = (np.array([0.35, 0.0]) - record.grid.origin[:2]) / record.grid.resolution
    assert scores[int(row), int(column)] == 0.0, "the bowl stands there"
    chosen = [number for number, spot in enumerate(record.grid.spots) if spot.candidate == record.chosen]
    assert math.dist(spots[chosen[0]], place.position) < 1e-3
    assert text_of(record)[0].startswith("free_places")
    assert all(spot.candidate >= 0 for spot in record.grid.spots[: chosen[0]])
    assert all(spot.candidate == -1 for spot in record.grid.spots[chosen[0] + 1 :])
    if chosen[0]:
        assert "the place is taken" in rejections(record)


def test_impossible_constraints_are_refused_immediately(room: BulletWorld, table: Object) -> None:
    cup = room.get_object("cup")
    with pytest.raises(UnknownName, match="left"):
        free_places(cup, on=on(table), side="lefft")
    with pytest.raises(BadArgument, match="surface"):
        free_places(cup, on=[])
    with pytest.raises(UnknownName, match="did you mean table"):
        free_places(cup, on=[(table, "tabel")])
    with pytest.raises(BadArgument, match="robot with a description"):
        free_places(cup, on=on(table), reachable_for=table)
    with pytest.raises(BadArgument, match="near"):
        free_places(cup, on=on(table), near=[math.nan, 0])


def test_the_walls_of_a_pot_leave_room_on_its_bottom(room: BulletWorld) -> None:
    cup = room.get_object("cup")
    pot = Object("pot", "pot", "pot.stl", [2.0, 0.0, 0.063])
    try:
        ((name, bottom),) = pot.surfaces.items()  # large enough for a surface of furniture, although the pot is free
        place = next(free_places(cup, on=[(pot, bottom)], seed=1))
        assert place.surface == name
        assert place.position[2] - 0.05 < pot.get_position()[2], "inside of the pot"
    finally:
        pot.remove()


@pytest.mark.slow
def test_a_cup_put_down_on_a_plate_stands_on_the_plate(room: BulletWorld) -> None:
    saved = room.save()
    plate = Object("plate", "plate", "plate.stl", [0.3, -0.5, TOP + 0.012])
    cup = room.get_object("cup")
    room.simulate(0.3)
    (top,) = plate.tops
    assert top.name == "top of plate"
    for place in some(2, free_places(cup, on=[plate], seed=3)):
        assert place.surface == "top of plate"
        cup.set_position_and_orientation(place.position, place.orientation)
        room.simulate(0.5)
        assert btr.supporting(plate, cup)
        assert btr.stable(cup)
        assert math.dist(cup.get_position(), place.position) < 0.01
    for seed in range(10):  # the handle may stick out over the plate's rim
        next(free_places(cup, on=[plate], seed=seed))
    cup.set_position([3.0, 3.0, 0.1])
    with pytest.raises(NoPlace, match="cereal on top of plate"):  # it is wider than the plate's bottom
        next(free_places(room.get_object("cereal"), on=[plate], seed=3))
    plate.remove()
    room.restore(saved)


@pytest.mark.slow
def test_the_top_of_a_thing_is_what_is_on_top_as_it_lies(room: BulletWorld) -> None:
    cereal = room.get_object("cereal")
    saved = room.save()
    (upright,) = cereal.tops
    cereal.set_position_and_orientation([0.6, 0.5, TOP + 0.04], geometry.from_rpy(math.pi / 2, 0, 0))
    (lying,) = cereal.tops
    assert math.prod(lying.size) > 1.5 * math.prod(upright.size)
    (_, _, height), turn = cereal.surface_pose(lying)
    assert height == pytest.approx(cereal.get_AABB()[1][2], abs=0.005)
    assert geometry.rotate(turn, (0, 0, 1)) == pytest.approx((0, 0, 1), abs=1e-6)
    room.restore(saved)
    assert room.get_object("table").tops == ()  # furniture has surfaces
