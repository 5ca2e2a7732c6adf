"""Models: from the file a user names to a checked, self-contained URDF that the engine loads and a log can carry.

PyBullet refuses broken files without saying why, or loads them without a shape. So every file is checked here first.
What it gets is canonical: a URDF whose meshes are named ``<sha256>/<file name>``, in a store that holds these files
under these names. The same store can be laid out again from a recording's attachments on another machine.

Axes get unit length: PyBullet takes a longer one for a longer way.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
import threading
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.foundation.failures import AssetError, BadArgument
from pycram.models import links, mesh
from recorder.geometry.joints import UrdfError
from recorder.geometry.urdf import Urdf
from recorder.records.asset import AssetFile
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_MESH_SUFFIXES = (".stl", ".obj", ".dae")
_MESH_TYPE, _URDF_TYPE = "model/mesh", "application/xml"
_MODELS_KEPT: Final = 128


@dataclass(frozen=True, slots=True)
class Model:
    """A body's description, ready to load.

    Attributes:
        path: the canonical URDF in the store.
        urdf: its tree of links and joints.
        files: everything that it consists of, the URDF first; it refers to the others by their keys.
    """

    path: Path
    urdf: Urdf
    files: tuple[AssetFile, ...]


@cache
def _store() -> Path:
    """The folder of canonical models; lives as long as the process."""
    folder = Path(tempfile.mkdtemp(prefix="pycram-models-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def resources() -> Path:
    """The folder with the kitchen, the floor and the household objects."""
    here = Path(__file__).parent.parent
    installed = here / "resources"
    return installed if installed.is_dir() else here.parent / "resources"


def find(path: str | Path) -> Path:
    """Finds a model's file.

    Args:
        path: a file; a bare name that isn't in the working directory is looked for among PyCRAM's resources, and
            ``pr2.urdf`` is the PR2 of example-robot-data.

    Returns:
        The file's absolute path.

    Raises:
        BadArgument: no path.
        AssetError: there is no such file.
    """
    if not isinstance(path, str | Path) or not str(path):
        raise BadArgument("path", path, "a file's path")
    given = Path(path).expanduser()
    if given.is_file():
        return given.resolve()
    if given.exists():
        raise AssetError(path, "is not a file")
    if given.name == str(path):
        if given.name == "pr2.urdf":
            from pycram.models.robots.urdf_files import pr2_urdf  # noqa: PLC0415  only for the robot

            return pr2_urdf()
        shipped = resources() / given
        if shipped.is_file():
            return shipped
    known = sorted(file.name for kind in ("*.urdf", "*.stl") for file in resources().glob(kind))
    raise AssetError(path, f"no such file; PyCRAM itself brings pr2.urdf, {', '.join(known)}")


def load(path: str | Path, color: Sequence[float] | None = None) -> Model:
    """Checks a model and makes it canonical.

    Args:
        path: a .urdf, .stl, .obj or .dae file, as :func:`find` takes it.
        color: RGBA 0..1 for a mesh; None leaves the colours of the file.

    Returns:
        The model.

    Raises:
        AssetError: the file is missing, broken or of an unknown type, or a mesh in it is.
    """
    file = find(path)
    kind = file.suffix.lower()
    with Uninterrupted():  # libraries that import each other lazily would swallow a Ctrl-C
        if kind == ".urdf":
            return _canonical(file, _read(file), file.stem)
        if kind in _MESH_SUFFIXES:
            return _canonical(file, mesh.as_urdf(file, color, _keep_mesh, _decompose), file.stem)
    raise AssetError(path, f"{file.suffix or 'a file without suffix'} is not .urdf, .stl, .obj or .dae")


def restore(files: Iterable[tuple[str, bytes]]) -> Model:
    """Lays out a recording's attachments and loads a model from them, as they are: they were canonical when recorded.

    Args:
        files: attachment names (``<sha256>/<file name>``) and contents of the model's files, the URDF first.

    Returns:
        The model.

    Raises:
        AssetError: a file isn't what its name says, or the URDF is broken.
    """
    kept = []
    for key, content in files:
        name = key.partition("/")[2]
        asset = AssetFile(name, content, _URDF_TYPE if name.endswith(".urdf") else _MESH_TYPE)
        if asset.key != key or Path(name).name != name:
            raise AssetError(key, "is not the file that its name says")
        _keep(key, content)
        kept.append(asset)
    itself = kept[0]
    try:
        tree = Urdf.parse(itself.content)
    except UrdfError as error:
        raise AssetError(itself.key, str(error)) from error
    return Model(_keep(f"{itself.sha256}.urdf", itself.content), tree, tuple(kept))


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(file, f"can't be read: {error}") from error


def _keep(name: str, content: bytes) -> Path:
    """Writes a file into the store: whole or not at all, whoever else writes it."""
    target = _store() / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{threading.get_ident()}")
        partial.write_bytes(content)
        partial.replace(target)
    return target


def _keep_mesh(name: str, content: bytes) -> str:
    asset = AssetFile(name, content, _MESH_TYPE)
    _keep(asset.key, content)
    return asset.key


def _decompose(content: bytes) -> bytes:
    from pycram.physics.engine import decompose  # noqa: PLC0415  the engine is needed for concave meshes only

    asset = AssetFile("concave.obj", content)
    source = _keep(asset.key, content)
    pieces = source.with_name("pieces.obj")
    if not pieces.exists():
        decompose(source, pieces)
    return pieces.read_bytes()


def _canonical(source: Path, text: str, stem: str) -> Model:
    return _made(source, text, stem, tuple(_version(source, name) for name in _mesh_names(source, text)))


@lru_cache(maxsize=_MODELS_KEPT)
def _mesh_names(source: Path, text: str) -> tuple[str, ...]:
    """The meshes that a URDF whose links make sense refers to."""
    root = _parsed(source, text)
    _check_links(source, root)
    return tuple(dict.fromkeys(element.get("filename", "") for element in root.iter("mesh")))


def _parsed(source: Path, text: str) -> ET.Element:
    try:
        return ET.fromstring(text)  # noqa: S314  a model of the user's own, and expat limits entity expansion
    except ET.ParseError as error:
        raise AssetError(source, f"is not well-formed XML: {error}") from error


class _Version(NamedTuple):
    """A mesh's file as a URDF names it, and what changes when the file does."""

    name: str
    file: Path
    modified: int
    size: int


