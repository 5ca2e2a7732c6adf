"""Loading of models: from a file that a user names, or a recording's attachments, to a checked, canonical URDF.

PyBullet refuses broken files without a reason, loads them without a shape, or ends the process over a mesh that makes
no sense. So every file is checked here first, those of a recording too: a stranger may have written it. A canonical
URDF refers to its meshes as ``<sha256>/<file name>``, their names in the store (:mod:`pycram.models.store`).
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.foundation.failures import AssetError
from pycram.models import canonical_urdf, conversion_cache, corrections, mesh, object_urdf, store
from pycram.models.files import check_packages, find, find_mesh, parse_urdf, read_bytes, read_text
from pycram.models.shapes import piece_bounds
from pycram.models.texture import cover_shape, warn_of_missing
from pycram.models.warming import notable
from pycram.physics.loading import NOW, Loading
from recorder.records.values import AssetFile
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from recorder.urdf import Urdf

_MESH_SUFFIXES = (".stl", ".obj", ".dae")
_CACHED_MODELS: Final = 128
_SIZES: Final = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}  # that take a texture
_CACHED_MESHES: Final = 1024
_START: Final = b"<robot "  # of canonical text: no declarations, no entities, no other encoding
_MATERIALS: Final = re.compile(rb"^[ \t]*(?:mtllib|usemtl)\b", re.MULTILINE)
_MAX_NAME: Final = 230  # bytes of a file's name; file systems take 255, and one is written under a longer name first
_MAX_LINE: Final = 8000  # bytes of a line of a URDF: PyBullet breaks longer ones, where it reads something else then
_ESCAPE: Final = re.compile(r"\\udc[89a-f][0-9a-f]")  # of a byte that isn't UTF-8, as recorders write it
_RESERVED: Final = ("", ".", "..")


@dataclass(frozen=True, slots=True)
class Model:
    """A model, ready to load."""

    path: Path  # The canonical URDF in the store
    urdf: Urdf  # Its tree of links and joints
    files: tuple[AssetFile, ...]
    """All its files, the URDF first, which refers to the others by their keys; but for corrections of what is found in
    it (:mod:`pycram.models.corrections`)."""
    loading: Loading = NOW  # How the engine makes a body of it


def load(path: str | Path, color: Sequence[float] | None = None, packages: Sequence[str | Path] = ()) -> Model:
    """Check a model and make it canonical.

    Args:
        path: A .urdf, .stl, .obj or .dae file, as :func:`find` takes it.
        color: RGBA 0..1 for a mesh; None keeps the colours of the file.
        packages: Folders of ROS packages that a URDF names, or folders in which these are; see
            :mod:`pycram.models.files`.

    Raises:
        BadArgument: A folder of packages doesn't exist.
        AssetError: The file or one of its meshes is missing, broken or of an unknown type.
    """
    file = find(path)
    kind = file.suffix.lower()
    with Uninterrupted():  # libraries that import each other lazily would swallow a Ctrl-C
        if kind == ".urdf":
            return _corrected(file, _canonical(file, read_bytes(file), file.stem, check_packages(packages)))
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
    files = conversion_cache.get(
        kind, file, lambda: [*object_urdf.as_urdf(file, color, _decompose)], object_urdf.beside(file)
    )
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
    found = {name: find_mesh(source, name, packages) for name in meshes}
    for name in textures:
        try:
            found[name] = find_mesh(source, name, packages)
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
    name = f"{picture.file.stem}-{kind}"
    parts = enumerate(cover_shape(kind, size, picture.file))
    return tuple(_Painted(store.write_mesh(f"{name}-{n}.stl", mesh.stl(some)), rgba) for n, (some, rgba) in parts)


def restore(files: Iterable[tuple[str, bytes]], loading: Loading) -> Model:
    """Load a model from a recording's attachments as they are.

    Args:
        files: Attachment names (``<sha256>/<file name>``) and contents of the model's files, the URDF first.
        loading: How the engine made a body of it.

    Raises:
        AssetError: A file's name isn't the hash of its content, the URDF is broken or names another file, a mesh is
            broken, or corrections of its furniture don't fit.
    """
    model, *others = [_file(key, content) for key, content in files]
    beside = [file for file in others if file.name.endswith(corrections.SUFFIX)]
    meshes = [file for file in others if file not in beside]
    path, _ = store.write_urdf(model.name, model.content)
    tree = _tree(path, model.key, frozenset(asset.key for asset in meshes))
    for asset in meshes:
        _check_mesh(store.write(asset.key, asset.content))
    for file in beside:
        corrections.check(corrections.read(_text(file), file.name), tree)
    return Model(path, tree, (model, *others), loading)


def _text(file: AssetFile) -> str:
    try:
        return file.content.decode()
    except UnicodeDecodeError as error:
        raise AssetError(file.key, f"is not UTF-8: {error}") from error


def _file(key: str, content: bytes) -> AssetFile:
    name = key.partition("/")[2]
    asset = AssetFile(name, content, store.URDF_TYPE if name.endswith(".urdf") else store.MESH_TYPE)
    if name.endswith(corrections.SUFFIX):
        asset = corrections.asset(name, content)
    forbidden = name in _RESERVED or not name.isprintable() or len(os.fsencode(name)) > _MAX_NAME
    if asset.key != key or forbidden or "/" in name or "\\" in _ESCAPE.sub("", name):
        raise AssetError(key, "is not the file that its name says")
    return asset


@lru_cache(maxsize=_CACHED_MODELS)
def _tree(path: Path, key: str, meshes: frozenset[str]) -> Urdf:
    """Return the tree of a model in the store, whose name changes with its content."""
    content = path.read_bytes()
    if not content.startswith(_START):
        raise AssetError(key, "is no URDF as recordings have them: these begin with <robot")
    if max(map(len, content.splitlines())) > _MAX_LINE:
        raise AssetError(key, f"has a line of more than {_MAX_LINE} bytes, which canonical URDF doesn't have")
    canonical_urdf.read(path, content)
    for element in ET.fromstring(content).iter():  # noqa: S314  without entities; also what isn't URDF: engines read more
        named = element.get("filename")
        if element.tag == "texture" or (named is not None and named not in meshes):
            raise AssetError(key, f"names the file {named!r}, which isn't one of the recording's for this body")
    tree = parse_urdf(content, key)
    canonical_urdf.check_size(path, tree)
    return tree


@lru_cache(maxsize=_CACHED_MESHES)
def _check_mesh(path: Path) -> None:
    """Refuse a mesh in the store that isn't as recordings have them: a binary STL, or an OBJ that is alone."""
    if path.suffix.lower() == ".obj" and _MATERIALS.search(path.read_bytes()):
        raise AssetError(path.name, "names materials in another file")
    mesh.check(path)
