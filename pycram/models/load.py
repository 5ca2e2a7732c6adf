"""Loading of models: from the file that a user names to a checked, canonical URDF for the engine and for recordings.

PyBullet refuses broken files without a reason, or loads them without a shape: every file is checked here first. A
canonical URDF refers to its meshes as ``<sha256>/<file name>``, their names in the store (:mod:`pycram.models.store`).
The same store can be built again from a recording's attachments on another machine (:mod:`pycram.models.recorded`).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.foundation.failures import AssetError, BadArgument
from pycram.models import (
    canonical_urdf,
    conversion_cache,
    corrections,
    mesh,
    packages as packages_of,
    robot_urdfs,
    store,
    textured_shapes,
)
from pycram.models.files import read_bytes, read_text
from pycram.models.texture import warn_of_missing
from pycram.models.visual import piece_bounds
from pycram.models.warming import notable
from pycram.physics.loading import NOW, Loading
from recorder.records.values import AssetFile
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.urdf import Urdf

_MESH_SUFFIXES = (".stl", ".obj", ".dae")
_CACHED_MODELS: Final = 128
_SIZES: Final = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}  # that take a texture


@dataclass(frozen=True, slots=True)
class Model:
    """A model, ready to load.

    Attributes:
        path: The canonical URDF in the store.
        urdf: Its tree of links and joints.
        files: All its files, the URDF first, which refers to the others by their keys; but for corrections of what is
            found in it (:mod:`pycram.models.corrections`).
        loading: How the engine makes a body of it.
    """

    path: Path
    urdf: Urdf
    files: tuple[AssetFile, ...]
    loading: Loading = NOW


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


def load(path: str | Path, color: Sequence[float] | None = None, packages: Sequence[str | Path] = ()) -> Model:
    """Check a model and make it canonical.

    Args:
        path: A .urdf, .stl, .obj or .dae file, as :func:`find` takes it.
        color: RGBA 0..1 for a mesh; None keeps the colours of the file.
        packages: Folders of ROS packages that a URDF names, or folders in which these are; see
            :mod:`pycram.models.packages`.

    Raises:
        BadArgument: A folder of packages doesn't exist.
        AssetError: The file or one of its meshes is missing, broken or of an unknown type.
    """
    file = find(path)
    kind = file.suffix.lower()
    with Uninterrupted():  # libraries that import each other lazily would swallow a Ctrl-C
        if kind == ".urdf":
            return _corrected(file, _canonical(file, read_bytes(file), file.stem, packages_of.check_folders(packages)))
        if kind in _MESH_SUFFIXES:
            return _canonical(file, _object_urdf(file, color), file.stem)
    if kind == ".xacro":
        canonical_urdf.read(file, read_bytes(file))
    raise AssetError(path, f"{file.suffix or 'a file without suffix'} is not .urdf, .stl, .obj or .dae")


def _corrected(file: Path, model: Model) -> Model:
    """Return a model with the corrections of its furniture that lie beside its file, if there are any."""
    beside = file.with_name(f"{file.stem}{corrections.SUFFIX}")
    if not beside.exists():
        return model
    text = read_text(beside)
    corrections.check(corrections.read(text, beside), model.urdf)
    return replace(model, files=(*model.files, corrections.asset(beside.name, text.encode())))


def _object_urdf(file: Path, color: Sequence[float] | None) -> bytes:
    """Return the URDF of an object that is one mesh, and write its meshes into the store."""
    kind = f"object {None if color is None else [float(part) for part in color]}"
    files = conversion_cache.get(kind, file, lambda: [*mesh.as_urdf(file, color, _decompose)], mesh.beside(file))
    *meshes, (_, urdf, _) = files
    for name, content, _ in meshes:
        store.write_mesh(name, content)
    return urdf


def _decompose(content: bytes) -> bytes:
    from pycram.physics.engine import decompose  # noqa: PLC0415  the engine is needed for concave meshes only

    source = store.write(AssetFile("concave.obj", content).key, content)
    pieces = source.with_name("pieces.obj")
    if not pieces.exists():
        decompose(source, pieces)
    return pieces.read_bytes()


def _canonical(source: Path, content: bytes, stem: str, packages: tuple[Path, ...] = ()) -> Model:
    meshes, textures = _file_names(source, content)
    found = {name: packages_of.find_mesh(source, name, packages) for name in meshes}
    for name in textures:
        try:
            found[name] = packages_of.find_mesh(source, name, packages)
        except AssetError:
            warn_of_missing(source, name)
    versions = tuple(
        (name, _FileVersion(file, of.st_mtime_ns, of.st_size)) for name, file in found.items() if (of := file.stat())
    )
    return _cached_model(source, content, stem, versions)


@lru_cache(maxsize=_CACHED_MODELS)
@notable
def _file_names(source: Path, content: bytes) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Check a URDF's links and return the file names of its meshes, and those of its textures."""
    root = canonical_urdf.read(source, content)
    meshes, textures = (
        dict.fromkeys(element.get("filename", "") for element in root.iter(tag)) for tag in ("mesh", "texture")
    )
    textures.pop("", None)  # some exporters write one without a name
    return tuple(meshes), tuple(textures)