def _version(source: Path, name: str) -> _Version:
    found = _find_mesh(source, name)
    about = found.stat()
    return _Version(name, found, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=_MODELS_KEPT)
def _made(source: Path, text: str, stem: str, versions: tuple[_Version, ...]) -> Model:
    """The model of a URDF with these meshes; made once, since most of a world's loading would be this."""
    root = _parsed(source, text)
    meshes = {version.name: _checked_mesh(*version[1:]) for version in versions}
    for element in root.iter("mesh"):
        element.set("filename", meshes[element.get("filename", "")].key)
    for material in root.iter("material"):
        for texture in material.findall("texture"):
            material.remove(texture)  # the software renderer shows plain colours
    for link in root.iter("link"):
        links.give_inertia(link)
    try:
        _normalize_axes(root, Urdf.parse(ET.tostring(root, encoding="unicode")))
        content = ET.tostring(root, encoding="unicode")
        tree = Urdf.parse(content)
    except UrdfError as error:
        raise AssetError(source, str(error)) from error
    itself = AssetFile(f"{stem}.urdf", content.encode(), _URDF_TYPE)
    # PyBullet looks for meshes from the URDF's folder: URDFs lie flat in the store, beside the folders of the meshes.
    path = _keep(f"{itself.sha256}.urdf", itself.content)
    return Model(path, tree, (itself, *{mesh.key: mesh for mesh in meshes.values()}.values()))


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
    """A mesh as a URDF names it: absolute, relative, file:// or package:// (looked for upwards)."""
    if not name:
        raise AssetError(source, "has a <mesh> without filename")
    relative = name.removeprefix("file://")
    if name.startswith("package://"):
        relative = name.removeprefix("package://")
        without_package = relative.partition("/")[2]
        candidates = (folder / part for folder in source.parents for part in (relative, without_package))
    else:
        candidates = (folder / relative for folder in (source.parent, _store()))
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise AssetError(source, f"its mesh {name} doesn't exist")


@cache
def _checked_mesh(file: Path, _modified: int, _size: int) -> AssetFile:
    """A mesh in the store, in a form that the engine really reads; checked once per version of the file."""
    asset = AssetFile(*mesh.checked(file), _MESH_TYPE)
    _keep(asset.key, asset.content)
    return asset


def _normalize_axes(root: ET.Element, tree: Urdf) -> None:
    """Axes get unit length, in which the engine would otherwise measure: a drawer would open too far or not enough."""
    for joint in root.iter("joint"):
        axis = joint.find("axis")
        name = joint.get("name", "")
        if axis is not None and tree.joints[name].movable:
            axis.set("xyz", " ".join(map(repr, tree.joints[name].axis)))
