"""Hands with one moving jaw, three or four fingers are described, pass the checks and hold objects."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import Object
from pycram.describing.check import check
from pycram.failures import AssetError
from pycram.models.robots.description import RobotDescription
from tests.pycram.models import hands
from tests.pycram.motions.placing_scenes import HEIGHTS, perform

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pycram.bullet_world import BulletWorld

ALL = {"one jaw": hands.ONE_JAW, "three fingers": hands.THREE_FINGERS, "four fingers": hands.FOUR_FINGERS}


@pytest.mark.slow
@pytest.mark.parametrize("jaws", ALL.values(), ids=ALL)
def test_each_kind_of_hand_picks_up_and_puts_down_objects(
    world: BulletWorld, tmp_path: Path, jaws: Mapping[str, tuple[float, bool]]
) -> None:
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    urdf, text = hands.write(tmp_path, jaws)
    world.robot = made = Object("gantry", "robot", urdf, description=RobotDescription.parse(text))
    for number, kind in enumerate(("cup", "bottle", "milk")):
        thing = Object(kind, kind, f"{kind}.stl", [0.4, 0.3 * number, HEIGHTS[kind] + 0.001])
        world.simulate(0.3)
        perform(type="pick-up", object=thing)
        fingers = [
            min(touch.distance for touch in world.engine.link_closest_points(made.handle, jaw, thing.handle, 0.1))
            for jaw in jaws
        ]
        assert sum(distance < 0.005 for distance in fingers) >= 2, "it is held between fingers"
        assert min(fingers) > -0.003, "and not within them"
        perform(type="move-arm-joints", **{"z-axis-arm": "park"})
        world.simulate(0.5)
        assert thing.get_position()[2] > 0.5
        target = [-0.2, 0.3 * number, HEIGHTS[kind]]
        perform(type="place", object=thing, target=target)
        assert math.dist(thing.get_position(), target) < 0.01
        assert btr.stable(thing)


def test_a_description_of_each_kind_of_hand_passes_the_checks(world: BulletWorld, tmp_path: Path) -> None:
    def failed(jaws: Mapping[str, tuple[float, bool]], text: str) -> list[str]:
        urdf, _ = hands.write(tmp_path, jaws)
        description = RobotDescription.parse(text)
        made = Object("gantry", "robot", urdf, description=description, world=world)
        found = [str(finding) for finding in check(made, description) if not finding.passed]
        made.remove()
        return found

    for jaws in ALL.values():
        assert failed(jaws, hands.write(tmp_path, jaws)[1]) == []
    _, text = hands.write(tmp_path, hands.ONE_JAW)
    both = text.replace("aperture = 0.0830", "aperture = 0.1630")  # as if the other jaw moved as well
    assert both != text
    (finding,) = failed(hands.ONE_JAW, both)
    assert "aperture is described as 163.0 mm, measured 83.0 mm" in finding
    beside = text.replace("xyz = [0, 0, ", "xyz = [0, 0.03, ")
    assert any("both sides of the tool frame" in finding for finding in failed(hands.ONE_JAW, beside))


@pytest.mark.usefixtures("world")
def test_hands_that_do_not_close_around_the_tool_frame_are_rejected(tmp_path: Path) -> None:
    def refused(jaws: Mapping[str, tuple[float, bool]]) -> str:
        urdf, text = hands.write(tmp_path, jaws)
        with pytest.raises(AssetError) as raised:
            Object("gantry", "robot", urdf, description=RobotDescription.parse(text))
        return raised.value.cause

    skewed = {"thumb": (60.0, True), "index": (240.0, True)}
    assert "closes along the tool frame's z axis, not along y" in refused(skewed)
    assert "all fingers close from the same side" in refused({"thumb": (0.0, True), "index": (30.0, True)})
