"""What pick-up takes is held on both sides, also what leans; what can't be taken is refused with the true reason."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import Blocked, DoesNotFit, GraspFailed, PlanFailure
from pycram.process_module import execution_environment
from recorder import geometry
from recorder.records import Mutation
from recorder.records.text import mutation_text
from replay.restore.verify import verify
from tests.measures import seeded
from tests.pycram.motions.placing_scenes import TOP, at_table, box, perform

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

KINDS = (
    "milk",
    "breakfast_cereal",
    "cup",
    "bottle",
    "glass",
    "bowl",
    "apple",
    "spoon",
    "fork",
    "knife",
    "plate",
    "pot",
)
FINGERS = [f"l_gripper_{side}_finger{part}_link" for side in "lr" for part in ("", "_tip")]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BulletWorld]:
    with at_table(tmp_path_factory.mktemp("models")) as world:
        yield world


def gaps(world: BulletWorld, body: Object) -> dict[str, float]:
    """How far the left and the right finger are from an object, m."""
    found: dict[str, float] = {}
    for link in FINGERS:
        side = link.split("_")[2]
        for touch in world.engine.link_closest_points(world.robot.handle, link, body.handle, 0.1):
            found[side] = min(found.get(side, 1.0), touch.distance)
    return found


@pytest.mark.parametrize("kind", ["cup", "bowl"])
@pytest.mark.parametrize("degrees", [15, 25, 35])
@pytest.mark.parametrize("way", [0.5, 2.5, -2.0])
def test_what_leans_is_taken_as_it_leans(table: BulletWorld, kind: str, degrees: int, way: float) -> None:
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    lean = geometry.product(geometry.from_rpy(0, 0, way), geometry.from_rpy(math.radians(degrees), 0, 0))
    body = Object("thing", kind, f"{kind}.stl", [0.62, 0.2, TOP + 0.12], lean)
    try:
        perform(type="pick-up", object=body, arm="left")
        assert gaps(table, body) == {"l": pytest.approx(0, abs=5e-3), "r": pytest.approx(0, abs=5e-3)}
        assert geometry.angle(body.get_orientation(), lean) < 1e-6
    finally:
        body.remove()


def test_what_hangs_in_the_air_is_not_taken_as_if_it_stood(table: BulletWorld) -> None:
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    above, near = (Object(f"cup_{z}", "cup", "cup.stl", [0.62, y, TOP + z]) for y, z in ((0.2, 0.4), (-0.2, 0.06)))
    try:
        with pytest.raises(GraspFailed, match="the object hangs in the air, with no support within 10 cm"):
            perform(type="pick-up", object=above, arm="left")
        near.set_position([0.62, 0.2, TOP + 0.4 - 0.12])  # just below it, and in the air as well
        with pytest.raises(GraspFailed, match="the object hangs in the air"):
            perform(type="pick-up", object=above, arm="left")
    finally:
        above.remove()
        near.remove()


@pytest.mark.slow
def test_what_moves_says_so_and_no_time_passes(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    milk.set_position([1.3, 1.0, 1.2])
    scene.simulate(0.1)
    with pytest.raises(GraspFailed, match=r"the object moves at 0\.98 m/s .* world\.settle\(\) waits"):
        perform(type="pick-up", object=milk, arm="left")
    assert scene.settle()
    milk.set_position_and_orientation([1.3, 1.0, 0.947], [0, 0, 0, 1])
    assert scene.settle()
    steps = scene.sim_step
    perform(type="pick-up", object=milk, arm="left")
    assert scene.sim_step == steps


def test_what_is_inside_of_something_says_so(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    x, y, z = milk.get_position()
    scene.get_object("bowl").set_position([x, y + 0.03, z - 0.05])
    with pytest.raises(GraspFailed, match=r"the object is \d+ mm inside bowl; world\.settle\(\) lifts them apart"):
        perform(type="pick-up", object=milk, arm="left")
    assert milk.carrier is None


@pytest.mark.parametrize("environment", ["simulated", pytest.param("continuous", marks=pytest.mark.slow)])
def test_what_lies_on_a_plate_goes_along_until_the_plate_is_put_down(tmp_path: Path, environment: str) -> None:
    """What leans on the plate stays; the recording tells which."""
    with at_table(tmp_path) as world, recorder.record(tmp_path / "plate.mcap"), execution_environment(environment):
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        plate = Object("plate", "plate", "plate.stl", [0.62, 0.2, TOP + 0.01])
        apple = Object("apple", "apple", "apple.stl", [0.64, 0.16, TOP + 0.06])
        knife = Object("knife", "knife", "knife.stl", [0.8, 0.2, TOP + 0.04])
        assert world.settle()
        lay = knife.get_position_and_orientation()
        at = geometry.multiply(
            geometry.invert(plate.get_position_and_orientation()), apple.get_position_and_orientation()
        )
        perform(type="pick-up", object=plate, arm="left")
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        assert apple.carrier is plate
        assert knife.carrier is None
        assert math.dist(knife.get_position(), lay[0]) < 0.03
        perform(type="place", object=plate, arm="left", target=[0.62, 0.5, TOP + 0.01])
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        assert apple.carrier is plate.carrier is None
        now = geometry.multiply(
            geometry.invert(plate.get_position_and_orientation()), apple.get_position_and_orientation()
        )
        assert math.dist(now[0], at[0]) < 0.01
        assert math.dist(plate.get_position()[:2], (0.62, 0.5)) < 0.02
    with replay.open(tmp_path / "plate.mcap") as log:
        (taken,) = [record for record in log.records(Mutation) if record.HasField("attach_body")]
        assert mutation_text(taken).endswith("with apple, leaving knife")
        assert verify(log).problem is None


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_spoon_over_the_edge_of_the_sink_is_taken(scene: BulletWorld, arm: str) -> None:
    """Its end hangs below the counter, where finger tips have no room."""
    for name in ("milk", "bowl"):
        scene.get_object(name).remove()
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    spoon = Object("handle over the sink", "spoon", "spoon.stl", [1.3, 0.9, 0.88])
    assert scene.settle()
    assert spoon.get_AABB()[0][2] < 0.84
    perform(type="pick-up", object=spoon, arm=arm)
    assert spoon.carrier is scene.robot


def test_a_tile_that_is_as_wide_as_fingers_reach_is_taken(table: BulletWorld, tmp_path: Path) -> None:
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    tile = Object("tile", "tile", box(tmp_path, "tile", (0.07, 0.07, 0.006)), [0.62, 0.2, TOP + 0.003])
    try:
        perform(type="pick-up", object=tile, arm="left")
        assert gaps(table, tile) == {"l": pytest.approx(0, abs=5e-3), "r": pytest.approx(0, abs=5e-3)}
    finally:
        tile.remove()


def test_what_leans_and_fits_from_no_side_says_both(scene: BulletWorld) -> None:
    lean = list(geometry.from_rpy(math.radians(20), 0, 0))
    pot = Object("pot", "pot", "pot.stl", [1.3, 0.9, 1.1], lean)
    with pytest.raises(DoesNotFit, match="because it leans by 20 degrees, it is too big for the gripper") as refused:
        perform(type="pick-up", object=pot, arm="left", grasp="front")
    assert min(refused.value.widths) > refused.value.widest == pytest.approx(0.086)
    assert str(refused.value).endswith("up to 86 mm fit between the fingers; it fits from the top")


def test_a_side_that_does_not_fit_is_answered_with_the_sides_that_fit(scene: BulletWorld, tmp_path: Path) -> None:
    crate = box(tmp_path, "crate", (0.12, 0.12, 0.12))
    for model, fitting in (("breakfast_cereal.stl", "the front or the top"), (crate, "no other side")):
        thing = Object("thing", "thing", model, [1.36, 0.5, 0.96])
        assert scene.settle()
        with pytest.raises(DoesNotFit, match=f"; it fits from {fitting}$"):
            perform(type="pick-up", object=thing, arm="left", grasp="left")
        thing.remove()


@pytest.mark.slow
def test_an_object_is_put_into_a_pot(scene: BulletWorld) -> None:
    milk, pot = scene.get_object("milk"), Object("pot", "pot", "pot.stl", [-0.8, 1.0, 0.93])
    assert scene.settle()
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    perform(type="pick-up", object=milk, arm="left", grasp="top")
    perform(type="move-arm-joints", left_arm="park")
    perform(type="moving", target=[-0.1, 1.0, 0], orientation=[0, 0, 1, 0])
    perform(type="place", object=milk, target=pot.get_position(), arm="left")
    stood = milk.get_position()
    assert scene.engine.deepest(milk.handle, pot.handle).distance > -1e-3, "its collision shape is hollow"
    assert milk.get_AABB()[0][2] < pot.get_AABB()[0][2] + 0.01, "it stands on the pot's bottom"
    scene.simulate(2)
    assert milk.get_position() == pytest.approx(stood, abs=1e-3)


def test_what_is_hardly_too_big_is_not_said_to_be_as_big_as_what_fits() -> None:
    said = {width: str(DoesNotFit("left", "apple", [width, 0.1], 0.0075, 0.0729)) for width in (0.0748, 0.0731)}
    assert "measures 75, 100 mm, 7.5-73 mm fit" in said[0.0748]
    assert "measures 73.1, 100.0 mm, 7.5-72.9 mm fit" in said[0.0731]


@pytest.mark.slow
def test_a_wall_that_slips_through_the_fingers_is_too_thin() -> None:
    """What TIAGo Pro's fingers leave between them when closed is more than the wall of a pot."""
    with BulletWorld() as world:
        world.robot = Object("tiago_pro", "robot", "tiago_pro.urdf")
        pot = Object("pot", "pot", "pot.stl", [0.8, 0.2, 0.9], geometry.from_rpy(0, 0, math.radians(45)))
        with pytest.raises(DoesNotFit, match="it is too big or too thin for the gripper") as refused:
            perform(type="pick-up", object=pot, arm="left")
        widths, gap, widest = refused.value.widths, refused.value.gap, refused.value.widest
        assert min(widths) < gap == 0.0075, "its wall"
        assert max(widths) > widest == pytest.approx(0.073), "all of it"
        assert not [width for width in widths if gap <= width <= widest]


