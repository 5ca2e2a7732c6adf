"""``render``: a picture of a step, without a viewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from replay.cli.arguments import add_step, numbers
from replay.cli.console import print_result
from replay.errors import ReplayError

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, the file, and the viewpoint."""
    add_step(parser)
    parser.add_argument("-o", dest="file", metavar="FILE", help="the picture (default: LOG_STEP.png in this folder)")
    parser.add_argument("--camera", metavar="FRAME", help="a frame of the robot, as wide_stereo_optical_frame")
    parser.add_argument("--from", dest="eye", metavar="X,Y,Z", help="viewpoint, m (default: from the side)")
    parser.add_argument("--to", dest="target", metavar="X,Y,Z", help="point to look at, m (default: what can move)")
    parser.add_argument("--size", metavar="WxH", default="640x480", help="in pixels (default: 640x480)")
    parser.add_argument("--world", metavar="NAME", help="of this world (default: the one opened last)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Write the picture and print its name."""
    if options.camera and (options.eye or options.target):
        raise ReplayError("a picture is taken by a camera, or from a point to a point; give one of both")
    step = log.step(options.step)
    file = Path(options.file or f"{log.path.stem}_{step}.png")
    size = numbers(options.size.lower(), "WIDTHxHEIGHT in pixels, as 640x480", 2, separator="x", kind=int)
    picture = log.render(
        step,
        camera=options.camera,
        eye=_point(options.eye),
        target=_point(options.target),
        size=(int(size[0]), int(size[1])),
        world=options.world,
    )
    try:
        picture.save(file)
    except (OSError, ValueError) as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error
    data = {"step": step, "file": str(file), "width": picture.width, "height": picture.height}
    print_result(lambda: data, [str(file)], as_json=options.json)
    return 0


def _point(text: str | None) -> list[float] | None:
    return None if text is None else numbers(text, "a point X,Y,Z in m", 3)
