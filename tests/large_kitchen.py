"""A large kitchen, in the way kitchens are published: a link for each part, and meshes as they come out of CAD programs.

Two rows of cabinets face each other. 150 of their links never move; each cabinet has two drawers with handles. It is
the same in each run. It takes two models as the engine reads no joints of one with more than 128 links.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Final

import numpy as np
import trimesh

from pycram.bullet_world import Object
from recorder import geometry

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.bullet_world import BulletWorld

CABINETS: Final = 4  # side by side along y, in each row
WIDTH: Final = 0.6  # m of each
FRONT: Final = 1.1  # m, x of their fronts, and of the other row's -x
DEPTH: Final = 0.6  # m
TOP: Final = 0.88  # m, height of their worktops
OPEN: Final = 0.45  # m that drawers open

_PANEL: Final = 0.018  # m
Triple = tuple[float, float, float]


class _Writer:
    """Writes links with one shape each.

    Args:
        folder: where meshes go.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.root = ET.Element("robot", name=name)
        self._folder = folder
        ET.SubElement(self.root, "link", name="room")

    def box(self, name: str, size: Triple, at: Triple, parent: str = "room") -> None:
        self._link(name, [("box", {"size": _text(size)})] * 2, at, parent)

    def mesh(self, name: str, fine: trimesh.Trimesh, coarse: trimesh.Trimesh, at: Triple, parent: str = "room") -> None:
        """Add a link that looks fine and collides coarsely."""
        shapes = []
        for role, mesh in (("visual", fine), ("collision", coarse)):
            file = self._folder / f"{self.root.get('name')}.{name}.{role}.stl"
            mesh.export(file)
            shapes.append(("mesh", {"filename": file.name}))
        self._link(name, shapes, at, parent)

    def slide(self, name: str, parent: str, at: Triple) -> None:
        """Add a joint out of the cabinet to a link that is named after it."""
        joint = self._joint(f"{name}_joint", "prismatic", parent, name, at)
        ET.SubElement(joint, "axis", xyz="-1 0 0")
        ET.SubElement(joint, "limit", lower="0", upper=str(OPEN), effort="100", velocity="1")

    def _link(self, name: str, shapes: list[tuple[str, dict[str, str]]], at: Triple, parent: str) -> None:
        link = ET.SubElement(self.root, "link", name=name)
        for role, (kind, about) in zip(("visual", "collision"), shapes, strict=True):
            ET.SubElement(ET.SubElement(ET.SubElement(link, role), "geometry"), kind, about)
        if parent:
            self._joint(f"{name}_fixed", "fixed", parent, name, at)

    def _joint(self, name: str, kind: str, parent: str, child: str, at: Triple) -> ET.Element:
        joint = ET.SubElement(self.root, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "origin", xyz=_text(at), rpy="0 0 0")
        return joint


def furnish(world: BulletWorld, folder: Path) -> None:
    """Fill a world with the kitchen, a floor, and a PR2 with parked arms that stands before the first row."""
    Object("floor", "environment", "plane.urdf", world=world)
    for number, yaw in enumerate((0.0, np.pi)):
        urdf = write_row(folder, f"kitchen_{number}", number)
        Object(f"kitchen_{number}", "environment", urdf, [0, 0, 0], geometry.from_rpy(0, 0, yaw), world=world)
    robot = Object("pr2", "robot", "pr2.urdf", [0.4, 0, 0], world=world)
    world.set_robot(robot)
    for arm in robot.description.arms.values():
        robot.set_joint_positions(arm.posture("park"))
    robot.set_joint_position("torso_lift_joint", 0.2)


def write_row(folder: Path, name: str, seed: int) -> Path:
    """Write the URDF of a row and its meshes; return the URDF."""
    rng = np.random.default_rng(seed)
    writer = _Writer(folder, name)
    middle, long = FRONT + DEPTH / 2, CABINETS * WIDTH
    for part, size, at in (
        ("wall_back", (0.1, long + 2, 2.6), (FRONT + DEPTH + 0.06, 0.0, 1.3)),
        ("wall_left", (2.0, 0.1, 2.6), (1.0, long / 2 + 1, 1.3)),
        ("wall_right", (2.0, 0.1, 2.6), (1.0, -long / 2 - 1, 1.3)),
        ("beam", (0.1, long + 2, 0.1), (0.1, 0.0, 2.55)),
    ):
        writer.box(part, size, at)
    for number in range(CABINETS):
        _cabinet(writer, f"cabinet_{number}", (middle, (number - (CABINETS - 1) / 2) * WIDTH), rng)
    target = folder / f"{name}.urdf"
    ET.indent(writer.root)
    ET.ElementTree(writer.root).write(target)
    return target


