"""Files of models: where they are, and their text. An invalid one raises an AssetError that names it.

Models are found among PyCRAM's resources and the robots of example-robot-data. Meshes are where their URDF says:
relative to it, absolute, ``file://``, or in a ROS package, ``package://NAME/PATH``. A package is a folder of its name,
or one with a ``package.xml`` that says so. It is looked for, in this order:

1. in the folders that a caller gives, and below them;
2. in those of the environment variable ``PYCRAM_PACKAGES``, and below them;
3. in all folders above the URDF;
4. in those of ``ROS_PACKAGE_PATH``, and below them, as ROS does;
5. last, its path alone in the folders above the URDF that aren't other packages: a package may lie in a folder of
   another name.
"""

from __future__ import annotations

import os
import re
import tomllib
import xml.etree.ElementTree as ET
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import AssetError, BadArgument
from pycram.models import store
from pycram.models.warming import notable
from recorder.packages import hint
from recorder.records.values import AssetFile
from recorder.urdf import Urdf, UrdfError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_PACKAGE: Final = "package://"
_VARIABLE: Final = "PYCRAM_PACKAGES"
_ROS_VARIABLE: Final = "ROS_PACKAGE_PATH"
_NAME: Final = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_MANIFEST: Final = "package.xml"
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
ROBOT_URDFS: Final = tuple(_FILES)


def read_bytes(file: Path) -> bytes:
    """Return the content of a file.

    Raises:
        AssetError: It can't be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise AssetError(file, f"can't be read: {error}") from error


def read_text(file: Path) -> str:
    """Return the content of a UTF-8 file.

    Raises:
        AssetError: It can't be read.
    """
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(file, f"can't be read: {error}") from error


def parse_toml(text: str, source: str | Path) -> dict[str, object]:
    """Return the tables of a TOML document; errors name its source.

    Raises:
        AssetError: It isn't TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise AssetError(source, f"is not TOML: {error}") from error


def parse_urdf(text: str | bytes, source: str | Path, *, chains: bool = False) -> Urdf:
    """Return the tree of links and joints of a URDF; errors name its source.

    Args:
        text: The document.
        source: Its file.
        chains: Whether its planar and floating joints are yet to be made chains of others.

    Raises:
        AssetError: It isn't a URDF, or not one tree, or a joint mimics itself.
    """
    try:
        tree = Urdf.parse(text, chains=chains)
        tree.mimics  # noqa: B018  computed once, when first asked for
    except UrdfError as error:
        raise AssetError(source, str(error)) from error
    return tree


def resources() -> Path:
    """Return the folder with the kitchen, the floor and the household objects."""
    here = Path(__file__).parent.parent
    installed = here / "resources"
    return installed if installed.is_dir() else here.parent / "resources"


def find(path: str | Path) -> Path:
    """Return the absolute path of a model's file.

    Args:
        path: A file; a bare name that isn't in the working directory is looked for among PyCRAM's resources, and
            ``pr2.urdf``, ``tiago_pro.urdf``, ``panda.urdf`` and ``ur5.urdf`` are robots of example-robot-data.

    Raises:
        BadArgument: It isn't a path.
        AssetError: There is no such file.
    """
    if not isinstance(path, str | Path) or not str(path):
        raise BadArgument("path", path, "a file's path")
    given = Path(path).expanduser()
    if given.is_file():
        return given.resolve()
    if given.exists():
        raise AssetError(path, "is not a file")
    if given.name == str(path):
        if given.name in ROBOT_URDFS:
            return _robot_urdf(given.name)
        shipped = resources() / given
        if shipped.is_file():
            return shipped
    known = sorted(file.name for kind in ("*.urdf", "*.stl") for file in resources().glob(kind))
    raise AssetError(path, f"no such file; PyCRAM's own are {', '.join([*ROBOT_URDFS, *known])}")


