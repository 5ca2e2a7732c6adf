"""URDFs of the robots in the box: example-robot-data has them with their meshes; the UR5 gets PyCRAM's own gripper."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

from pycram.foundation.failures import AssetError
from pycram.models import packages, store
from pycram.models.files import read_text
from pycram.models.warming import notable
from recorder.packages import hint
from recorder.records.values import AssetFile

_DISTRIBUTION: Final = "example-robot-data"
_FLANGE: Final = "tool0"
#: Files of example-robot-data by the names that they have here.
_FILES: Final = {
    "pr2.urdf": "pr2_description/urdf/pr2.urdf",
    "tiago_pro.urdf": "tiago_pro_description/robots/tiago_pro.urdf",
    "panda.urdf": "panda_description/urdf/panda.urdf",
    "ur5.urdf": "ur_description/urdf/ur5_robot.urdf",
}

#: Names of the robots' URDFs, as objects are loaded by.
NAMES: Final = tuple(_FILES)


def robot_urdf(name: str, resources: Path) -> Path:
    """Return the path of a robot's URDF, from which its meshes are found.

    Args:
        name: one of :data:`NAMES`.
        resources: the folder with PyCRAM's own gripper.

    Raises:
        AssetError: example-robot-data isn't installed, or doesn't have it.
    """
    file = _installed(name)
    return _with_gripper(name, file, resources / "two_finger_gripper.urdf") if name == "ur5.urdf" else file


@cache
@notable
def _installed(name: str) -> Path:
    try:
        files = metadata.files(_DISTRIBUTION) or []
    except metadata.PackageNotFoundError as error:
        cause = f"comes with the package {_DISTRIBUTION}, which isn't installed; {hint('executor')}"
        raise AssetError(name, cause) from error
    for file in files:
        if file.name == Path(_FILES[name]).name and file.as_posix().endswith(f"robots/{_FILES[name]}"):
            return Path(str(file.locate())).resolve()
    raise AssetError(name, f"is not in the installed {_DISTRIBUTION}")


def _with_gripper(name: str, arm: Path, gripper: Path) -> Path:
    """Write the URDF of an arm with a gripper at its flange, z of which is x of the gripper; return its path."""
    robot, hand = (ET.fromstring(read_text(file)) for file in (arm, gripper))  # noqa: S314  installed files
    robot.set("name", f"{robot.get('name')}_with_gripper")
    for mesh in robot.iter("mesh"):  # it is moved away from the folders that its meshes are looked for in
        mesh.set("filename", os.fspath(packages.find_mesh(arm, mesh.get("filename", ""))))
    children = {child.get("link") for child in hand.iter("child")}
    (base,) = (link.get("name", "") for link in hand.findall("link") if link.get("name") not in children)
    robot.extend(hand)
    mount = ET.SubElement(robot, "joint", name="gripper_mount", type="fixed")
    ET.SubElement(mount, "parent", link=_FLANGE)
    ET.SubElement(mount, "child", link=base)
    ET.SubElement(mount, "origin", xyz="0 0 0", rpy="0 -1.5707963267948966 0")
    ET.indent(robot)
    content = ET.tostring(robot)
    return store.write(AssetFile(name, content, store.URDF_TYPE).key, content)
