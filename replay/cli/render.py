"""``render``: a picture of a step, without a viewer."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import numbers, print_message, print_moment, print_result
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.report.phrases import names

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording

_NUMBERS: Final = re.compile(r"[-+.,\deE\s]*\d[-+.,\deE\s]*")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, the file, and the viewpoint."""
    parser.add_argument("step", metavar="STEP", help=HINT)
    parser.add_argument("-o", dest="file", metavar="FILE", help="file of the picture (default: LOG_STEP.png)")
    parser.add_argument(
        "--camera", metavar="FRAME", help="draw the view from a frame of the robot, such as wide_stereo_optical_frame"
    )
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
    parser.add_argument("--world", metavar="NAME", help="draw this world (default: the last opened world)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Write the picture and print its name."""
    if options.camera and (options.eye or options.target):
        raise ReplayError("give either --camera, or --from and --to")
    step = log.step(options.step)
    size = numbers(options.size.lower(), "WIDTHxHEIGHT in pixels, such as 640x480", 2, separator="x", kind=int)
    picture = log.render(
        options.step,
        camera=options.camera,
        eye=_point(options.eye),
        target=_point(options.target),
        size=(int(size[0]), int(size[1])),
        world=options.world,
    )
    shown, cut = picture.info["step"], picture.info["cut"]
    if shown != step:
        print_message(
            f"no world is open after step {step}; the picture shows step {shown}, the last step with an open world"
        )
    else:
        print_moment(log, options.step)
    if cut:
        print_message(f"not drawn, because they would hide the scene: {names(cut)}")
    file = Path(options.file or f"{log.path.stem}_{shown}.png")
    try:
        picture.save(file)
    except (OSError, ValueError) as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error
    data = {"step": shown, "file": str(file), "width": picture.width, "height": picture.height, "cut": list(cut)}
    print_result(lambda: data, [str(file)], as_json=options.json)
    return 0


def _point(text: str | None) -> list[float] | str | None:
    """Return a point, or the name of an object or a side."""
    if text is None or not _NUMBERS.fullmatch(text):
        return text
    return numbers(text, "a point X,Y,Z in m, or the name of an object", 3)
