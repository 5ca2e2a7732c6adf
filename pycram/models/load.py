"""Loading models: from a user's file or a recording's attachments to a checked, canonical URDF in the store.

Broken files make PyBullet crash or load no shape, so every file is checked first. PyBullet uses the convex hull of a
mesh for collisions, so a concave mesh is decomposed into convex pieces: the ``o`` groups of ``NAME.collision.obj``, or
the result of V-HACD. The table ``[NAME]`` of ``objects.toml`` may contain mass (kg), friction and coloured parts.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np

from pycram.foundation.checks import number
from pycram.foundation.failures import AssetError
from pycram.models import canonical_urdf, conversion_cache, corrections, files, mesh, store
from pycram.models.canonical_urdf import DENSITY, LARGEST
from pycram.models.files import check_packages, find, find_mesh, parse_toml, parse_urdf, read_bytes, read_text
from pycram.models.mesh import convert, convert_visual, is_convex, parse
from pycram.models.shapes import piece_bounds
from pycram.models.texture import cover_shape, warn_of_missing
from pycram.physics.loading import NOW, Loading
from recorder.records import escaped
from recorder.records.values import AssetFile
from recorder.tracing.interrupts import Uninterrupted
from recorder.urdf import Urdf

if TYPE_CHECKING:
    import trimesh


_Painted: TypeAlias = tuple[AssetFile, Sequence[float] | None]  # a mesh in the store, and its RGBA 0..1

_MESH_SUFFIXES = (".stl", ".obj", ".dae")
_CACHED_MODELS: Final = 128
_CACHED_MESHES: Final = 1024
_SIZES: Final = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}  # shapes with textures
_START: Final = b"<robot "  # start of a canonical URDF, which has no declarations and no entities
_MATERIALS: Final = re.compile(rb"^[ \t]*(?:mtllib|usemtl)\b", re.MULTILINE)
_MAX_NAME: Final = 230  # maximum bytes of a file's name; file systems allow 255, also for longer temporary names
_MAX_LINE: Final = 8000  # maximum length of a URDF's lines in bytes; PyBullet breaks longer lines
_ESCAPE: Final = re.compile(r"\\udc[89a-f][0-9a-f]")  # how recordings write a byte that isn't UTF-8
_RESERVED: Final = ("", ".", "..")


class _FileVersion(NamedTuple):
    file: Path
    modified: int  # time of the last modification, ns
    size: int


@dataclass(frozen=True, slots=True)
class Model:
    """A checked model that the engine can load."""

    path: Path  # the canonical URDF in the store
    urdf: Urdf  # tree of links and joints
    files: tuple[AssetFile, ...]  # the URDF, then the files that the URDF names, then corrections of furniture
    loading: Loading = NOW  # options for loading a body of the model into the engine
    meshes: tuple[tuple[str, _FileVersion], ...] = ()  # links of a user's URDF and their collision meshes


def load(
    path: str | Path, color: Sequence[float] | None = None, packages: Sequence[str | Path] = (), scale: float = 1.0
) -> Model:
    """Check a model and make it canonical.

    Args:
        path: A .urdf, .xacro, .stl, .obj or .dae file; see :func:`pycram.models.files.find`.
        color: RGBA 0..1 of a mesh; None for the colours of the file, or grey if the file has no colours.
        packages: Folders of ROS packages, or folders that contain them; see :mod:`pycram.models.files`.
        scale: Number of metres in the file's unit of length.

    Raises:
        BadArgument: A folder in ``packages`` doesn't exist.
        AssetError: The file or one of its meshes is missing, broken or of an unknown type.
    """
    file = find(path)
    kind = file.suffix.lower()
    with Uninterrupted():  # libraries with lazy imports ignore a Ctrl-C
        if kind in (".urdf", files.XACRO):
            folders = check_packages(packages)
            content = files.expanded(file, read_bytes(file), folders)
            model = _canonical(file, content, file.stem.removesuffix(".urdf"), folders, scale)
            beside = file.with_name(f"{file.stem.removesuffix('.urdf')}{corrections.SUFFIX}")
            if not beside.exists():
                return model
            text = read_text(beside)
            corrections.check(corrections.read(text, beside), model.urdf)
            return replace(model, files=(*model.files, corrections.asset(beside.name, text.encode())))
        if kind in _MESH_SUFFIXES:
            return _canonical(file, build(file, color, scale), file.stem)
    raise AssetError(path, f"{file.suffix or 'a file without suffix'} is not .urdf, .stl, .obj, .dae or .xacro")


def _canonical(source: Path, content: bytes, stem: str, packages: tuple[Path, ...] = (), scale: float = 1.0) -> Model:
    meshes, textures = _file_names(source, content, scale)
    found = {name: find_mesh(source, name, packages) for name in meshes}
    for name in textures:
        try:
            found[name] = find_mesh(source, name, packages)
        except AssetError:
            warn_of_missing(source, name)
    versions = tuple(
        (name, _FileVersion(file, of.st_mtime_ns, of.st_size)) for name, file in found.items() if (of := file.stat())
    )
    return _cached_model(source, content, stem, versions, scale)


@lru_cache(maxsize=_CACHED_MODELS)
def _file_names(source: Path, content: bytes, scale: float) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Check the links of a URDF; return the file names of the meshes, and of the textures."""
    root = canonical_urdf.read(source, content, scale)
    names = ({element.get("filename", ""): None for element in root.iter(tag)} for tag in ("mesh", "texture"))
    meshes, textures = map(tuple, names)
    return meshes, tuple(filter(None, textures))  # some exporters write textures without a name


