"""What is loaded inside of something else is warned of, and noted in its record; settling lifts it out."""

from __future__ import annotations

import itertools
import random
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlaceFailed
from pycram.world.overlaps import DEEP, Overlapping
from pycram.world.simulation import separate
from recorder.records import Mutation
from recorder.records.text import mutation_text
from replay.restore.verify import verify
from tests.measures import seeded
from tests.pycram.motions.placing_scenes import perform

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink


def loaded(sink: MemorySink, name: str) -> Mutation:
    (record,) = [r for r in sink.of(Mutation) if r.HasField("load_body") and r.load_body.body == name]
    return record


def test_overlapping_things_are_warned_of_when_they_are_loaded(world: BulletWorld, sink: MemorySink) -> None:
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.8, 1])
    with pytest.warns(Overlapping, match=r"bowl is \d+ mm inside of spoon; world\.settle\(\) lifts") as warned:
        Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 1])
    assert warned[0].filename == __file__
    record = loaded(sink, "bowl")
    (overlap,) = record.load_body.overlaps
    assert (overlap.link, overlap.body, overlap.body_link) == ("bowl", "spoon", "spoon")
    assert overlap.depth > 0.005
    assert mutation_text(record).endswith("mm inside of spoon")
    assert not loaded(sink, "spoon").load_body.overlaps


def test_a_free_object_is_inside_of_furniture_that_is_loaded_later(world: BulletWorld, sink: MemorySink) -> None:
    Object("cup", "cup", "cup.stl", [1.3, 0.9, 0.85])
    with pytest.warns(Overlapping, match=r"^cup is \d+ mm inside of kitchen; world\.settle\(\) lifts"):
        Object("kitchen", "environment", "kitchen.urdf")
    assert mutation_text(loaded(sink, "kitchen")).endswith("mm inside of kitchen")


def test_what_touches_or_is_built_in_is_not_warned_of(scene: BulletWorld, sink: MemorySink) -> None:
    x, y, z = scene.get_object("milk").get_position()
    Object("on it", "cup", "cup.stl", [x, y, z + 0.1 + 0.048])
    Object("built in", "environment", "kitchen.urdf")
    assert [list(r.load_body.overlaps) for r in sink.of(Mutation) if r.HasField("load_body")] == [[], []]


@pytest.mark.slow
def test_settling_lifts_the_later_one_out_and_both_come_to_rest(tmp_path: Path) -> None:
    file = tmp_path / "overlap.mcap"
    with recorder.record(file), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        spoon = Object("spoon", "spoon", "spoon.stl", [0.1, 0, 0.1])
        with pytest.warns(Overlapping):
            bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 0.1])
        assert world.settle()
        assert max(-t.distance for t in world.engine.closest_points(spoon.handle, bowl.handle, 0.05)) < 2e-3
        assert spoon.get_position() == pytest.approx([0.1, 0, 0.01], abs=0.01), "it fell where it was"
        before = bowl.get_position()
        world.simulate(1.0)
        assert bowl.get_position() == pytest.approx(before, abs=2e-3)
    with replay.open(file) as log:
        assert verify(log).problem is None


def heaped(seed: int) -> BulletWorld:
    """Return a world with things in each other, in two of three cases so many that one lift leads to the next."""
    drawn, world = random.Random(seed), BulletWorld()
    width = drawn.choice([0.05, 0.2, 0.5])
    for number in range(drawn.randint(2, 14)):
        kind = drawn.choice(["cup", "bowl", "milk", "spoon", "plate", "knife", "apple"])
        position = [drawn.uniform(0, width), drawn.uniform(0, width), drawn.uniform(0.03, 0.1)]
        Object(f"{kind} {number}", kind, f"{kind}.stl", position, [*(drawn.uniform(-1, 1) for _ in "xyz"), 1])
    return world


def separated_pair_by_pair(world: BulletWorld) -> None:
    free = [body for body in world.objects if not body.fixed]
    for _ in free:
        for earlier, later in itertools.combinations(free, 2):
            deepest = world.engine.deepest(earlier.handle, later.handle)
            if deepest is not None and -deepest.distance > DEEP:
                x, y, z = later.get_position()
                later.set_position([x, y, z + earlier.get_AABB()[1][2] - later.get_AABB()[0][2]])
                break


@seeded("heaps of things in each other, lifted apart", range(200), 6)
def test_things_are_lifted_apart_in_the_order_of_loading(seeds: range) -> None:
    moved = 0
    for seed in seeds:
        with heaped(seed) as world:
            before = [body.get_position() for body in world.objects]
            separate(world)
            lifted = [body.get_position() for body in world.objects]
        with heaped(seed) as world:
            separated_pair_by_pair(world)
            assert [body.get_position() for body in world.objects] == lifted, seed
        moved += before != lifted
    assert moved


def test_what_is_sunk_into_a_counter_is_lifted_onto_it_and_place_does_not_throw_it() -> None:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("kitchen", "environment", "kitchen.urdf")
        world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        with pytest.warns(Overlapping, match=r"mm inside of kitchen"):
            sunk = Object("sunk", "milk", "milk.stl", [1.36, 0.6, 0.875])
        cup = Object("cup", "cup", "cup.stl", [1.36, 0.9, 0.9])
        perform(type="pick-up", object=cup, arm="left")
        with pytest.raises(PlaceFailed, match=r"sunk is 7\d mm inside of kitchen, which would throw it"):
            perform(type="place", object=cup, arm="left", target=[1.36, 0.75, 0.9])
        assert sunk.get_position() == [1.36, 0.6, 0.875]
        assert world.settle()
        assert sunk.get_position() == pytest.approx([1.36, 0.6, 0.947], abs=0.005)
        perform(type="place", object=cup, arm="left", target=[1.36, 0.75, 0.9])