class _FileVersion(NamedTuple):
    """A file, and what changes with its content."""

    file: Path
    modified: int
    size: int


@lru_cache(maxsize=_CACHED_MODELS)
@notable
def _cached_model(source: Path, content: bytes, stem: str, versions: tuple[tuple[str, _FileVersion], ...]) -> Model:
    """Return the model of a URDF with these versions of its files; most of a world's loading time would be this."""
    root = canonical_urdf.read(source, content)
    files = dict(versions)
    used: dict[str, AssetFile] = {}
    named = {material.get("name"): material for material in root.findall("material")}
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            for element in collision.iter("mesh"):
                asset = _collision_mesh(files[element.get("filename", "")])
                element.set("filename", used.setdefault(asset.key, asset).key)
        for visual in link.findall("visual"):
            shown = visual.find("geometry/mesh")
            picture = _texture(visual, named, files)
            if shown is not None:
                _color(link, visual, shown, _visual_meshes(files[shown.get("filename", "")], picture), used)
            elif picture is not None:
                _cover(link, visual, picture, used)
    for material in root.iter("material"):
        for texture in material.findall("texture"):
            material.remove(texture)  # it is in the shapes' colours
    text, tree = canonical_urdf.write(source, root)
    path, asset = store.write_urdf(f"{stem}.urdf", text, root)
    piece_bounds(path)  # what queries ask for first: now nobody waits for the answer
    return Model(path, tree, (asset, *used.values()))


def _texture(
    visual: ET.Element, named: Mapping[str | None, ET.Element], files: Mapping[str, _FileVersion]
) -> _FileVersion | None:
    """Return the texture of a visual's material, given there or by name; None if it has none, or that isn't there."""
    material = visual.find("material")
    if material is not None and len(material) == 0:
        material = named.get(material.get("name"))
    texture = None if material is None else material.find("texture")
    return None if texture is None else files.get(texture.get("filename", ""))


def _cover(link: ET.Element, visual: ET.Element, picture: _FileVersion, used: dict[str, AssetFile]) -> None:
    """Put meshes in the place of a shape that is covered with a texture."""
    geometry = visual.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if geometry is None or shape is None or shape.tag not in _SIZES:
        return
    size = tuple(float(value) for key in _SIZES[shape.tag] for value in shape.get(key, "").split())
    parts = _covered(shape.tag, size, picture)
    if parts:
        geometry.remove(shape)
        _color(link, visual, ET.SubElement(geometry, "mesh"), parts, used)


def _color(
    link: ET.Element, visual: ET.Element, shown: ET.Element, parts: Sequence[_Painted], used: dict[str, AssetFile]
) -> None:
    """Put a visual for each colour of a mesh in its place: the mesh's own colours win over the URDF's, as in RViz."""
    place = list(link).index(visual)
    link.remove(visual)
    for number, (asset, rgba) in enumerate(parts):
        shown.set("filename", used.setdefault(asset.key, asset).key)
        part = deepcopy(visual)
        if rgba is not None:
            for material in part.findall("material"):
                part.remove(material)
            material = ET.SubElement(part, "material", name=f"{asset.name} {asset.sha256[:8]}")
            ET.SubElement(material, "color", rgba=" ".join(f"{value:.6g}" for value in rgba))
        link.insert(place + number, part)


class _Painted(NamedTuple):
    """A mesh in the store, and its colour RGBA 0..1 if it has one."""

    asset: AssetFile
    rgba: Sequence[float] | None


@cache
@notable
def _collision_mesh(version: _FileVersion) -> AssetFile:
    """Write a mesh into the store as the engine reads it; checked once per version of the file."""
    file = version.file
    ((name, content, _),) = conversion_cache.get("collision", file, lambda: [(*mesh.convert_collision(file), None)])
    return store.write_mesh(name, content)


@cache
@notable
def _visual_meshes(version: _FileVersion, picture: _FileVersion | None) -> tuple[_Painted, ...]:
    """Write what is seen of a mesh into the store, by colour; checked once per version of the files."""
    file, cover = version.file, None if picture is None else read_bytes(picture.file)
    kind = "visual" if cover is None else f"visual {sha256(cover).hexdigest()}"
    parts = conversion_cache.get(kind, file, lambda: mesh.convert_visual(file, cover))
    return tuple(_Painted(store.write_mesh(name, content), rgba) for name, content, rgba in parts)


@cache
def _covered(kind: str, size: tuple[float, ...], picture: _FileVersion) -> tuple[_Painted, ...]:
    """Write what is seen of a shape with a texture into the store, by colour."""
    parts = textured_shapes.cover(kind, size, picture.file)
    return tuple(_Painted(store.write_mesh(name, content), rgba) for name, content, rgba in parts)
