"""Links that are boxes collide with others of their own robot, as those that are meshes do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object

if TYPE_CHECKING:
    from pathlib import Path

LINK = '<link name="{}"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'
URDF = f"""<robot name="boxes">{LINK.format("a")}{LINK.format("b")}
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(("slide", "depth"), [(0.15, 0.05), (0.3, None)])
def test_boxes_of_one_robot_touch_where_they_overlap(tmp_path: Path, slide: float, depth: float | None) -> None:
    (tmp_path / "boxes.urdf").write_text(URDF)
    with BulletWorld() as world:
        body = Object("boxes", "robot", str(tmp_path / "boxes.urdf")).handle
        world.objects[0].set_joint_position("slide", slide)
        touches = world.engine.link_closest_points(body, "a", body, link_b="b")
    assert [-touch.distance for touch in touches] == pytest.approx([] if depth is None else [depth], abs=1e-3)
