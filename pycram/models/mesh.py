"""Meshes: checks of STL, OBJ and COLLADA files, and conversions for the engine and viewers.

PyBullet loads a truncated or ASCII STL as a body without a shape, so this module parses every mesh first. pycollada
reads COLLADA three times as fast as trimesh. Most OBJ files are read without trimesh, because its import takes 1 s.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pycram.foundation.failures import AssetError
from pycram.models.files import read_bytes
from pycram.models.texture import bake, mean, read_image
from recorder.packages import LazyModule, needed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    import collada
    import trimesh
    from numpy.typing import NDArray
    from PIL import Image

    from pycram.models.texture import Rgba
    from recorder.geometry import Array

else:
    with needed("executor"):
        collada, trimesh = LazyModule("collada"), LazyModule("trimesh")

_LARGE: Final = 5000  # number of faces of a large mesh
_FAR: Final = 1e9  # maximum coordinate of a mesh, in the unit of the file
_HOLLOW: Final = 0.5  # a mesh is hollow if it fills at most this share of its convex hull
_HAS_PIECES: Final = re.compile(rb"^[og]\s.*^[og]\s", re.MULTILINE | re.DOTALL)
_STL_HEADER: Final = 84
_STL_FACE: Final = np.dtype([("numbers", "<f4", (4, 3)), ("attribute", "<u2")])
_MAX_LINE: Final = 8000  # maximum length of an OBJ's lines in bytes; PyBullet splits lines after 8,192 bytes


class ColoredPart(NamedTuple):
    """Triangles of a mesh that have the same colour."""

    triangles: Array  # (n, 3, 3) corners in the mesh's frame, m
    rgba: Rgba | None  # RGBA 0..1; None if the file has no colour


@lru_cache(maxsize=2)  # loading uses most meshes twice: first for collision, then for visuals
def read_parts(file: Path, content: bytes, cover: bytes | None = None) -> tuple[ColoredPart, ...]:
    """Return the triangles of a .dae or .obj file, grouped by colour; textures and materials are next to the file.

    ``cover`` is the content of a texture for faces without a material.

    Raises:
        AssetError: The content can't be parsed, or a number isn't finite or is too large.
    """
    with _parsing(file):
        image = None if cover is None else read_image(io.BytesIO(cover))
        found = list((_dae_parts if file.suffix.lower() == ".dae" else _obj_parts)(file, content, image))
    by_color: dict[Rgba | None, list[Array]] = {}
    for triangles, rgba in found:
        if len(triangles):
            by_color.setdefault(rgba, []).append(triangles)
    parts = tuple(ColoredPart(np.concatenate(triangles), rgba) for rgba, triangles in by_color.items())
    for part in parts:
        _check_vertices(file, part.triangles)
    return parts


def _dae_parts(file: Path, content: bytes, cover: Image.Image | None) -> Iterator[ColoredPart]:
    """Yield parts in the file's unit of length. Like ROS, ignore the file's up axis."""
    try:
        document = collada.Collada(io.BytesIO(content), ignore=[collada.common.DaeError])
    except collada.common.DaeMalformedError as error:  # the error names the line
        _, end, tail = content.rpartition(b"</COLLADA>")
        raise ValueError(f"{error}{'; delete everything after </COLLADA>' if end and tail.strip() else ''}") from error
    unit = document.assetInfo.unitmeter or 1.0
    for geometry in document.scene.objects("geometry") if document.scene else ():
        for primitive in geometry.primitives():
            mesh = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
            if not isinstance(mesh, collada.triangleset.BoundTriangleSet) or mesh.vertex is None or not len(mesh):
                continue  # lines contain no triangles
            triangles = np.asarray(mesh.vertex[mesh.vertex_index], dtype=np.float64) * unit
            diffuse = getattr(getattr(mesh.material, "effect", None), "diffuse", None)
            if isinstance(diffuse, collada.material.Map):
                name = diffuse.sampler.surface.image.path.removeprefix("file://").replace("%20", " ")
                image = read_image(file.parent / name)
                yield from _textured(triangles, _dae_uv(mesh) if image else None, image)
            elif diffuse is None and cover is not None:
                yield from _textured(triangles, _dae_uv(mesh), cover)
            else:
                yield ColoredPart(triangles, _rgba(diffuse))


def _dae_uv(mesh: collada.triangleset.BoundTriangleSet) -> Array | None:
    return mesh.texcoordset[0][mesh.texcoord_indexset[0]] if mesh.texcoordset else None


def _obj_parts(file: Path, content: bytes, cover: Image.Image | None) -> Iterator[ColoredPart]:
    vertices, faces = _read_faces(content)
    if cover is None and b"mtl" not in content and all(len(corners) == 3 for corners in faces):
        if any(len(numbers) < 3 for numbers in vertices):
            raise ValueError("a vertex has fewer than three numbers")
        table = np.array(vertices).astype(np.float64).reshape(-1, 3)
        yield ColoredPart(table[np.array(faces, dtype=np.intp).reshape(-1, 3)], None)
        return
    has_materials = b"mtllib" in content
    resolver = trimesh.resolvers.FilePathResolver(str(file))
    with _without_log():
        meshes = trimesh.load_scene(io.BytesIO(content), file_type="obj", resolver=resolver, process=False).dump()
    for mesh in meshes:
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        triangles = np.asarray(mesh.triangles, dtype=np.float64)
        material = getattr(mesh.visual, "material", None) if has_materials else None
        image, uv = getattr(material, "image", None), getattr(mesh.visual, "uv", None)
        image = cover if material is None else image
        if image is not None and (uv is not None or image is cover):
            yield from _textured(triangles, None if uv is None else np.asarray(uv)[mesh.faces], image)
        else:
            color = getattr(material, "diffuse", None)
            yield ColoredPart(triangles, None if color is None else _rgba([float(part) / 255 for part in color]))


def _read_faces(content: bytes) -> tuple[list[list[bytes]], list[list[int]]]:
    """Return the vertices of an OBJ as texts of coordinates, and the indices of each face's vertices.

    ValueError is raised for a missing corner of a face, and for a line that is too long: both would crash PyBullet.
    """
    known = dict.fromkeys((b"v", b"vt", b"vn"), 0)
    vertices: list[list[bytes]] = []
    faces: list[list[int]] = []
    for line in content.replace(b"\r", b"\n").split(b"\n"):
        if len(line) > _MAX_LINE:
            raise ValueError(f"a line has {len(line)} bytes")
        key, *words = line.split() or [b""]
        if key in known:
            known[key] += 1
            if key == b"v":
                vertices.append(words[:3])
        elif key == b"f":
            corners = []
            for word in words:
                for place, (number, count) in enumerate(zip(word.split(b"/"), known.values(), strict=False)):
                    at = int(number or 1) if number[:1] != b"-" else count + 1 + int(number)
                    if number and not 0 < at <= count:
                        raise ValueError(f"the face {line.decode(errors='replace')!r} has a corner that doesn't exist")
                    if not place:
                        corners.append(at - 1)
            faces.append(corners)
    return vertices, faces


def _textured(triangles: Array, uv: Array | None, image: Image.Image | None) -> Iterator[ColoredPart]:
    if image is None:
        yield ColoredPart(triangles, None)
    elif uv is None:
        yield ColoredPart(triangles, mean(image))
    else:
        for some, rgba in bake(triangles, np.asarray(uv, dtype=np.float64)[:, :, :2], image):
            yield ColoredPart(some, rgba)


def _rgba(color: Iterable[float] | None) -> Rgba | None:
    if color is None or isinstance(color, str):
        return None
    red, green, blue, *more = (min(max(float(part), 0.0), 1.0) for part in color)
    alpha = more[0] if more and more[0] > 0 else 1.0  # many exporters write 0 for opaque
    return red, green, blue, alpha


def _check_vertices(file: Path, vertices: Array) -> None:
    if not np.isfinite(vertices).all():
        raise AssetError(file, "has vertices that are not finite numbers")
    if np.abs(vertices).max() > _FAR:
        raise AssetError(file, f"has vertices more than {_FAR:g} away from its origin")


@contextmanager
def _parsing(file: Path) -> Iterator[None]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except Exception as error:  # parsers raise errors of any type for broken files
        raise AssetError(file, f"the file can't be parsed as {file.suffix}: {error}") from error


@contextmanager
def _without_log() -> Iterator[None]:
    log = trimesh.util.log
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def parse(file: Path) -> trimesh.Trimesh:
    """Read a .stl, .obj or .dae file as a single mesh, in metres; raise AssetError for a broken or empty mesh."""
    content = _bytes(file)
    if file.suffix.lower() == ".stl" and not _is_ascii(content):
        _check_binary_stl(file, content)
    if file.suffix.lower() in (".dae", ".obj"):
        corners = _all_triangles(file, content).reshape(-1, 3)
        merged = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
        merged.merge_vertices()
        return merged
    with _parsing(file), _without_log():
        loaded = trimesh.load(io.BytesIO(content), file_type=file.suffix.lower()[1:], force="mesh", process=False)
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise AssetError(file, "has no faces")
    _check_vertices(file, loaded.vertices)
    loaded.merge_vertices()
    return loaded


def convert(file: Path) -> tuple[str, bytes]:
    """Return file name and content of a mesh for the engine; ASCII STL and COLLADA become binary STL.

    AssetError is raised if the file is empty or truncated, has no faces, or has a number that isn't finite.
    """
    content = _bytes(file)
    kind = file.suffix.lower()
    if kind == ".stl" and not _is_ascii(content):
        _check_binary_stl(file, content)
        return file.name, _with_normals(content)
    if kind == ".obj":
        _all_triangles(file, content)
        lines = content.decode("utf-8", "replace").splitlines()
        kept = [line for line in lines if not line.startswith(("mtllib", "usemtl"))]  # the URDF has the colours
        return file.name, ("\n".join(kept) + "\n").encode()
    return f"{file.stem}.stl", stl(parse(file).triangles)


def convert_collision(file: Path) -> tuple[str, bytes]:
    """Return file name and content of a collision mesh for the engine; see :func:`convert`.

    The convex hull replaces a large mesh in one piece, because the engine would compute the hull slowly at each load.
    """
    content = _bytes(file)
    kind = file.suffix.lower()
    if kind == ".obj" and (len(content) <= _LARGE * _STL_FACE.itemsize or _HAS_PIECES.search(content)):
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


def is_convex(shape: trimesh.Trimesh, least: float) -> bool:
    """Return whether a mesh fills at least a share of its convex hull; for an open mesh, areas are compared."""
    hull = shape.convex_hull
    if shape.is_watertight:
        return bool(shape.volume > least * hull.volume)
    return bool(least < shape.area / hull.area < 1 / least)


def is_filled(file: Path) -> bool:
    """Return whether the engine fills the hollow of a collision mesh, because the mesh has only one piece."""
    if file.suffix.lower() == ".obj" and _HAS_PIECES.search(_bytes(file)):
        return False
    return not is_convex(parse(file), _HOLLOW)


def _hull(triangles: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the triangles of the convex hull with outward normals; None for a flat mesh."""
    with needed():
        from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  pictures of recordings work without SciPy

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
    """Return file name, content and colour of each visual part of a mesh; a file without faces has no parts.

    The colour is RGBA 0..1, or None if the file has no colour. ``cover`` is the content of a texture for faces without
    a material; faces without texture coordinates get the texture's mean colour. :func:`convert` lists the errors.
    """
    if file.suffix.lower() not in (".dae", ".obj"):
        image = None if cover is None else read_image(io.BytesIO(cover))
        return [(*convert(file), None if image is None else mean(image))]
    parts = read_parts(file, _bytes(file), cover)
    if file.suffix.lower() == ".obj" and len(parts) == 1:
        return [(*convert(file), parts[0].rgba)]  # the file isn't changed, so its normals remain
    return [(f"{file.stem}-{number}.stl", stl(part.triangles), part.rgba) for number, part in enumerate(parts)]