def test_what_lies_between_the_fingers_too_is_in_the_way(table: BulletWorld) -> None:
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    knife = Object("thing", "knife", "knife.stl", [0.62, 0.2, TOP + 0.01])
    fork = Object("fork", "fork", "fork.stl", [0.62, 0.222, TOP + 0.012])
    try:
        assert table.settle()
        with pytest.raises(Blocked, match=r"l_gripper_\w+ would touch fork"):
            perform(type="pick-up", object=knife, arm="left", grasp="top")
        fork.remove()
        perform(type="pick-up", object=knife, arm="left", grasp="top")
    finally:
        for body in (knife, fork):
            if body.alive:
                body.remove()


@pytest.mark.costly
@seeded("taken and still held", range(120), 8)
def test_what_was_taken_is_still_in_the_hand_half_a_second_later(tmp_path: Path, seeds: range) -> None:
    taken = 0
    with at_table(tmp_path) as world:
        for seed in seeds:
            body = lying_about(world, seed)
            try:
                perform(type="pick-up", object=body, arm="left")
            except PlanFailure:
                assert body.carrier is None
                continue
            else:
                taken += 1
                assert set(gaps(world, body)) == {"l", "r"}
                assert max(gaps(world, body).values()) < 6e-3, (seed, gaps(world, body))
                held = in_hand(world, body)
                world.simulate(0.5)
                later = in_hand(world, body)
                assert math.dist(held[0], later[0]) < 1e-3, seed
                assert geometry.angle(held[1], later[1]) < math.radians(0.5), seed
            finally:
                perform(type="move-arm-joints", left_arm="park")
                body.remove()
    assert taken > len(seeds) / 2


def lying_about(world: BulletWorld, seed: int) -> Object:
    """A household thing that was dropped onto the table, and has come to rest."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    turn = geometry.from_rpy(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3))
    body = Object("thing", kind, f"{kind}.stl", [*rng.uniform([0.55, 0.0], [0.7, 0.35]), TOP + 0.2], turn)
    world.settle()
    return body


def in_hand(world: BulletWorld, body: Object) -> geometry.Pose:
    tool = world.robot.get_link_position_and_orientation("l_gripper_tool_frame")
    return geometry.multiply(geometry.invert(tool), body.get_position_and_orientation())
