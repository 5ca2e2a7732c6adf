"""Meshes: checks before the engine sees them, and a URDF for an object that is one mesh.

PyBullet loads a truncated or ASCII STL as a body without a shape, and takes the convex hull of any mesh for collision,
so that a bowl would be solid. Hence: every mesh is parsed here; concave ones get a convex decomposition, from
``NAME.collision.obj`` beside the mesh (one ``o`` group per convex piece) or else made by V-HACD. A table ``[NAME]`` in
``objects.toml`` beside it may give its mass (kg), friction and coloured visual parts.
"""

from __future__ import annotations

import io
import struct
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.foundation import toml
from pycram.foundation.checks import number
from pycram.foundation.failures import AssetError
from pycram.models.links import DENSITY
from recorder.extras import needed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

with needed():
    import trimesh

_FARTHEST: Final = 1e4  # m; what is larger was not measured in metres
_CONVEX_SHARE: Final = 0.9  # of its hull's volume: less is concave
_GREY: Final = (0.8, 0.8, 0.8, 1.0)
_STL_HEADER: Final = 84
_STL_FACE: Final = np.dtype([("numbers", "<f4", (4, 3)), ("attribute", "<u2")])


def checked(file: Path) -> tuple[str, bytes]:
    """A mesh in a form that the engine reads whole.

    Args:
        file: .stl (binary or ASCII), .obj or .dae.

    Returns:
        File name and content; an ASCII STL becomes a binary one, a COLLADA file an OBJ.

    Raises:
        AssetError: it is empty, truncated, has no faces or numbers that aren't finite.
    """
    content = _bytes(file)
    kind = file.suffix.lower()
    if kind == ".stl" and not _is_ascii(content):
        _check_binary_stl(file, content)
        return file.name, _with_normals(content)
    shape = parse(file)
    if kind == ".stl":
        return file.name, _exported(shape, "stl")
    if kind == ".obj":
        # colours come from the URDF's materials: the engine's renderer takes one per mesh
        lines = content.decode("utf-8", "replace").splitlines()
        kept = [line for line in lines if not line.startswith(("mtllib", "usemtl"))]
        return file.name, ("\n".join(kept) + "\n").encode()
    return f"{file.stem}.obj", _obj(shape)


def parse(file: Path) -> trimesh.Trimesh:
    """Reads a mesh in its own frame, in metres.

    Args:
        file: .stl, .obj or .dae.

    Returns:
        One mesh; the parts of a scene are put together.

    Raises:
        AssetError: it can't be read, has no faces or numbers that aren't finite.
    """
    content = _bytes(file)
    if file.suffix.lower() == ".stl" and not _is_ascii(content):
        _check_binary_stl(file, content)
    try:
        loaded = trimesh.load(io.BytesIO(content), file_type=file.suffix.lower()[1:], force="mesh", process=False)
    except Exception as error:  # the parsers of trimesh raise whatever goes wrong in them
        raise AssetError(file, f"can't be parsed as {file.suffix}: {error}") from error
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise AssetError(file, "has no faces")
    if not np.isfinite(loaded.vertices).all():
        raise AssetError(file, "has vertices that are not finite numbers")
    if np.abs(loaded.vertices).max() > _FARTHEST:
        raise AssetError(file, f"has vertices more than {_FARTHEST:g} m away from its origin")
    loaded.merge_vertices()
    return loaded


def stl_faces(content: bytes) -> NDArray[np.void]:
    """The faces of a binary STL that is whole.

    Args:
        content: the file.

    Returns:
        (n,) with "numbers", (4, 3) each: the normal and three corners.
    """
    count = struct.unpack("<I", content[_STL_HEADER - 4 : _STL_HEADER])[0]
    return np.frombuffer(content, dtype=_STL_FACE, count=count, offset=_STL_HEADER)


def _bytes(file: Path) -> bytes:
    try:
        content = file.read_bytes()
    except OSError as error:
        raise AssetError(file, f"can't be read: {error.strerror}") from error
    if not content:
        raise AssetError(file, "is empty")
    return content


def _is_ascii(content: bytes) -> bool:
    return content[:5].lower() == b"solid" and b"facet" in content[:1000]


def _check_binary_stl(file: Path, content: bytes) -> None:
    if len(content) < _STL_HEADER:
        raise AssetError(file, f"is no STL: {len(content)} bytes are less than its header")
    faces = struct.unpack("<I", content[80:84])[0]
    wanted = _STL_HEADER + faces * _STL_FACE.itemsize
    if faces == 0:
        raise AssetError(file, "is an STL without faces")
    if len(content) < wanted:
        raise AssetError(file, f"is truncated: {faces} faces take {wanted} bytes, it has {len(content)}")
    if not np.isfinite(stl_faces(content)["numbers"]).all():
        raise AssetError(file, "has vertices that are not finite numbers")