def check(file: Path) -> None:
    """Raise an AssetError if a mesh of a recording is broken, or is neither a binary STL nor an OBJ."""
    kind = file.suffix.lower()
    if kind == ".stl":
        _check_binary_stl(file, _bytes(file))
    elif kind == ".obj":
        _all_triangles(file, _bytes(file))
    else:
        raise AssetError(file, "the mesh is neither binary STL nor OBJ")


def _all_triangles(file: Path, content: bytes) -> NDArray[np.float64]:
    parts = read_parts(file, content)
    if not parts:
        raise AssetError(file, "has no faces")
    return np.concatenate([part.triangles for part in parts])


def stl_faces(content: bytes) -> NDArray[np.void]:
    """Return the faces (n,) of a complete binary STL; their "numbers" (4, 3) are a normal and three corners."""
    count = struct.unpack("<I", content[_STL_HEADER - 4 : _STL_HEADER])[0]
    return np.frombuffer(content, dtype=_STL_FACE, count=count, offset=_STL_HEADER)


def _bytes(file: Path) -> bytes:
    content = read_bytes(file)
    if not content:
        raise AssetError(file, "the file is empty")
    return content


def _is_ascii(content: bytes) -> bool:
    return content[:5].lower() == b"solid" and b"facet" in content[:1000]