@lru_cache(maxsize=_CACHED_MODELS)
def _cached_model(
    source: Path, content: bytes, stem: str, versions: tuple[tuple[str, _FileVersion], ...], scale: float
) -> Model:
    """Return the model of a URDF and of given versions of its files."""
    root = canonical_urdf.read(source, content, scale)
    files = dict(versions)
    used: dict[str, AssetFile] = {}
    meshes: list[tuple[str, _FileVersion]] = []
    named = {material.get("name"): material for material in root.findall("material")}
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            for element in collision.iter("mesh"):
                version = files[element.get("filename", "")]
                asset = _collision_mesh(version)
                meshes.append((link.get("name", ""), version))
                element.set("filename", used.setdefault(asset.key, asset).key)
        for visual in link.findall("visual"):
            shown = visual.find("geometry/mesh")
            material = visual.find("material")
            if material is not None and len(material) == 0:
                material = named.get(material.get("name"))
            texture = None if material is None else material.find("texture")
            picture = None if texture is None else files.get(texture.get("filename", ""))
            if shown is not None:
                _color(link, visual, shown, _visual_meshes(files[shown.get("filename", "")], picture), used)
            elif picture is not None:
                _cover(link, visual, picture, used)
    for material in root.iter("material"):
        for texture in material.findall("texture"):
            material.remove(texture)  # the shapes have the texture's colours now
    text, tree = canonical_urdf.write(source, root)
    path, asset = store.write_urdf(f"{stem}.urdf", text)
    piece_bounds(path)  # fill the cache, so that the first query is fast
    return Model(path, tree, (asset, *used.values()), meshes=tuple(meshes))


def _cover(link: ET.Element, visual: ET.Element, picture: _FileVersion, used: dict[str, AssetFile]) -> None:
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
    """Replace a visual by visuals of one colour each. As in RViz, a mesh's colours override colours of the URDF."""
    place = list(link).index(visual)
    link.remove(visual)
    for at, (asset, rgba) in enumerate(parts):
        shown.set("filename", used.setdefault(asset.key, asset).key)
        part = deepcopy(visual)
        if rgba is not None:
            for material in part.findall("material"):
                part.remove(material)
            material = ET.SubElement(part, "material", name=f"{asset.name} {asset.sha256[:8]}")
            ET.SubElement(material, "color", rgba=" ".join(f"{value:.6g}" for value in rgba))
        link.insert(place + at, part)


@cache
def _collision_mesh(version: _FileVersion) -> AssetFile:
    """Store a collision mesh in a format that the engine reads; check each version of a file once."""
    file = version.file
    ((name, content, _),) = conversion_cache.get("collision", file, lambda: [(*mesh.convert_collision(file), None)])
    return store.write_mesh(name, content)


def filled_links(model: Model) -> Sequence[str]:
    """Return the links of a user's URDF with a hollow collision mesh, which the engine fills to its convex hull."""
    return list(dict.fromkeys(link for link, version in model.meshes if _is_filled(version)))


@cache
def _is_filled(version: _FileVersion) -> bool:
    file = version.file
    kept = conversion_cache.kept(
        "filled", (os.fsencode(file.suffix), read_bytes(file)), lambda: [(str(mesh.is_filled(file)), b"", None)]
    )
    return kept[0][0] == str(True)


@cache
def _visual_meshes(version: _FileVersion, picture: _FileVersion | None) -> tuple[_Painted, ...]:
    """Store a visual mesh as one mesh for each colour; check each version of the files once."""
    file, cover = version.file, None if picture is None else read_bytes(picture.file)
    kind = "visual" if cover is None else f"visual {sha256(cover).hexdigest()}"
    parts = conversion_cache.get(kind, file, lambda: mesh.convert_visual(file, cover))
    return tuple((store.write_mesh(name, content), rgba) for name, content, rgba in parts)


