"""Meshes: checked before the engine reads them, and the URDF of an object that is one mesh.

PyBullet loads a truncated or ASCII STL as a body without a shape, and collides with the convex hull of any mesh, so
that a bowl would be solid. So every mesh is parsed here, and concave ones get a convex decomposition: from
``NAME.collision.obj`` beside the mesh (one ``o`` group per convex piece), else by V-HACD. A table ``[NAME]`` in the
``objects.toml`` beside it may give its mass (kg), friction and coloured visual parts.
"""

from __future__ import annotations

import io
import re
import struct
import xml.etree.ElementTree as ET
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.foundation.checks import number
from pycram.foundation.failures import AssetError
from pycram.models.files import parse_toml, read_text
from pycram.models.lazy_module import LazyModule
from pycram.models.links import DENSITY
from pycram.models.parts import STL_FACE, STL_HEADER, check_vertices, mean, quiet, read_image, read_parts, stl
from pycram.models.warming import notable
from recorder.packages import needed
from recorder.records import escaped
from recorder.records.values import AssetFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    import trimesh
    from numpy.typing import NDArray
else:
    with needed():
        trimesh = LazyModule("trimesh")

_MIN_CONVEXITY: Final = 0.9  # share of its hull's volume that a convex mesh fills
_GREY: Final = (0.8, 0.8, 0.8, 1.0)
_LARGE: Final = 5000  # faces
_FAR: Final = 1e9  # in the file's unit, of an STL, which a URDF may scale
_HAS_PIECES: Final = re.compile(rb"^[og]\s.*^[og]\s", re.MULTILINE | re.DOTALL)


def convert(file: Path) -> tuple[str, bytes]:
    """Return file name and content of a .stl, .obj or .dae mesh as the engine reads it.

    ASCII STL and COLLADA become binary STL.

    Raises:
        AssetError: It is empty, truncated, has no faces or numbers that aren't finite.
    """
    content = _bytes(file)
    kind = file.suffix.lower()
    if kind == ".stl" and not _is_ascii(content):
        _check_binary_stl(file, content)
        return file.name, _with_normals(content)
    if kind == ".obj":
        _all_triangles(file, content)
        # colours come from the URDF's materials: PyBullet has one per mesh
        lines = content.decode("utf-8", "replace").splitlines()
        kept = [line for line in lines if not line.startswith(("mtllib", "usemtl"))]
        return file.name, ("\n".join(kept) + "\n").encode()
    return f"{file.stem}.stl", stl(parse(file).triangles)


def convert_collision(file: Path) -> tuple[str, bytes]:
    """Return file name and content of a mesh that something collides with, as :func:`convert`.

    Of a large one in one piece only the convex hull is left: nothing else collides, and the engine would take long to
    find it, each time that the model is loaded.
    """
    content = _bytes(file)
    kind = file.suffix.lower()
    if kind == ".obj" and (len(content) <= _LARGE * STL_FACE.itemsize or _HAS_PIECES.search(content)):
        return convert(file)
    if kind in (".obj", ".dae"):
        triangles = _all_triangles(file, content)
    else:
        name, content = convert(file)
        triangles = stl_faces(content)["numbers"][:, 1:].astype(np.float64)
        if len(triangles) <= _LARGE:
            return name, content
    hull = _hull(triangles) if len(triangles) > _LARGE else None
    return (f"{file.stem}.stl", stl(triangles)) if hull is None else (f"{file.stem}.hull.stl", stl(hull))


def check(file: Path) -> None:
    """Refuse a mesh that isn't as :func:`convert` writes them, or is broken.

    Raises:
        AssetError: It is neither binary STL nor OBJ, or as for :func:`convert`.
    """
    kind = file.suffix.lower()
    if kind == ".stl":
        _check_binary_stl(file, _bytes(file))
    elif kind == ".obj":
        _all_triangles(file, _bytes(file))
    else:
        raise AssetError(file, "is neither binary STL nor OBJ")


def _all_triangles(file: Path, content: bytes) -> NDArray[np.float64]:
    parts = read_parts(file, content)
    if not parts:
        raise AssetError(file, "has no faces")
    return np.concatenate([part.triangles for part in parts])


