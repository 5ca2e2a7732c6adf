"""Parts of a mesh: its triangles by colour, with the materials and textures of COLLADA and OBJ files.

COLLADA files are read by pycollada directly: what trimesh does to them besides takes three times as long. OBJ files of
triangles without materials, as all are that recordings hold, are read here: to import trimesh takes a second.
"""

from __future__ import annotations

import io
import struct
import warnings
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pycram.foundation.failures import AssetError
from pycram.models import texture
from pycram.models.lazy_module import LazyModule
from recorder.packages import needed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    import collada
    import trimesh
    from numpy.typing import NDArray
    from PIL import Image

    Array = NDArray[np.float64]
    Rgba = tuple[float, float, float, float]
else:
    with needed("executor"):
        collada, trimesh, Image = (LazyModule(name) for name in ("collada", "trimesh", "PIL.Image"))

STL_HEADER: Final = 84
STL_FACE: Final = np.dtype([("numbers", "<f4", (4, 3)), ("attribute", "<u2")])
_MAX_COORDINATE: Final = 1e4  # m; larger ones are not in metres
_MAX_LINE: Final = 8000  # bytes of a line of OBJ; PyBullet reads 8,192 at once


class Part(NamedTuple):
    """Triangles of one colour.

    Attributes:
        triangles: (n, 3, 3) corners in the mesh's frame, m.
        rgba: Their colour, 0..1; None where the file gives none.
    """

    triangles: Array
    rgba: Rgba | None


@contextmanager
def quiet() -> Iterator[None]:
    """Keep warnings and logged tracebacks of mesh libraries off the plan's output: errors are raised as AssetError."""
    log = trimesh.util.log
    before, log.disabled = log.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.disabled = before


@lru_cache(maxsize=2)  # most models collide with what is seen of them, which is asked for next
def read_parts(file: Path, content: bytes, cover: bytes | None = None) -> tuple[Part, ...]:
    """Return the parts of a .dae or .obj file that have triangles, those of one colour together.

    Args:
        file: Where it is, for textures and materials beside it.
        content: What it contains.
        cover: The texture's content, of what has no material of its own.

    Raises:
        AssetError: It can't be parsed, or a number isn't finite or too large for metres.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = None if cover is None else read_image(io.BytesIO(cover))
            found = list((_dae if file.suffix.lower() == ".dae" else _obj)(file, content, image))
    except Exception as error:  # the parsers raise whatever goes wrong in them
        raise AssetError(file, f"can't be parsed as {file.suffix}: {error}") from error
    by_color: dict[Rgba | None, list[Array]] = {}
    for triangles, rgba in found:
        if len(triangles):
            by_color.setdefault(rgba, []).append(triangles)
    parts = tuple(Part(np.concatenate(triangles), rgba) for rgba, triangles in by_color.items())
    for part in parts:
        check_vertices(file, part.triangles)
    return parts


def check_vertices(file: Path, vertices: Array) -> None:
    """Refuse corners that aren't finite, or too large for metres."""
    if not np.isfinite(vertices).all():
        raise AssetError(file, "has vertices that are not finite numbers")
    if np.abs(vertices).max() > _MAX_COORDINATE:
        raise AssetError(file, f"has vertices more than {_MAX_COORDINATE:g} m away from its origin")


def stl(triangles: Array) -> bytes:
    """Return a binary STL of triangles (n, 3, 3): every reader here takes it many times as fast as text."""
    table = np.zeros(len(triangles), dtype=STL_FACE)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    table["numbers"][:, 0] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    table["numbers"][:, 1:] = triangles
    content: bytes = b"\0" * 80 + struct.pack("<I", len(table)) + table.tobytes()
    return content


def _dae(file: Path, content: bytes, cover: Image.Image | None) -> Iterator[Part]:
    """As ROS reads them: in the file's unit of length, whichever axis it says is up."""
    document = collada.Collada(io.BytesIO(content), ignore=[collada.common.DaeError])
    unit = document.assetInfo.unitmeter or 1.0
    for geometry in document.scene.objects("geometry") if document.scene else ():
        for primitive in geometry.primitives():
            mesh = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
            if not isinstance(mesh, collada.triangleset.BoundTriangleSet) or mesh.vertex is None or not len(mesh):
                continue  # lines
            triangles = np.asarray(mesh.vertex[mesh.vertex_index], dtype=np.float64) * unit
            diffuse = getattr(getattr(mesh.material, "effect", None), "diffuse", None)
            if isinstance(diffuse, collada.material.Map):
                image = read_image(file.parent / _path(diffuse.sampler.surface.image.path))
                yield from _textured(triangles, _dae_uv(mesh) if image else None, image)
            elif diffuse is None and cover is not None:
                yield from _textured(triangles, _dae_uv(mesh), cover)
            else:
                yield Part(triangles, _rgba(diffuse))


def _read_faces(content: bytes) -> tuple[list[list[bytes]], list[list[int]]]:
    """Return the numbers of an OBJ's vertices, as text, and for each face its vertices, counted from 0.

    Raises:
        ValueError: A face has a corner that isn't there, or a line is one that PyBullet breaks in two: either would end
            the process.
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
                        raise ValueError(f"the face {line.decode(errors='replace')!r} has a corner that isn't there")
                    if not place:
                        corners.append(at - 1)
            faces.append(corners)
    return vertices, faces


def _dae_uv(mesh: collada.triangleset.BoundTriangleSet) -> Array | None:
    return mesh.texcoordset[0][mesh.texcoord_indexset[0]] if mesh.texcoordset else None


def _obj(file: Path, content: bytes, cover: Image.Image | None) -> Iterator[Part]:
    vertices, faces = _read_faces(content)
    if cover is None and b"mtl" not in content and all(len(corners) == 3 for corners in faces):
        if any(len(numbers) < 3 for numbers in vertices):
            raise ValueError("a vertex has less than three numbers")
        table = np.array(vertices).astype(np.float64).reshape(-1, 3)
        yield Part(table[np.array(faces, dtype=np.intp).reshape(-1, 3)], None)
        return
    has_materials = b"mtllib" in content
    resolver = trimesh.resolvers.FilePathResolver(str(file))
    with quiet():
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
            yield Part(triangles, None if color is None else _rgba([float(part) / 255 for part in color]))


def _textured(triangles: Array, uv: Array | None, image: Image.Image | None) -> Iterator[Part]:
    if image is None:
        yield Part(triangles, None)
    elif uv is None:
        yield Part(triangles, mean(image))
    else:
        for some, rgba in texture.bake(triangles, np.asarray(uv, dtype=np.float64)[:, :, :2], image):
            yield Part(some, rgba)


def mean(image: Image.Image) -> Rgba:
    """Return the mean colour of a picture, for what doesn't say where it is in it."""
    red, green, blue = np.asarray(image.convert("RGB"), dtype=np.float64).reshape(-1, 3).mean(axis=0) / 255
    return float(red), float(green), float(blue), 1.0


def _path(name: str) -> str:
    return name.removeprefix("file://").replace("%20", " ")


def read_image(source: Path | io.BytesIO) -> Image.Image | None:
    """Return a texture; None if it isn't there, as in many published models, or no picture."""
    try:
        image = Image.open(source)
        image.load()
    except OSError:
        return None
    return image


def _rgba(color: Iterable[float] | None) -> Rgba | None:
    if color is None or isinstance(color, str):
        return None
    red, green, blue, *more = (min(max(float(part), 0.0), 1.0) for part in color)
    alpha = more[0] if more and more[0] > 0 else 1.0  # many exporters write 0 for opaque
    return red, green, blue, alpha