@cache
def _covered(kind: str, size: tuple[float, ...], picture: _FileVersion) -> tuple[_Painted, ...]:
    name = f"{picture.file.stem}-{kind}"
    parts = enumerate(cover_shape(kind, size, picture.file))
    return tuple((store.write_mesh(f"{name}-{n}.stl", mesh.stl(some)), rgba) for n, (some, rgba) in parts)


def restore(files: Iterable[tuple[str, bytes]], loading: Loading) -> Model:
    """Load a model from the names (``<sha256>/<file name>``) and contents of a recording's attachments, the URDF first.

    AssetError is raised for a broken file, a name that doesn't match its content, and a URDF that names another file.
    """
    model, *others = [_file(key, content) for key, content in files]
    beside = [file for file in others if file.name.endswith(corrections.SUFFIX)]
    meshes = [file for file in others if file not in beside]
    path, _ = store.write_urdf(model.name, model.content)
    tree = _tree(path, model.key, frozenset(asset.key for asset in meshes))
    for asset in meshes:
        _check_mesh(store.write(asset.key, asset.content))
    for file in beside:
        try:
            text = file.content.decode()
        except UnicodeDecodeError as error:
            raise AssetError(file.key, f"the file is not UTF-8: {error}") from error
        corrections.check(corrections.read(text, file.name), tree)
    return Model(path, tree, (model, *others), loading)


def _file(key: str, content: bytes) -> AssetFile:
    name = key.partition("/")[2]
    asset = AssetFile(name, content, store.URDF_TYPE if name.endswith(".urdf") else store.MESH_TYPE)
    if name.endswith(corrections.SUFFIX):
        asset = corrections.asset(name, content)
    forbidden = name in _RESERVED or not name.isprintable() or len(os.fsencode(name)) > _MAX_NAME
    if asset.key != key or forbidden or "/" in name or "\\" in _ESCAPE.sub("", name):
        raise AssetError(key, "the name of the file doesn't match its content")
    return asset


@lru_cache(maxsize=_CACHED_MODELS)
def _tree(path: Path, key: str, meshes: frozenset[str]) -> Urdf:
    """Check a stored URDF that a recording contained, and return its tree."""
    content = path.read_bytes()
    if not content.startswith(_START):
        raise AssetError(key, "the file isn't a recorded URDF, which starts with <robot")
    if max(map(len, content.splitlines())) > _MAX_LINE:
        raise AssetError(key, f"a line has more than {_MAX_LINE} bytes, which isn't canonical")
    canonical_urdf.read(path, content)
    for element in ET.fromstring(content).iter():  # noqa: S314  a text without entities; the engine reads all elements
        named = element.get("filename")
        if element.tag == "texture" or (named is not None and named not in meshes):
            raise AssetError(key, f"the URDF names {named!r}, a file that the recording doesn't have for this body")
    tree = parse_urdf(content, key)
    canonical_urdf.check_size(path, tree)
    return tree


@lru_cache(maxsize=_CACHED_MESHES)
def _check_mesh(path: Path) -> None:
    if path.suffix.lower() == ".obj" and _MATERIALS.search(path.read_bytes()):
        raise AssetError(path.name, "the mesh names materials in another file")
    mesh.check(path)


_MIN_CONVEXITY: Final = 0.9  # minimum share of the hull's volume (open mesh: area) that counts as a convex mesh
_GREY: Final = (0.8, 0.8, 0.8, 1.0)


def build(file: Path, color: Sequence[float] | None, scale: float = 1.0) -> bytes:
    """Return the URDF of an object, and store its meshes; :func:`load` describes the arguments.

    AssetError is raised if the mesh or a file next to it is broken, or if the object is too large for the engine.
    """
    kind = f"object {None if color is None else [float(part) for part in color]} scale {float(scale)!r}"
    parts = [file.parent / str(part["mesh"]) for part in _colored(_properties(file)) or ()]
    beside = [_pieces(file), _table(file), *parts]
    *meshes, (_, urdf, _) = conversion_cache.get(kind, file, lambda: [*_files(file, color, scale)], beside)
    for name, content, _ in meshes:
        store.write_mesh(name, content)
    return urdf