def _cabinet(writer: _Writer, name: str, at: tuple[float, float], rng: np.random.Generator) -> None:
    x, y = at
    side, inner = WIDTH / 2 - _PANEL / 2, WIDTH - 2 * _PANEL
    for level, bottom, height, deep in (("base", 0.1, TOP - 0.14, DEPTH), ("wall", 1.45, 0.7, 0.35)):
        back = x + DEPTH / 2
        for part, size, place in (
            ("left", (deep, _PANEL, height), (back - deep / 2, y + side, bottom + height / 2)),
            ("right", (deep, _PANEL, height), (back - deep / 2, y - side, bottom + height / 2)),
            ("back", (_PANEL, inner, height), (back - _PANEL / 2, y, bottom + height / 2)),
            ("bottom", (deep - _PANEL, inner, _PANEL), (back - deep / 2 - _PANEL / 2, y, bottom + _PANEL / 2)),
            ("rail", (0.1, inner, _PANEL), (back - deep + 0.05, y, bottom + height - _PANEL / 2)),
        ):
            writer.box(f"{name}_{level}_{part}", size, place)
    writer.box(f"{name}_plinth", (DEPTH - 0.05, WIDTH, 0.1), (x + 0.025, y, 0.05))
    writer.box(f"{name}_worktop", (DEPTH, WIDTH, 0.04), (x, y, TOP - 0.02))
    writer.box(f"{name}_tiles", (0.01, WIDTH, 0.5), (x + DEPTH / 2 - 0.005, y, TOP + 0.25))
    lamp, bulb = (trimesh.creation.icosphere(subdivisions) for subdivisions in (4, 2))
    for mesh in (lamp, bulb):
        mesh.apply_scale([0.08, 0.08, 0.05])
    writer.mesh(f"{name}_lamp", lamp, bulb, (0.2, y, 2.4))
    jar = trimesh.creation.cylinder(0.05, 0.15 * rng.uniform(0.8, 1.2), sections=500)
    writer.mesh(f"{name}_jar", jar, jar, (x + 0.2, y + 0.2, TOP + 0.09))  # collides as it looks, as many do
    tap = trimesh.creation.torus(0.08, 0.012, major_sections=96, minor_sections=24)
    tap.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    writer.mesh(f"{name}_hook", tap, trimesh.creation.torus(0.08, 0.012, 16, 8), (x + DEPTH / 2 - 0.03, y, TOP + 0.35))
    writer.mesh(
        f"{name}_board",
        trimesh.creation.box((0.02, 0.2, 0.3)).subdivide_loop(4),
        trimesh.creation.box((0.02, 0.2, 0.3)),
        (x + DEPTH / 2 - 0.06, y - 0.15, TOP + 0.16),
    )
    for number, bottom in enumerate((0.15, 0.5)):
        drawer = f"{name}_drawer_{number}"
        front = (_PANEL, WIDTH - 0.004, 0.3)
        writer.box(drawer, front, (0.0, 0.0, 0.0), parent="")
        writer.slide(drawer, f"{name}_base_left", (-DEPTH / 2 - _PANEL, -side, bottom + 0.15 - 0.1 - (TOP - 0.14) / 2))
        writer.box(f"{drawer}_floor", (DEPTH - 0.1, inner - 0.02, _PANEL), (DEPTH / 2 - 0.04, 0.0, -0.12), drawer)
        bar = trimesh.creation.capsule(0.2, 0.008, count=(32, 32))
        bar.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
        bar.apply_translation(-bar.bounds.mean(axis=0))
        writer.mesh(f"{drawer}_handle", bar, bar, (-0.05, 0.0, 0.08), drawer)


def _text(numbers: Triple) -> str:
    return " ".join(f"{float(number):.6g}" for number in numbers)
