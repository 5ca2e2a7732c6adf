"""Loading of models: from the file that a user names to a checked, canonical URDF for the engine and for recordings.

PyBullet refuses broken files without a reason, or loads them without a shape: every file is checked here first. A
canonical URDF refers to its meshes as ``<sha256>/<file name>``, their names in the store (:mod:`pycram.models.store`).
The same store can be built again from a recording's attachments on another machine.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.foundation.failures import AssetError, BadArgument
from pycram.models import links, mesh, robot_urdfs, store
from pycram.models.files import parse_urdf, read_text
from recorder.records.asset import AssetFile
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from recorder.geometry.urdf import Urdf

_MESH_SUFFIXES = (".stl", ".obj", ".dae")
_CACHED_MODELS: Final = 128


@dataclass(frozen=True, slots=True)
class Model:
    """A model, ready to load.

    Attributes:
        path: The canonical URDF in the store.
        urdf: Its tree of links and joints.
        files: All its files, the URDF first, which refers to the others by their keys.
    """

    path: Path
    urdf: Urdf
    files: tuple[AssetFile, ...]


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
        if given.name in robot_urdfs.NAMES:
            return robot_urdfs.robot_urdf(given.name, resources())
        shipped = resources() / given
        if shipped.is_file():
            return shipped
    known = sorted(file.name for kind in ("*.urdf", "*.stl") for file in resources().glob(kind))
    raise AssetError(path, f"no such file; PyCRAM's own are {', '.join([*robot_urdfs.NAMES, *known])}")


def load(path: str | Path, color: Sequence[float] | None = None) -> Model:
    """Check a model and make it canonical.

    Args:
        path: A .urdf, .stl, .obj or .dae file, as :func:`find` takes it.
        color: RGBA 0..1 for a mesh; None keeps the colours of the file.

    Raises:
        AssetError: The file or one of its meshes is missing, broken or of an unknown type.
    """
    file = find(path)
    kind = file.suffix.lower()
    with Uninterrupted():  # libraries that import each other lazily would swallow a Ctrl-C
        if kind == ".urdf":
            return _canonical(file, read_text(file), file.stem)
        if kind in _MESH_SUFFIXES:
            return _canonical(file, mesh.as_urdf(file, color, _decompose), file.stem)
    raise AssetError(path, f"{file.suffix or 'a file without suffix'} is not .urdf, .stl, .obj or .dae")


def restore(files: Iterable[tuple[str, bytes]]) -> Model:
    """Load a model from a recording's attachments as they are: they were canonical when recorded.

    Args:
        files: Attachment names (``<sha256>/<file name>``) and contents of the model's files, the URDF first.

    Raises:
        AssetError: A file's name isn't the hash of its content, or the URDF is broken.
    """
    assets = []
    for key, content in files:
        name = key.partition("/")[2]
        asset = AssetFile(name, content, store.URDF_TYPE if name.endswith(".urdf") else store.MESH_TYPE)
        if asset.key != key or Path(name).name != name:
            raise AssetError(key, "is not the file that its name says")
        store.write(key, content)
        assets.append(asset)
    tree = parse_urdf(assets[0].content, assets[0].key)
    path, _ = store.write_urdf(assets[0].name, assets[0].content)
    return Model(path, tree, tuple(assets))


def _decompose(content: bytes) -> bytes:
    from pycram.physics.engine import decompose  # noqa: PLC0415  the engine is needed for concave meshes only

    source = store.write(AssetFile("concave.obj", content).key, content)
    pieces = source.with_name("pieces.obj")
    if not pieces.exists():
        decompose(source, pieces)
    return pieces.read_bytes()


def _canonical(source: Path, text: str, stem: str) -> Model:
    return _cached_model(source, text, stem, tuple(_version(source, name) for name in _mesh_names(source, text)))


@lru_cache(maxsize=_CACHED_MODELS)
def _mesh_names(source: Path, text: str) -> tuple[str, ...]:
    """Check a URDF's links and return the file names of its meshes."""
    root = _parsed(source, text)
    _check_links(source, root)
    return tuple(dict.fromkeys(element.get("filename", "") for element in root.iter("mesh")))


def _parsed(source: Path, text: str) -> ET.Element:
    try:
        return ET.fromstring(text)  # noqa: S314  a model of the user's own, and expat limits entity expansion
    except ET.ParseError as error:
        raise AssetError(source, f"is not well-formed XML: {error}") from error


class _MeshVersion(NamedTuple):
    """A mesh as a URDF names it, its file, and what changes with the file's content."""

    name: str
    file: Path
    modified: int
    size: int


def _version(source: Path, name: str) -> _MeshVersion:
    found = _find_mesh(source, name)
    about = found.stat()
    return _MeshVersion(name, found, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=_CACHED_MODELS)
def _cached_model(source: Path, text: str, stem: str, versions: tuple[_MeshVersion, ...]) -> Model:
    """Return the model of a URDF with these versions of its meshes; most of a world's loading time would be this."""
    root = _parsed(source, text)
    meshes = {version.name: _checked_mesh(*version[1:]) for version in versions}
    for element in root.iter("mesh"):
        element.set("filename", meshes[element.get("filename", "")].key)
    for material in root.iter("material"):
        for texture in material.findall("texture"):
            material.remove(texture)  # the software renderer shows plain colours
    for link in root.iter("link"):
        links.give_inertia(link)
    _normalize_axes(root, parse_urdf(ET.tostring(root, encoding="unicode"), source))
    content = ET.tostring(root, encoding="unicode")
    tree = parse_urdf(content, source)
    path, asset = store.write_urdf(f"{stem}.urdf", content.encode())
    return Model(path, tree, (asset, *{mesh.key: mesh for mesh in meshes.values()}.values()))


def _check_links(source: Path, root: ET.Element) -> None:
    if root.tag != "robot":
        raise AssetError(source, f"its root element is <{root.tag}>, not <robot>")
    names = [link.get("name", "") for link in root.iter("link")]
    if not names:
        raise AssetError(source, "has no links")
    if not root.get("name", "").strip():
        raise AssetError(source, "its <robot> has no name")
    for link in root.iter("link"):
        links.check(source, link)


def _find_mesh(source: Path, name: str) -> Path:
    """Find a mesh as a URDF names it: absolute, relative, file:// or package:// (in all folders above the URDF)."""
    if not name:
        raise AssetError(source, "has a <mesh> without filename")
    relative = name.removeprefix("file://")
    if name.startswith("package://"):
        relative = name.removeprefix("package://")
        without_package = relative.partition("/")[2]
        candidates = (folder / part for folder in source.parents for part in (relative, without_package))
    else:
        candidates = (folder / relative for folder in (source.parent, store.folder()))
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise AssetError(source, f"its mesh {name} doesn't exist")


@cache
def _checked_mesh(file: Path, _modified: int, _size: int) -> AssetFile:
    """Write a mesh into the store as the engine reads it; checked once per version of the file."""
    return store.write_mesh(*mesh.convert(file))


def _normalize_axes(root: ET.Element, tree: Urdf) -> None:
    """Give axes unit length: PyBullet multiplies joint values by it, so that a drawer would open too far."""
    for joint in root.iter("joint"):
        axis = joint.find("axis")
        name = joint.get("name", "")
        if axis is not None and tree.joints[name].movable:
            axis.set("xyz", " ".join(map(repr, tree.joints[name].axis)))