def _hull(triangles: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the triangles of the convex hull, normals outwards; None of something flat."""
    with needed():
        from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  not for pictures of recordings

    corners = np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.float32)
    distinct = np.unique(corners.view("V12")).view(np.float32).reshape(-1, 3).astype(np.float64)
    try:
        hull = ConvexHull(distinct)
    except QhullError:
        return None
    faces: NDArray[np.float64] = hull.points[hull.simplices]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    inwards = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inwards] = faces[inwards, ::-1]
    return faces


def convert_visual(file: Path, cover: bytes | None = None) -> list[tuple[str, bytes, Sequence[float] | None]]:
    """Return what is to be seen of a mesh: file name, content and colour RGBA 0..1 of each part.

    A colour is None where the file gives none. A file without faces has no parts: lines are not shown.

    Args:
        file: The mesh.
        cover: The texture's content, of what has no material of its own; its mean colour where the mesh doesn't say
            which spot of it is where.

    Raises:
        AssetError: As for :func:`convert`.
    """
    if file.suffix.lower() not in (".dae", ".obj"):
        image = None if cover is None else read_image(io.BytesIO(cover))
        return [(*convert(file), None if image is None else mean(image))]
    parts = read_parts(file, _bytes(file), cover)
    if file.suffix.lower() == ".obj" and len(parts) == 1:
        return [(*convert(file), parts[0].rgba)]  # with its normals
    return [(f"{file.stem}-{number}.stl", stl(part.triangles), part.rgba) for number, part in enumerate(parts)]


def parse(file: Path) -> trimesh.Trimesh:
    """Read a .stl, .obj or .dae file as one mesh in its own frame, in metres.

    Raises:
        AssetError: It can't be read, has no faces or numbers that aren't finite.
    """
    content = _bytes(file)
    if file.suffix.lower() == ".stl" and not _is_ascii(content):
        _check_binary_stl(file, content)
    if file.suffix.lower() in (".dae", ".obj"):
        corners = _all_triangles(file, content).reshape(-1, 3)
        merged = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
        merged.merge_vertices()
        return merged
    try:
        with quiet():
            loaded = trimesh.load(io.BytesIO(content), file_type=file.suffix.lower()[1:], force="mesh", process=False)
    except Exception as error:  # the parsers of trimesh raise whatever goes wrong in them
        raise AssetError(file, f"can't be parsed as {file.suffix}: {error}") from error
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise AssetError(file, "has no faces")
    check_vertices(file, loaded.vertices)
    loaded.merge_vertices()
    return loaded


def stl_faces(content: bytes) -> NDArray[np.void]:
    """Return the faces (n,) of a complete binary STL, with "numbers" (4, 3) each: the normal and three corners."""
    count = struct.unpack("<I", content[STL_HEADER - 4 : STL_HEADER])[0]
    return np.frombuffer(content, dtype=STL_FACE, count=count, offset=STL_HEADER)


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
    if len(content) < STL_HEADER:
        raise AssetError(file, f"is no STL: {len(content)} bytes are less than its header")
    faces = struct.unpack("<I", content[80:84])[0]
    wanted = STL_HEADER + faces * STL_FACE.itemsize
    if faces == 0:
        raise AssetError(file, "is an STL without faces")
    if len(content) < wanted:
        raise AssetError(file, f"is truncated: {faces} faces take {wanted} bytes, it has {len(content)}")
    numbers = stl_faces(content)["numbers"]
    if not np.isfinite(numbers).all():
        raise AssetError(file, "has vertices that are not finite numbers")
    if np.abs(numbers[:, 1:]).max() > _FAR:
        raise AssetError(file, f"has vertices more than {_FAR:g} away from its origin")


def _with_normals(content: bytes) -> bytes:
    """Fill in normals that a binary STL leaves at zero, as many exporters do: it would be rendered black."""
    table = stl_faces(content).copy()
    numbers = table["numbers"]
    missing = np.abs(numbers[:, 0]).sum(axis=1) < 0.5  # components of a unit vector add up to 1 at least
    if not missing.any():
        return content
    a, b, c = (numbers[missing, corner].astype(np.float64) for corner in (1, 2, 3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    numbers[missing, 0] = normals / np.maximum(lengths, 1e-30)
    filled: bytes = content[:STL_HEADER] + table.tobytes()
    return filled


def _obj(shape: trimesh.Trimesh) -> bytes:
    return _exported(shape, "obj", include_color=False, include_texture=False)


def _exported(shape: trimesh.Trimesh, kind: str, **options: Any) -> bytes:
    content = shape.export(file_type=kind, **options)
    return content.encode() if isinstance(content, str) else bytes(content)


def beside(file: Path) -> Iterator[Path]:
    """Yield the files beside a mesh that :func:`as_urdf` reads: pieces, its table, meshes that this names.

    Raises:
        AssetError: The table is broken.
    """
    yield _pieces(file)
    yield _table(file)
    for part in _colored(_properties(file)) or ():
        yield file.parent / str(part["mesh"])


def as_urdf(
    file: Path, color: Sequence[float] | None, decompose: Callable[[bytes], bytes]
) -> Iterator[tuple[str, bytes, None]]:
    """Yield the files of a URDF of one link: a mesh with convex collision shape, mass, centre of mass and inertia.

    Each has a name, a content and no colour, for :mod:`pycram.models.conversion_cache`. The URDF is the last, and names
    the others by their keys.

    Args:
        file: The mesh.
        color: RGBA 0..1 for all of it; None for its own colours, or grey.
        decompose: Takes an OBJ, returns its convex decomposition as an OBJ with one group per piece.

    Raises:
        AssetError: The mesh or a file beside it is broken.
    """
    shape = parse(file)
    spread = np.linalg.svd(shape.vertices - shape.vertices.mean(axis=0), compute_uv=False)
    if len(spread) < 3 or spread[2] <= 1e-9 * spread[0]:
        raise AssetError(file, "is flat: it encloses no volume")
    robot = ET.Element("robot", name=file.stem)
    link = ET.SubElement(robot, "link", name=file.stem)
    entry = _properties(file)
    if "friction" in entry:
        ET.SubElement(ET.SubElement(link, "contact"), "lateral_friction", value=repr(entry["friction"]))
    _add_inertia(link, shape, _mass(shape, entry))
    for name, content, rgba in _visuals(file, color, entry):
        visual = ET.SubElement(link, "visual")
        ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=AssetFile(name, content).key)
        yield name, content, None
        material = ET.SubElement(visual, "material", name=name)
        ET.SubElement(material, "color", rgba=" ".join(f"{part:g}" for part in rgba))
    collision = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
    name, content = _collision(file, shape, decompose)
    ET.SubElement(collision, "mesh", filename=AssetFile(name, content).key)
    yield name, content, None
    # pieces have the name of the file
    yield f"{file.stem}.urdf", escaped(ET.tostring(robot, encoding="unicode")).encode(), None


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


def _collision(file: Path, shape: trimesh.Trimesh, decompose: Callable[[bytes], bytes]) -> tuple[str, bytes]:
    pieces = _pieces(file)
    if pieces.is_file():
        return convert(pieces)
    hull = shape.convex_hull
    if not shape.is_watertight or shape.volume > _MIN_CONVEXITY * hull.volume:
        return f"{file.stem}.hull.obj", _obj(hull)
    return f"{file.stem}.collision.obj", decompose(_obj(shape))


def _pieces(file: Path) -> Path:
    return file.with_suffix(".collision.obj")


def _table(file: Path) -> Path:
    return file.parent / "objects.toml"


def _colored(entry: Mapping[str, Any]) -> list[Mapping[str, Any]] | None:
    """Return the coloured visual parts that a mesh's table gives; None if it gives none."""
    parts = entry.get("visual")
    return parts if isinstance(parts, list) else None


def _properties(file: Path) -> Mapping[str, object]:
    """Return a mesh's table in the ``objects.toml`` beside it; empty if there is none."""
    table = _table(file)
    entry = _parsed(read_text(table), table).get(file.stem) if table.is_file() else None
    return entry if isinstance(entry, dict) else {}


@lru_cache(maxsize=8)  # each object of a folder asks for the same
@notable
def _parsed(text: str, table: Path) -> Mapping[str, object]:
    return parse_toml(text, table)


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
