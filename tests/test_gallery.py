"""docs/gallery.md and the pages of robots: pictures and plans exist, and the tables have the data of the descriptions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.make_pictures import SHOTS
from pycram.models.robots.description import RobotDescription

REPO = Path(__file__).parents[1]
DOCS = REPO / "docs"
ROBOTS = sorted(page.stem for page in (DOCS / "robots").glob("*.md"))


def test_the_gallery_has_each_picture_with_the_command_of_its_recording() -> None:
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    commands = dict(re.findall(r"!\[[^\]]*\]\((\S+)\).*?```sh\n(.*?)\n", text, re.DOTALL))
    assert commands.pop("set_the_table.gif") == "pycram demo --motion continuous --seed 1"
    assert commands == {f"gallery/{shot.name}.png": f"pycram demo {shot.command} --seed 1" for shot in SHOTS}
    assert {path.name for path in (DOCS / "gallery").iterdir()} == {f"{shot.name}.png" for shot in SHOTS}
    plans = re.findall(r"^Plan: `(.*)`$", text, re.MULTILINE)
    assert len(plans) == text.count("\n## ")
    assert all((REPO / plan).is_file() for plan in plans)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_page_of_a_robot_has_the_data_of_its_description(name: str) -> None:
    text = (DOCS / "robots" / f"{name}.md").read_text(encoding="utf-8")
    rows = {part.rstrip("s"): told for part, told in re.findall(r"^\| ([\w, ]+) \| (.*) \|$", text, re.MULTILINE)}
    described = RobotDescription.load(REPO / "pycram" / "models" / "robots" / f"{name}.toml")
    assert (DOCS / "robots" / re.findall(r"!\[.*\]\((.*)\)", text)[0]).is_file()
    assert rows["base"].startswith("drives" if described.drives else "fixed")
    assert set(re.findall(r"`(\w+)`", rows["arm"])) == set(described.arms)
    (joints,) = {len(arm.joints) for arm in described.arms.values()}
    assert f"{joints} joints" in rows["arm"]
    assert set(re.findall(r"`(\w+)`", rows["named posture"])) == {
        posture for arm in described.arms.values() for posture in arm.poses
    }
    assert ("torso" in rows) == bool(described.torso)
    if described.camera:
        assert f"`{described.camera.frame}`" in rows["camera"]
    else:
        assert rows["head, camera"].startswith("none")
    for told in re.findall(r"(\d+) mm between the open", rows["gripper"]):
        assert {round(arm.gripper.aperture * 1000) for arm in described.arms.values()} == {int(told)}


def test_each_bundled_robot_has_a_page() -> None:
    assert [path.stem for path in sorted((REPO / "pycram" / "models" / "robots").glob("*.toml"))] == ROBOTS