def _files(file: Path, color: Sequence[float] | None, scale: float) -> Iterator[tuple[str, bytes, None]]:
    """Yield name and content of each mesh, and then of the URDF, which has one link with inertia and these meshes."""
    shape = parse(file)
    if scale != 1.0:
        shape.vertices = shape.vertices * scale
    spread = np.linalg.svd(shape.vertices - shape.vertices.mean(axis=0), compute_uv=False)
    if len(spread) < 3 or spread[2] <= 1e-9 * spread[0]:
        raise AssetError(file, "the mesh is flat and encloses no volume")
    robot = ET.Element("robot", name=file.stem)
    link = ET.SubElement(robot, "link", name=file.stem)
    entry = _properties(file)
    if "friction" in entry:
        ET.SubElement(ET.SubElement(link, "contact"), "lateral_friction", value=repr(entry["friction"]))
    _add_inertia(file, link, shape, entry)
    for name, content, rgba in _visuals(file, color, entry):
        visual = ET.SubElement(link, "visual")
        mesh = ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=AssetFile(name, content).key)
        _set_scale(mesh, scale)
        yield name, content, None
        material = ET.SubElement(visual, "material", name=name)
        ET.SubElement(material, "color", rgba=" ".join(f"{part:g}" for part in rgba))
    collision = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
    name, content = _collision(file, shape)
    mesh = ET.SubElement(collision, "mesh", filename=AssetFile(name, content).key)
    if _pieces(file).is_file():
        _set_scale(mesh, scale)
    yield name, content, None
    # the name is escaped, because it may contain bytes that aren't UTF-8
    yield f"{file.stem}.urdf", escaped(ET.tostring(robot, encoding="unicode")).encode(), None


def _set_scale(mesh: ET.Element, scale: float) -> None:
    if scale != 1.0:
        mesh.set("scale", " ".join([repr(scale)] * 3))


def _visuals(
    file: Path, color: Sequence[float] | None, entry: Mapping[str, object]
) -> list[tuple[str, bytes, Sequence[float]]]:
    parts = _colored(entry)
    if color is not None or (parts is None and file.suffix.lower() == ".stl"):
        name, content = convert(file)
        return [(name, content, color if color is not None else _GREY)]
    if parts is not None:
        return [(*convert(file.parent / str(part["mesh"])), part["rgba"]) for part in parts]
    return [(name, content, rgba or _GREY) for name, content, rgba in convert_visual(file)]


def _collision(file: Path, shape: trimesh.Trimesh) -> tuple[str, bytes]:
    pieces = _pieces(file)
    if pieces.is_file():
        return convert(pieces)
    if is_convex(shape, _MIN_CONVEXITY):
        return f"{file.stem}.hull.obj", _obj(shape.convex_hull)
    return f"{file.stem}.collision.obj", _decompose(_obj(shape))


def _obj(shape: trimesh.Trimesh) -> bytes:
    return str(shape.export(file_type="obj", include_color=False, include_texture=False)).encode()


def _decompose(content: bytes) -> bytes:
    from pycram.physics.engine import decompose  # noqa: PLC0415  only concave meshes need the engine

    source = store.write(AssetFile("concave.obj", content).key, content)
    pieces = source.with_name("pieces.obj")
    if not pieces.exists():
        decompose(source, pieces)
    return pieces.read_bytes()


def _pieces(file: Path) -> Path:
    return file.with_suffix(".collision.obj")


def _table(file: Path) -> Path:
    return file.parent / "objects.toml"


def _colored(entry: Mapping[str, Any]) -> list[Mapping[str, Any]] | None:
    parts = entry.get("visual")
    return parts if isinstance(parts, list) else None


def _properties(file: Path) -> Mapping[str, object]:
    table = _table(file)
    entry = parse_toml(read_text(table), table).get(file.stem) if table.is_file() else None
    return entry if isinstance(entry, dict) else {}


def _add_inertia(file: Path, link: ET.Element, shape: trimesh.Trimesh, entry: Mapping[str, object]) -> None:
    if "mass" in entry:
        mass = number("mass", entry["mass"])
    else:
        solid = shape if shape.is_watertight else shape.convex_hull
        mass = float(max(abs(solid.volume) * DENSITY, 1e-3))
    solid = shape if shape.is_watertight and shape.volume > 0 else shape.convex_hull
    tensor = solid.moment_inertia * (mass / solid.volume)
    if max(mass, abs(tensor).max()) > LARGEST:
        size = " x ".join(f"{length:.3g}" for length in shape.extents)
        raise AssetError(file, f"the mesh is {size} m large: is it in millimetres? Object(..., scale=0.001)")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(repr(float(x)) for x in solid.center_mass), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(mass))
    moments = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(tensor[i, j])) for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", attrib=moments)
