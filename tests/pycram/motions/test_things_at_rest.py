"""Sixty things of twelve shapes, as they came to rest alone, in, on or against others: taken and put down, or refused.

Each verdict is checked. What was taken stays in the hand, and what was put down stands upright and stays. Nothing else
falls that the thing didn't hold up. Where pick-up names a thing in the way, it takes the other once that is gone. Where
place names an orientation, the thing lies there. A refusal changes nothing.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from pycram.bullet_world import Object
from pycram.failures import Blocked, DoesNotFit, GraspFailed, PlaceFailed, PlanFailure, Unreachable
from pycram.reasoning.collision.ray_cast import center
from pycram.world.attachment import taken_along
from recorder import geometry
from tests.measures import seeded
from tests.pycram.motions.placing_scenes import EDGE, TOP, at_table, box, perform

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from pycram.bullet_world import BulletWorld

MESHES = ("spoon", "fork", "knife", "plate", "bowl", "cup", "glass", "bottle", "milk")
SIZES = {"rod": (0.2, 0.012, 0.012), "bar": (0.18, 0.02, 0.02), "tile": (0.07, 0.07, 0.006)}
KINDS = (*SIZES, *MESHES)
PARTNERS = ("", "bowl", "cup", "plate", "milk", "spoon", "bowl", "cup", "same")
WAYS = ((0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0), (0.0, math.pi / 2, 0.0), (math.pi, 0.0, 0.0))
THERE = (EDGE + 0.22, 0.35)  # m: where the thing is taken
GOAL = [EDGE + 0.2, -0.05, TOP + 0.08]
FAR = -5.0  # m: where things come to rest, on the floor; and where those go that are too far apart


class Scene:
    """A thing that came to rest, and another that it may touch."""

    def __init__(self, world: BulletWorld, seed: int, files: Mapping[str, str]) -> None:
        rng = np.random.default_rng(seed)
        kind, partner = KINDS[seed % len(KINDS)], PARTNERS[(seed // len(KINDS) + seed) % len(PARTNERS)]
        partner = kind if partner == "same" else partner
        self.world, self.kind = world, f"{kind} by {partner or 'itself'}"
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        self.others = [self._dropped("other", partner, files, (0.0, 0.0), WAYS[0], rng)] if partner else []
        way = WAYS[rng.integers(4)] if rng.random() < 0.8 else tuple(rng.uniform(-3, 3, 3))
        off = rng.uniform(-0.08, 0.08, 2) * (rng.random() < 0.6)
        self.thing = self._dropped("thing", kind, files, off, way, rng)
        x, y, _ = center(self.thing)
        for body in (self.thing, *self.others):
            u, v, w = body.get_position()
            near = max(abs(u - x), abs(v - y)) < 0.2
            body.set_position([u - x + THERE[0], v - y + THERE[1], w + TOP] if near else [FAR, 0, w])
        self.rests = world.settle(timeout=3)
        self.along, self.left = taken_along(self.thing)

    def _dropped(
        self,
        name: str,
        kind: str,
        files: Mapping[str, str],
        at: Sequence[float],
        way: Sequence[float],
        rng: np.random.Generator,
    ) -> Object:
        turn = geometry.product(geometry.from_rpy(0, 0, rng.uniform(-3, 3)), geometry.from_rpy(*way))
        below = max((other.get_AABB()[1][2] for other in self.world.objects if not other.fixed), default=0.0)
        body = Object(name, kind, files[kind], [FAR + at[0], FAR + at[1], below + 0.13], turn)
        self.world.settle(timeout=3)
        return body

    def states(self) -> list[object]:
        """Where everything is, to the last bit."""
        return [(body.get_position_and_orientation(), body.get_joint_positions()) for body in self.world.objects]


def lean(body: Object) -> float:
    return math.degrees(geometry.lean(body.get_orientation(), geometry.IDENTITY[1]))


def perform_on(scene: Scene, **slots: object) -> PlanFailure | None:
    """Performs a motion with the thing; a motion that is refused changes nothing."""
    before = scene.states()
    failure: PlanFailure | None = None
    try:
        perform(object=scene.thing, arm="left", **slots)
    except PlanFailure as error:
        failure = error
    released = isinstance(failure, PlaceFailed) and failure.rest is not None
    assert failure is None or released or scene.states() == before, failure
    return failure


def stands(body: Object) -> bool:
    """Whether an object stands upright, or upside down, and stays for a second."""
    before = body.get_position_and_orientation()
    body.world.simulate(1)
    position, turn = body.get_position_and_orientation()
    stayed = math.dist(position, before[0]) < 0.01 and geometry.angle(turn, before[1]) < math.radians(5)
    return stayed and min(lean(body), 180 - lean(body)) < 10


def check_pick_up_refused(scene: Scene, failure: PlanFailure) -> None:
    """What is said to be in the way is: without it, something else is, or nothing."""
    assert scene.thing.carrier is None
    assert isinstance(failure, Blocked | DoesNotFit | GraspFailed), failure
    named = {body.name for body in scene.others} & set(getattr(failure, "bodies", ()))
    for body in scene.others:
        if body.name in named:
            body.set_position([FAR, FAR, 0.2])
    if named:
        second = perform_on(scene, type="pick-up")
        assert named.isdisjoint(getattr(second, "bodies", ())), second


def check_others(scene: Scene, before: Mapping[Object, tuple[float, float]]) -> None:
    """Nothing has fallen but what the thing held up."""
    for body, (height, leant) in before.items():
        if body not in (*scene.along, *scene.left):
            assert height - body.get_position()[2] < 0.05, (scene.kind, body.name, "fell")
            assert lean(body) - leant < 15, (scene.kind, body.name, "was knocked over")


def tried(scene: Scene) -> str:
    """Take the thing and put it down; return what came of it."""
    thing = scene.thing
    before = {body: (body.get_position()[2], lean(body)) for body in scene.others}
    failure = perform_on(scene, type="pick-up")
    if failure is not None:
        check_pick_up_refused(scene, failure)
        return f"pick-up refused: {failure}"
    perform(type="move-arm-joints", left_arm="park")
    scene.world.simulate(1)
    assert thing.carrier is scene.world.robot
    check_others(scene, before)
    failure = perform_on(scene, type="place", target=GOAL)
    if failure is None:
        assert math.dist(thing.get_position()[:2], GOAL[:2]) < 0.02
        assert stands(thing), (scene.kind, lean(thing))
        check_others(scene, before)
        return "put down upright"
    assert isinstance(failure, PlaceFailed | Unreachable), failure
    assert thing.carrier is scene.world.robot, failure
    if found := re.search(r"orientation=\[(.*)\]", str(failure)):
        turn = [float(part) for part in found[1].split(",")]
        assert perform_on(scene, type="place", target=GOAL, orientation=turn) is None, failure
        return f"put down lying: {failure}"
    return f"place refused: {failure}"


@seeded("things at rest, taken and put down", range(60), 4)
def test_things_are_taken_and_put_down_or_refused_truly(
    tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    files = {name: box(tmp_path, name, size) for name, size in SIZES.items()} | {name: f"{name}.stl" for name in MESHES}
    counts = dict.fromkeys(("put down upright", "put down lying", "pick-up refused", "place refused"), 0)
    with at_table(tmp_path) as world:
        for seed in seeds:
            scene = Scene(world, seed, files)
            result = tried(scene)
            counts[result.partition(":")[0]] += 1
            for body in (scene.thing, *scene.others):
                body.remove()
    for name, count in counts.items():
        record_property(name, count)
    assert counts["put down upright"] + counts["put down lying"] >= len(seeds) / 2