def _robot_urdf(name: str) -> Path:
    """Return the path of a robot's URDF, from which its meshes are found; the UR5 gets PyCRAM's own gripper.

    Raises:
        AssetError: example-robot-data isn't installed, or doesn't have it.
    """
    file = _installed(name)
    return _with_gripper(name, file, resources() / "two_finger_gripper.urdf") if name == "ur5.urdf" else file


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
        mesh.set("filename", os.fspath(find_mesh(arm, mesh.get("filename", ""))))
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


def check_packages(packages: Sequence[str | Path]) -> tuple[Path, ...]:
    """Return a caller's folders of packages.

    Raises:
        BadArgument: It isn't a list of existing folders.
    """
    expected = "a list of folders that exist"
    if isinstance(packages, str | bytes) or not all(isinstance(folder, str | Path) for folder in packages):
        raise BadArgument("packages", packages, expected)
    folders = tuple(Path(folder).expanduser().resolve() for folder in packages)
    if not all(folder.is_dir() for folder in folders):
        raise BadArgument("packages", packages, expected)
    return folders


def find_mesh(source: Path, name: str, packages: Sequence[Path] = ()) -> Path:
    """Return the file of a mesh or texture as a URDF names it.

    Args:
        source: The URDF.
        name: As it is written there.
        packages: Folders to look for packages in before all others.

    Raises:
        AssetError: There is none; it says where it was looked for.
    """
    if not name:
        raise AssetError(source, "has a <mesh> without filename")
    if name.startswith(_PACKAGE):
        return _in_package(source, name, packages)
    relative = name.removeprefix("file://")
    for folder in (source.parent, store.folder()):
        if (folder / relative).is_file():
            return folder / relative
    raise AssetError(source, f"its mesh {name} doesn't exist")


def _in_package(source: Path, name: str, packages: Sequence[Path]) -> Path:
    package, _, path = name.removeprefix(_PACKAGE).partition("/")
    found = None
    for folder in _candidates(source, package, packages):
        if (folder / path).is_file():
            return folder / path
        if found is None and (folder.name == package or _is(folder, package)) and folder.is_dir():
            found = folder
    if found is not None:
        raise AssetError(source, f"its mesh {name} doesn't exist: the package is {found}, which has no {path}")
    ways = f"Object(..., packages=[FOLDER]), or the environment's {_VARIABLE} or {_ROS_VARIABLE}"
    raise AssetError(
        source, f"its mesh {name} doesn't exist: no package {package!r} is known; name its folder by {ways}"
    )


def _candidates(source: Path, package: str, packages: Sequence[Path]) -> Iterator[Path]:
    """Yield folders that may be a package, likely ones first: only who asks on has folders searched."""
    for root in (*packages, *_variable(_VARIABLE)):
        yield from _below(root, package)
    for folder in source.parents:
        yield folder / package
        if folder.name == package or _is(folder, package):
            yield folder
    for root in _variable(_ROS_VARIABLE):
        yield from _below(root, package)
    yield from (folder for folder in source.parents if not (folder / _MANIFEST).is_file())


def _variable(name: str) -> list[Path]:
    return [Path(folder).expanduser() for folder in os.environ.get(name, "").split(os.pathsep) if folder]


def _below(root: Path, package: str) -> Iterator[Path]:
    if root.name == package:
        yield root
    yield root / package
    for folder, inside, files in os.walk(root):
        if _MANIFEST in files:
            if _is(Path(folder), package):
                yield Path(folder)
            inside.clear()  # packages don't contain others
        else:
            inside[:] = sorted(name for name in inside if not name.startswith("."))
            if package in inside:
                yield Path(folder, package)


def _is(folder: Path, package: str) -> bool:
    """Whether a folder's manifest has the package's name."""
    try:
        found = _NAME.search((folder / _MANIFEST).read_bytes())
    except OSError:
        return False
    return found is not None and found[1].decode("utf-8", "replace") == package
