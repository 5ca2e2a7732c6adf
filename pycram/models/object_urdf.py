"""The URDF of an object that is a single mesh file.

A bowl would be solid, because PyBullet uses the convex hull of a mesh for collisions. So a concave mesh gets a convex
decomposition: the file ``NAME.collision.obj`` next to the mesh (one ``o`` group per convex piece), else by V-HACD. The
table ``[NAME]`` of the file ``objects.toml`` next to the mesh may contain mass (kg), friction and coloured visual
parts.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.foundation.checks import number
from pycram.foundation.failures import AssetError
from pycram.models import conversion_cache, store
from pycram.models.canonical_urdf import DENSITY, LARGEST
from pycram.models.files import parse_toml, read_text
from pycram.models.mesh import convert, convert_visual, is_convex, parse
from recorder.records import escaped
from recorder.records.values import AssetFile

if TYPE_CHECKING:
    import trimesh

_MIN_CONVEXITY: Final = 0.9  # minimum share of its hull's volume that a convex mesh fills; of the area for open meshes
_GREY: Final = (0.8, 0.8, 0.8, 1.0)


def build(file: Path, color: Sequence[float] | None, scale: float = 1.0) -> bytes:
    """Return the URDF of an object, and store its meshes.

    Args:
        color: RGBA 0..1 of the object; None for the colours of the mesh, or grey if the mesh has no colours.
        scale: Number of metres in the unit of length of the mesh and of the other meshes next to it.

    Raises:
        AssetError: The mesh or a file next to it is broken, or the object is too large for the engine.
    """
    kind = f"object {None if color is None else [float(part) for part in color]}"
    if scale != 1.0:
        kind = f"{kind} scale {scale!r}"
    parts = [file.parent / str(part["mesh"]) for part in _colored(_properties(file)) or ()]
    beside = [_pieces(file), _table(file), *parts]
    *meshes, (_, urdf, _) = conversion_cache.get(kind, file, lambda: [*_files(file, color, scale)], beside)
    for name, content, _ in meshes:
        store.write_mesh(name, content)
    return urdf


def _files(file: Path, color: Sequence[float] | None, scale: float) -> Iterator[tuple[str, bytes, None]]:
    """Yield name and content of the meshes, and then of the URDF.

    The URDF has one link with convex collision shapes, mass, centre of mass and inertia. The keys are names of meshes.
    """
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
    content = str(shape.export(file_type="obj", include_color=False, include_texture=False))
    return content.encode()


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
