"""Files: the same numbers give files with the same bytes, on any machine.

Coordinates are rounded to a micrometre, so that the last bit of a cosine makes no difference.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from make.solids import Points, Solid
    from make.thing import Thing

DIGITS = 6


def stl(solid: Solid) -> bytes:
    """Binary STL, metres."""
    corners = _rounded(solid.vertices)[solid.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    kept = lengths[:, 0] > 0.0
    facets = np.zeros(int(kept.sum()), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
    facets["normal"] = _rounded(normals[kept] / lengths[kept])
    facets["corners"] = corners[kept]
    return b"binary STL, metres".ljust(80) + len(facets).to_bytes(4, "little") + facets.tobytes()


def obj(pieces: Sequence[Solid]) -> str:
    """Wavefront OBJ, metres, one group ``part_k`` for each piece."""
    lines = ["# Convex pieces, metres."]
    count = 1
    for k, piece in enumerate(pieces):
        lines.append(f"o part_{k}")
        lines += ["v " + " ".join(number(value) for value in vertex) for vertex in _rounded(piece.vertices)]
        lines += ["f " + " ".join(str(index) for index in face) for face in (piece.faces + count).tolist()]
        count += len(piece.vertices)
    return "\n".join(lines) + "\n"


def number(value: float, digits: int = DIGITS) -> str:
    """The shortest text of a rounded number, by default to a micrometre or microradian; never ``-0``."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in {"-0", ""} else text


def objects_table(things: Sequence[Thing]) -> str:
    """The TOML table of all things: mass in kg, friction coefficient, visible parts with their colours."""
    lines = [
        "# Written by make_resources.py: one table for each NAME.stl in this folder.",
        "# mass in kilograms; rgba is red, green, blue, alpha from 0 to 1.",
    ]
    for thing in things:
        lines += ["", f"[{thing.name}]", f"mass = {thing.mass:.3f}", f"friction = {thing.friction:.2f}", "visual = ["]
        for part in thing.parts:
            colour = ", ".join(f"{value:.2f}" for value in (*part.colour, 1.0))
            lines.append(f'    {{ mesh = "parts/{thing.name}.{part.name}.stl", rgba = [{colour}] }},')
        lines.append("]")
    return "\n".join(lines) + "\n"


def write_things(things: Sequence[Thing], folder: Path) -> None:
    """Write all files of the things into a folder that exists."""
    (folder / "parts").mkdir(exist_ok=True)
    for thing in things:
        (folder / f"{thing.name}.stl").write_bytes(stl(thing.solid))
        write_text(folder / f"{thing.name}.collision.obj", obj(thing.pieces))
        for part in thing.parts:
            (folder / "parts" / f"{thing.name}.{part.name}.stl").write_bytes(stl(part.solid))
    write_text(folder / "objects.toml", objects_table(things))


def write_text(path: Path, text: str) -> None:
    """Write text with unix line ends on any platform."""
    path.write_bytes(text.encode("utf-8"))


def _rounded(points: Points) -> Points:
    rounded: Points = np.round(points, DIGITS) + 0.0
    return rounded