def _with_normals(content: bytes) -> bytes:
    """Fills in normals that a binary STL leaves at zero, as many exporters do: the renderer would paint it black."""
    table = stl_faces(content).copy()
    numbers = table["numbers"]
    missing = np.abs(numbers[:, 0]).sum(axis=1) < 0.5  # a unit vector's parts add up to 1 at least
    if not missing.any():
        return content
    a, b, c = (numbers[missing, corner].astype(np.float64) for corner in (1, 2, 3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    numbers[missing, 0] = normals / np.maximum(lengths, 1e-30)
    filled: bytes = content[:_STL_HEADER] + table.tobytes()
    return filled


def _obj(shape: trimesh.Trimesh) -> bytes:
    return _exported(shape, "obj", include_color=False, include_texture=False)


def _exported(shape: trimesh.Trimesh, kind: str, **options: Any) -> bytes:
    content = shape.export(file_type=kind, **options)
    return content.encode() if isinstance(content, str) else bytes(content)


def as_urdf(
    file: Path,
    color: Sequence[float] | None,
    keep: Callable[[str, bytes], str],
    decompose: Callable[[bytes], bytes],
) -> str:
    """A URDF with one link that is this mesh.

    Args:
        file: the mesh.
        color: RGBA 0..1 for all of it, None for its own colours (or grey).
        keep: stores a file and returns the name that a URDF refers to it by.
        decompose: convex decomposition of an OBJ, as an OBJ with one group per piece.

    Returns:
        The URDF's text: visual shape, convex collision shape, mass, centre of mass and inertia.

    Raises:
        AssetError: the mesh or a file beside it is broken.
    """
    shape = parse(file)
    spread = np.linalg.svd(shape.vertices - shape.vertices.mean(axis=0), compute_uv=False)
    if len(spread) < 3 or spread[2] <= 1e-9 * spread[0]:
        raise AssetError(file, "is flat: it encloses no volume")
    robot = ET.Element("robot", name=file.stem)
    link = ET.SubElement(robot, "link", name=file.stem)
    entry = _entry(file)
    if "friction" in entry:
        ET.SubElement(ET.SubElement(link, "contact"), "lateral_friction", value=repr(entry["friction"]))
    _add_inertia(link, shape, _mass(shape, entry))
    for name, content, rgba in _visuals(file, color, entry):
        visual = ET.SubElement(link, "visual")
        ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=keep(name, content))
        material = ET.SubElement(visual, "material", name=name)
        ET.SubElement(material, "color", rgba=" ".join(f"{part:g}" for part in rgba))
    collision = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
    ET.SubElement(collision, "mesh", filename=keep(*_collision(file, shape, decompose)))
    return ET.tostring(robot, encoding="unicode")


def _visuals(
    file: Path, color: Sequence[float] | None, entry: Mapping[str, object]
) -> list[tuple[str, bytes, Sequence[float]]]:
    parts = entry.get("visual")
    if color is not None or (parts is None and file.suffix.lower() == ".stl"):
        name, content = checked(file)
        return [(name, content, color if color is not None else _GREY)]
    if isinstance(parts, list):
        return [(*checked(file.parent / str(part["mesh"])), part["rgba"]) for part in parts]
    return _by_material(file)


def _by_material(file: Path) -> list[tuple[str, bytes, Sequence[float]]]:
    """The parts of an OBJ or COLLADA file by colour: the engine's renderer takes one per mesh."""
    parse(file)
    scene = trimesh.load_scene(file, process=False)
    found: list[tuple[str, bytes, Sequence[float]]] = []
    meshes = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    for index, part in enumerate(meshes):
        material = getattr(part.visual, "material", None)
        main = getattr(material, "main_color", None)
        rgba = _GREY if main is None else tuple(float(value) / 255 for value in main)
        found.append((f"{file.stem}-{index}.obj", _obj(part), rgba))
    return found


def _collision(file: Path, shape: trimesh.Trimesh, decompose: Callable[[bytes], bytes]) -> tuple[str, bytes]:
    pieces = file.with_suffix(".collision.obj")
    if pieces.is_file():
        return checked(pieces)
    hull = shape.convex_hull
    if not shape.is_watertight or shape.volume > _CONVEX_SHARE * hull.volume:
        return f"{file.stem}.hull.obj", _obj(hull)
    return f"{file.stem}.collision.obj", decompose(_obj(shape))


def _entry(file: Path) -> Mapping[str, object]:
    """What ``objects.toml`` beside a mesh says of it."""
    table = file.parent / "objects.toml"
    entry = toml.read(table).get(file.stem) if table.is_file() else None
    return entry if isinstance(entry, dict) else {}


def _mass(shape: trimesh.Trimesh, entry: Mapping[str, object]) -> float:
    if "mass" in entry:
        return number("mass", entry["mass"])
    solid = shape if shape.is_watertight else shape.convex_hull
    return float(max(abs(solid.volume) * DENSITY, 1e-3))


def _add_inertia(link: ET.Element, shape: trimesh.Trimesh, mass: float) -> None:
    solid = shape if shape.is_watertight and shape.volume > 0 else shape.convex_hull
    tensor = solid.moment_inertia * (mass / solid.volume)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(repr(float(x)) for x in solid.center_mass), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(mass))
    moments = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(tensor[i, j])) for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", attrib=moments)