def _check_binary_stl(file: Path, content: bytes) -> None:
    if len(content) < _STL_HEADER:
        raise AssetError(file, f"the file isn't an STL: {len(content)} bytes are less than the header")
    faces = struct.unpack("<I", content[80:84])[0]
    wanted = _STL_HEADER + faces * _STL_FACE.itemsize
    if faces == 0:
        raise AssetError(file, "the STL has no faces")
    if len(content) < wanted:
        raise AssetError(file, f"the STL is truncated: {faces} faces take {wanted} bytes, but it has {len(content)}")
    _check_vertices(file, stl_faces(content)["numbers"])


def _with_normals(content: bytes) -> bytes:
    """Replace the zero normals that many exporters write, because viewers would render the mesh black."""
    table = stl_faces(content).copy()
    numbers = table["numbers"]
    missing = np.abs(numbers[:, 0]).sum(axis=1) < 0.5  # the absolute components of a unit vector have a sum >= 1
    if not missing.any():
        return content
    a, b, c = (numbers[missing, corner].astype(np.float64) for corner in (1, 2, 3))
    normals = np.cross(b - a, c - a)
    numbers[missing, 0] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return bytes(content[:_STL_HEADER] + table.tobytes())


def stl(triangles: Array) -> bytes:
    """Return triangles (n, 3, 3) as a binary STL, which is much faster to read than text."""
    table = np.zeros(len(triangles), dtype=_STL_FACE)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    table["numbers"][:, 0] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    table["numbers"][:, 1:] = triangles
    return bytes(b"\0" * 80 + struct.pack("<I", len(table)) + table.tobytes())
