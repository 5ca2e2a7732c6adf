"""Finding and reading the files of models. An AssetError names a missing or invalid file.

Models come from PyCRAM's resources, example-robot-data and the user. A URDF names a mesh by a relative path, an
absolute path, ``file://`` or a path in a ROS package, ``package://NAME/PATH``. A package is a folder with that name, or
a folder whose ``package.xml`` contains that name; ``docs/guides/models.md`` describes the order of the search.
"""

from __future__ import annotations

import os
import re
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Final

from pycram.foundation.failures import AssetError, BadArgument
from pycram.models import store
from recorder.errors import similar_files
from recorder.packages import hint
from recorder.records.values import AssetFile
from recorder.urdf import Urdf, UrdfError

_PACKAGE: Final = "package://"
_VARIABLE: Final = "PYCRAM_PACKAGES"
_ROS_VARIABLE: Final = "ROS_PACKAGE_PATH"
_NAME: Final = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_MANIFEST: Final = "package.xml"
_DISTRIBUTION: Final = "example-robot-data"
_FLANGE: Final = "tool0"
_FILES: Final = {  # paths in example-robot-data
    "pr2.urdf": "pr2_description/urdf/pr2.urdf",
    "tiago_pro.urdf": "tiago_pro_description/robots/tiago_pro.urdf",
    "panda.urdf": "panda_description/urdf/panda.urdf",
    "ur5.urdf": "ur_description/urdf/ur5_robot.urdf",
}
ROBOT_URDFS: Final = tuple(_FILES)  # file names of the bundled robots


def read_bytes(file: Path) -> bytes:
    """Return the content of a file; raise an AssetError if the file can't be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise AssetError(file, f"the file can't be read: {error.strerror}") from error


def read_text(file: Path) -> str:
    """Return the content of a UTF-8 file; raise an AssetError if the file can't be read."""
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(file, f"the file can't be read: {error}") from error


def parse_toml(text: str, source: str | Path) -> dict[str, object]:
    """Return the tables of a TOML document; raise an AssetError for other texts."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise AssetError(source, f"the file is not TOML: {error}") from error


def parse_urdf(text: str | bytes, source: str | Path, *, chains: bool = False) -> Urdf:
    """Return the tree of links and joints of a URDF.

    If ``chains`` is true, the URDF may have planar and floating joints, which the caller will replace. AssetError is
    raised if the text isn't a URDF, its links aren't one tree, or a joint copies its own position.
    """
    try:
        tree = Urdf.parse(text, chains=chains)
        tree.mimics  # noqa: B018  the first reading has checked the value
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
        path: A file. A bare name that isn't in the working directory is a file of PyCRAM's resources, or a robot of
            example-robot-data: ``pr2.urdf``, ``tiago_pro.urdf``, ``panda.urdf`` or ``ur5.urdf``.

    Raises:
        BadArgument: The argument isn't a path.
        AssetError: The file doesn't exist.
    """
    if not isinstance(path, str | Path) or not str(path):
        raise BadArgument("path", path, "a file's path")
    given = Path(path).expanduser()
    if given.is_file():
        return given.resolve()
    if given.exists():
        raise AssetError(path, "the path is not a file")
    if given.name == str(path):
        if given.name in ROBOT_URDFS:
            file = _installed(given.name)  # the meshes are next to the file
            return _with_gripper(given.name, file) if given.name == "ur5.urdf" else file
        shipped = resources() / given
        if shipped.is_file():
            return shipped
    known = [*ROBOT_URDFS, *sorted(file.name for kind in ("*.urdf", "*.stl") for file in resources().glob(kind))]
    near = similar_files(given, known)
    raise AssetError(path, "no such file" + (near or f"; PyCRAM's files are {', '.join(known)}"))


@cache
def _installed(name: str) -> Path:
    from importlib import metadata  # noqa: PLC0415  slow to import

    try:
        files = metadata.files(_DISTRIBUTION) or []
    except metadata.PackageNotFoundError as error:
        cause = f"the robot comes with the package {_DISTRIBUTION}, which isn't installed; {hint('executor')}"
        raise AssetError(name, cause) from error
    for file in files:
        if file.name == Path(_FILES[name]).name and file.as_posix().endswith(f"robots/{_FILES[name]}"):
            return Path(str(file.locate())).resolve()
    raise AssetError(name, f"the robot is not in the installed {_DISTRIBUTION}")


def _with_gripper(name: str, arm: Path) -> Path:
    """Store the URDF of an arm with PyCRAM's gripper, whose x axis is the z axis of the flange; return the file."""
    robot = ET.fromstring(read_text(arm))  # noqa: S314  an installed file
    robot.set("name", f"{robot.get('name')}_with_gripper")
    mount_gripper(robot, _FLANGE, "0 0 0", "0 -1.5707963267948966 0")
    content = with_absolute_meshes(robot, arm)
    return store.write(AssetFile(name, content, store.URDF_TYPE).key, content)


