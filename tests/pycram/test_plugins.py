"""Robots, process modules and actions of another installed package are found by name, when their name is asked for."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import replay
from pycram.models import files
from pycram.models.robots import description
from recorder.records import Output

PACKAGE = """
from pathlib import Path
from pycram.process_module import ProcessModule

print("imported")
ROBOT = Path(__file__).with_name("robot.toml")

class Waving(ProcessModule):
    def _execute(self, designator):
        return "waved " + designator.reference()["hand"]
"""
ACTIONS = """
from pycram.actions import action

@action("greeting")
def greet(guest):
    '''Greet somebody.

    Args:
        guest: Name of the guest.
    '''
    return "hello " + guest
"""
PLAN = """
from pycram.actions import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import ActionDesignator, MotionDesignator
from pycram.process_module import ProcessModule

print("before")
with BulletWorld():
    robot = BulletWorld.robot = Object("robot", "robot", "robot.urdf", packages=[FOLDER])
    print(robot.description.robot)
    print(ProcessModule.perform(MotionDesignator(type="waving", hand="left")))
    print(perform(ActionDesignator(type="greeting", guest="Ada")))
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder with the package, as pip leaves it."""
    package = tmp_path / "site" / "friendly"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(PACKAGE)
    (package / "actions.py").write_text(ACTIONS)
    own = Path(description.__file__).with_name("panda.toml").read_text()
    (package / "robot.toml").write_text(re.sub(r"^robot = .*", 'robot = "friend"', own, flags=re.MULTILINE))
    entries = tmp_path / "site" / "friendly-1.2.dist-info"
    entries.mkdir()
    (entries / "METADATA").write_text("Metadata-Version: 2.1\nName: friendly\nVersion: 1.2\n")
    (entries / "entry_points.txt").write_text(
        "[pycram.robots]\nfriend = friendly:ROBOT\n"
        "[pycram.process_modules]\nwaving = friendly:Waving\n"
        "[pycram.actions]\ngreeting = friendly.actions\n"
    )
    return tmp_path / "site"


def run(plan: Path, site: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pycram", "run", *options, plan]
    return subprocess.run(
        command, env={**__import__("os").environ, "PYTHONPATH": f"{site}:{Path(__file__).parents[2]}"},
        cwd=plan.parent, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_a_plan_uses_them_by_their_names_and_the_package_is_on_record(site: Path, tmp_path: Path) -> None:
    urdf = files.find("panda.urdf").read_text()
    (tmp_path / "robot.urdf").write_text(re.sub(r'<robot\s+name="[^"]*"', '<robot name="friend"', urdf, count=1))
    plan = tmp_path / "plan.py"
    plan.write_text(PLAN.replace("FOLDER", repr(str(files.find("panda.urdf").parents[3]))))
    ended = run(plan, site, "--log", "run.mcap")
    assert ended.stdout.splitlines() == ["before", "imported", "friend", "waved left", "hello Ada"], ended.stderr
    with replay.open(tmp_path / "run.mcap") as log:
        lines = [record.text for record in log.records(Output) if record.logger == "pycram.plugins"]
    assert lines == [
        "loaded friend of friendly 1.2 (pycram.robots: friendly:ROBOT)",
        "loaded waving of friendly 1.2 (pycram.process_modules: friendly:Waving)",
        "loaded greeting of friendly 1.2 (pycram.actions: friendly.actions)",
    ]


@pytest.mark.costly
@pytest.mark.slow
def test_one_that_cannot_be_imported_or_is_there_twice_is_named(site: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(
        "from pycram.actions import perform\nfrom pycram.designator import ActionDesignator\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        "with BulletWorld():\n    BulletWorld.robot = Object('pr2', 'robot', 'pr2.urdf')\n    perform(ActionDesignator(type='greeting', guest='Ada'))\n"
    )
    (site / "friendly" / "__init__.py").write_text("import nothing_of_this_name")
    assert (
        "greeting of friendly 1.2 (entry point of pycram.actions) can't be used: No module named"
        in run(plan, site).stderr
    )
    other = site / "other-3.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 3\n")
    (other / "entry_points.txt").write_text("[pycram.actions]\ngreeting = other\n")
    assert "uninstall all of these packages but one" in run(plan, site).stderr
