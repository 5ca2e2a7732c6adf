"""``render``: pictures of steps, without a viewer."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import numbers, print_message, print_moment, print_result
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report.phrases import names

if TYPE_CHECKING:
    from PIL import Image

_NUMBERS: Final = re.compile(r"[-+.,\deE\s]*\d[-+.,\deE\s]*")


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("steps", metavar="STEP", nargs="+", help=f"{HINT}; several pictures have the same viewpoint")
    parser.add_argument(
        "-o", dest="file", metavar="FILE", help="file of the picture, or folder of several (default: LOG_STEP.png)"
    )
    parser.add_argument("--camera", metavar="FRAME", help="view from this frame, such as wide_stereo_optical_frame")
    parser.add_argument(
        "--from",
        dest="eye",
        metavar="X,Y,Z|SIDE",
        help="viewpoint: a point in m, or behind, left, right, front or above the robot (default: a free view)",
    )
    parser.add_argument(
        "--to",
        dest="target",
        metavar="OBJECT[.LINK]|X,Y,Z",
        help="centre of the picture: an object, a link or a point in m (default: the robot and all movable objects)",
    )
    parser.add_argument("--size", metavar="WxH", default="640x480", help="size in pixels (default: 640x480)")
    parser.add_argument("--world", metavar="NAME", help="world of the picture (default: the last opened world)")


def run(log: Recording, options: argparse.Namespace) -> None:
    if options.camera and (options.eye or options.target):
        raise ReplayError("give either --camera, or --from and --to")
    steps = [log.step(step) for step in options.steps]
    width, height = numbers(options.size.lower(), "WIDTHxHEIGHT in pixels, such as 640x480", 2, separator="x", kind=int)
    eye, target, size = _point(options.eye), _point(options.target), (int(width), int(height))
    pictures: Iterator[Image.Image]
    if options.camera or len(steps) == 1:
        pictures = (
            log.render(name, camera=options.camera, eye=eye, target=target, size=size, world=options.world)
            for name in options.steps
        )
    else:
        pictures = log.film(options.steps, eye=eye, target=target, size=size, world=options.world)
    rows: list[dict[str, object]] = []
    for name, step, picture in zip(options.steps, steps, pictures, strict=True):
        shown, cut = picture.info["step"], picture.info["cut"]
        if shown != step:
            print_message(f"no world is open after step {step}; the picture shows the world after step {shown}")
        elif len(steps) == 1:
            print_moment(log, name)
        if cut and not rows:
            print_message(f"left out, because these objects would hide the scene: {names(cut)}")
        title = f"{log.path.stem}_{shown}.png"
        several = len(steps) > 1
        file = Path(options.file or "") / title if several or not options.file else Path(options.file)
        try:
            if several:
                file.parent.mkdir(parents=True, exist_ok=True)
            picture.save(file)
        except (OSError, ValueError) as error:
            raise ReplayError(f"{file}: can't be written: {error}") from error
        rows.append(
            {"step": shown, "file": str(file), "width": picture.width, "height": picture.height, "cut": list(cut)}
        )
    print_result(lambda: rows if len(rows) > 1 else rows[0], [str(row["file"]) for row in rows], as_json=options.json)


def _point(text: str | None) -> list[float] | str | None:
    """Return the point that a text describes; return a name of an object or side unchanged."""
    if text is None or not _NUMBERS.fullmatch(text):
        return text
    return numbers(text, "a point X,Y,Z in m, or the name of an object", 3)
