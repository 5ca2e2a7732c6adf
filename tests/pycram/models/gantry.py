"""A robot very different from a PR2: a gantry that slides along x, y and z and turns, with a suction cup."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

BOX = "<{role}><origin xyz='{xyz}'/><geometry><box size='{size}'/></geometry></{role}>"
PARTS = (
    ("frame", "", "", "0 0 1.6", "0.04 1.2 0.04", ""),
    ("bridge", "frame", "prismatic", "0 0 0", "0.04 0.04 0.04", "1 0 0"),
    ("carriage", "bridge", "prismatic", "0 0 0", "0.05 0.05 0.05", "0 1 0"),
    ("column", "carriage", "prismatic", "0 0 0.25", "0.02 0.02 0.5", "0 0 -1"),
    ("cup", "column", "continuous", "0 0 -0.02", "0.03 0.03 0.04", "0 0 1"),
)
DESCRIPTION = """
robot = "gantry"
base_link = "frame"
drives = false

[arms.z-axis]
base_link = "frame"
tool_frame = "cup"
tool_offset = { xyz = [0, 0, -0.04], rpy = [0, 1.5707963267948966, 0] }
joints = ["bridge_joint", "carriage_joint", "column_joint", "cup_joint"]

[arms.z-axis.poses]
park = [0.0, 0.0, 0.0, 0.0]

[arms.z-axis.gripper]
palm = "cup"
suction = 0.012
underside = 0.02
"""


def write(folder: Path) -> Path:
    """Writes its URDF."""
    lines = ["<robot name='gantry'>"]
    for name, parent, kind, xyz, size, axis in PARTS:
        shapes = "".join(BOX.format(role=role, xyz=xyz, size=size) for role in ("visual", "collision"))
        lines.append(f"<link name='{name}'>{shapes}</link>")
        if parent:
            origin = "0 0 1.6" if parent == "frame" else "0 0 0"
            lines.append(
                f"<joint name='{name}_joint' type='{kind}'><parent link='{parent}'/><child link='{name}'/>"
                f"<origin xyz='{origin}'/><axis xyz='{axis}'/>"
                "<limit lower='-0.9' upper='1.5' effort='1' velocity='1'/></joint>"
            )
    file = folder / "gantry.urdf"
    file.write_text("\n".join([*lines, "</robot>"]))
    return file
