"""Hands with one, three or four fingers below a gantry; their jaws slide towards the tool frame's x axis."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tests.pycram.models import gantry

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

OPEN = 0.08  # m that each jaw that moves goes out
TIP = 0.07  # m from the palm to the finger tips
#: Names of the jaws, with their direction from the tool frame's x axis, degrees from y to z, and whether they move.
ONE_JAW = {"jaw": (0.0, True), "anvil": (180.0, False)}
THREE_FINGERS = {"thumb": (0.0, True), "index": (120.0, True), "ring": (240.0, True)}
FOUR_FINGERS = {"a": (0.0, True), "b": (90.0, True), "c": (180.0, True), "d": (270.0, True)}


def write(folder: Path, jaws: Mapping[str, tuple[float, bool]]) -> tuple[Path, str]:
    """Writes the URDF of a gantry with such a hand; returns it, and a description.

    The palm hangs below the column, and turns about it; x of the tool frame points down, y is the palm's.
    """
    urdf = gantry.write(folder)
    lines = []
    for name, (degrees, moves) in jaws.items():
        angle = math.radians(degrees)
        y, z = math.cos(angle), math.sin(angle)  # z of the tool frame is x of the palm
        out = f"{z:.9f} {y:.9f} 0"
        shape = (
            f"<origin xyz='{0.0065 * z:.9f} {0.0065 * y:.9f} {-0.04 - TIP / 2:.6f}' rpy='0 0 {math.atan2(y, z):.9f}'/>"
            f"<geometry><box size='0.01 0.006 {TIP}'/></geometry>"
        )
        kind = "prismatic" if moves else "fixed"
        lines.append(
            f"<link name='{name}'><visual>{shape}</visual><collision>{shape}</collision></link>"
            f"<joint name='{name}_joint' type='{kind}'><parent link='cup'/><child link='{name}'/>"
            f"<axis xyz='{out}'/><limit lower='0' upper='{OPEN}' effort='100' velocity='1'/></joint>"
        )
    urdf.write_text(urdf.read_text().replace("</robot>", "\n".join([*lines, "</robot>"])))
    moving = [name for name, (_, moves) in jaws.items() if moves]
    ways = [0.0, *(OPEN * math.cos(math.radians(jaws[name][0])) for name in moving)]
    turns = [math.radians(degrees) for degrees, _ in jaws.values()]
    low = max((OPEN + 0.0115) * -math.sin(turn) + 0.003 * abs(math.cos(turn)) for turn in turns)
    hand = f"""
[arms.z-axis.gripper]
palm = "cup"
fingers = [{", ".join(f'"{name}"' for name in jaws)}]
joints = [{", ".join(f'"{name}_joint"' for name in moving)}]
closed = 0.0
open = {[OPEN] * len(moving)}
aperture = {max(ways) - min(ways) + 0.003:.4f}
gap = 0.003
depth = 0.03
tips = 0.015
underside = {max(low, 0.02):.4f}
"""
    before, _, _ = gantry.DESCRIPTION.partition("[arms.z-axis.gripper]")
    offset = f"xyz = [0, 0, {-0.04 - TIP + 0.015:.3f}]"
    return urdf, before.replace("xyz = [0, 0, -0.04]", offset) + hand