def mount_gripper(robot: ET.Element, link: str, xyz: str, rpy: str, prefix: str = "") -> None:
    """Add PyCRAM's two-finger gripper to a link of a robot's URDF; x of the gripper points away from the link.

    ``xyz`` (m) and ``rpy`` (rad) are the pose of the gripper in the link. ``prefix`` is the prefix of the names of the
    gripper's links and joints.
    """
    text = read_text(resources() / "two_finger_gripper.urdf").replace('"gripper_', f'"{prefix}gripper_')
    hand = ET.fromstring(text)  # noqa: S314  an installed file
    children = {child.get("link") for child in hand.iter("child")}
    (base,) = (link.get("name", "") for link in hand.findall("link") if link.get("name") not in children)
    known = {material.get("name") for material in robot.findall("material")}  # the engine warns of duplicates
    robot.extend([part for part in hand if part.tag != "material" or part.get("name") not in known])
    mount = ET.SubElement(robot, "joint", name=f"{prefix}gripper_mount", type="fixed")
    ET.SubElement(mount, "parent", link=link)
    ET.SubElement(mount, "child", link=base)
    ET.SubElement(mount, "origin", xyz=xyz, rpy=rpy)


def with_absolute_meshes(robot: ET.Element, source: Path) -> bytes:
    """Return the text of a URDF with absolute names of meshes, which are valid outside of the folder of ``source``."""
    for mesh in robot.iter("mesh"):
        mesh.set("filename", os.fspath(find_mesh(source, mesh.get("filename", ""))))
    ET.indent(robot)
    return ET.tostring(robot)


def check_packages(packages: Sequence[str | Path]) -> tuple[Path, ...]:
    """Return package folders as absolute paths; raise BadArgument for anything but a list of folders."""
    expected = "a list of folders that exist"
    if isinstance(packages, str | bytes) or not all(isinstance(folder, str | Path) for folder in packages):
        raise BadArgument("packages", packages, expected)
    folders = tuple(Path(folder).expanduser().resolve() for folder in packages)
    if not all(folder.is_dir() for folder in folders):
        raise BadArgument("packages", packages, expected)
    return folders


def find_mesh(source: Path, name: str, packages: Sequence[Path] = ()) -> Path:
    """Return the file of a mesh or texture; raise an AssetError if the file doesn't exist."""
    if not name:
        raise AssetError(source, "the URDF has a <mesh> without filename")
    if name.startswith(_PACKAGE):
        package, _, path = name.removeprefix(_PACKAGE).partition("/")
        found = None
        for folder in _candidates(source, package, packages):
            if (folder / path).is_file():
                return folder / path
            if found is None and (folder.name == package or _is_package(folder, package)) and folder.is_dir():
                found = folder
        if found is not None:
            raise AssetError(source, f"the mesh {name} doesn't exist: the package is {found}, which has no {path}")
        raise AssetError(source, f"the mesh {name} doesn't exist: {_unknown(package)}")
    relative = name.removeprefix("file://")
    for folder in (source.parent, store.folder()):
        if (folder / relative).is_file():
            return folder / relative
    raise AssetError(source, f"the mesh {name} doesn't exist")


def _unknown(package: str) -> str:
    ways = f"Object(..., packages=[FOLDER]), or in the environment variable {_VARIABLE} or {_ROS_VARIABLE}"
    return f"no package {package!r} is known; give its folder in {ways}"


def find_package(source: Path, package: str, packages: Sequence[Path] = ()) -> Path:
    """Return the folder of a package that a file names; raise an AssetError for an unknown package."""
    for folder in _candidates(source, package, packages):
        if (folder.name == package or _is_package(folder, package)) and folder.is_dir():
            return folder
    raise AssetError(source, _unknown(package))


def _candidates(source: Path, package: str, packages: Sequence[Path]) -> Iterator[Path]:
    """Yield folders that may be a package, likely folders first. The generator reads folders on demand."""
    for root in (*packages, *_variable(_VARIABLE)):
        yield from _below(root, package)
    for folder in source.parents:
        yield folder / package
        if folder.name == package or _is_package(folder, package):
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
            if _is_package(Path(folder), package):
                yield Path(folder)
            inside.clear()  # packages don't contain packages
        else:
            inside[:] = sorted(name for name in inside if not name.startswith("."))
            if package in inside:
                yield Path(folder, package)


def _is_package(folder: Path, package: str) -> bool:
    try:
        found = _NAME.search((folder / _MANIFEST).read_bytes())
    except OSError:
        return False
    return found is not None and found[1].decode("utf-8", "replace") == package


_LOCK: Final = Lock()  # xacro keeps the state of an expansion in its modules
XACRO: Final = ".xacro"  # suffix of files with macros


def expanded(source: Path, content: bytes, packages: Sequence[Path] = ()) -> bytes:
    """Return the text of a URDF, with its macros expanded; raise an AssetError if xacro is missing, or fails."""
    if source.suffix.lower() != XACRO and b"<xacro:" not in content:
        return content
    target = source.name.removesuffix(XACRO).removesuffix(".urdf") + ".urdf"
    command = f"xacro {source.name} > {target if target != source.name else f'expanded_{target}'}"
    try:
        import xacro  # noqa: PLC0415  only few models need xacro
        from xacro import substitution_args  # noqa: PLC0415
    except ModuleNotFoundError as error:
        cause = f"the file is xacro; make a URDF first: {command}, or install xacro, {hint('xacro')}"
        raise AssetError(source, cause) from error

    def find(package: str) -> str:
        return str(find_package(source, package, packages))

    with _LOCK:
        try:
            substitution_args._eval_find = substitution_args._eval_dict["find"] = find  # noqa: SLF001  no public way
            text: bytes = xacro.process_file(str(source)).toxml(encoding="utf-8")
        except AssetError:
            raise
        except Exception as error:  # macros can run Python expressions
            cause = f"xacro can't expand the file ({error}); give its arguments to the command: {command}"
            raise AssetError(source, cause) from error
    return text
