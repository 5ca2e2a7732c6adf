"""``render``: a picture of a step, without a viewer."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from replay.cli.console import print_json, results_only, tell
from replay.errors import ReplayError
from replay.explain.step_names import HINT

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step, the file, and where to look from."""
    parser.add_argument("step", metavar="STEP", help=HINT)
    parser.add_argument("-o", dest="file", metavar="FILE", help="the picture (default: LOG_STEP.png in this folder)")
    parser.add_argument("--camera", metavar="FRAME", help="a frame of the robot, as wide_stereo_optical_frame")
    parser.add_argument("--from", dest="eye", metavar="X,Y,Z", help="where to look from, m (default: from the side)")
    parser.add_argument("--to", dest="target", metavar="X,Y,Z", help="where to look, m (default: at what moves)")
    parser.add_argument("--size", metavar="WxH", default="640x480", help="in pixels (default: 640x480)")
    parser.add_argument("--world", metavar="NAME", help="of this world (default: the one opened last)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Writes the picture and prints its name."""
    from replay.restore.render import render  # noqa: PLC0415  --help needn't wait for the engine

    if options.camera and (options.eye or options.target):
        raise ReplayError("a picture is taken by a camera, or from a point to a point; give one of both")
    step = log.step(options.step)
    file = Path(options.file or f"{log.path.stem}_{step}.png")
    with results_only():
        picture = render(
            log,
            step,
            camera=options.camera,
            eye=_point(options.eye),
            target=_point(options.target),
            size=_size(options.size),
            world=options.world,
        )
    try:
        picture.save(file)
    except (OSError, ValueError) as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error
    if options.json:
        told = {"step": step, "file": str(file), "width": picture.width, "height": picture.height}
        print_json(told)
    else:
        tell(str(file))
    sys.stdout.flush()
    return 0


def _point(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ReplayError(f"{text!r} is no point; it takes X,Y,Z in m") from None


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ReplayError(f"{text!r} is no size; it takes WIDTHxHEIGHT in pixels, as 640x480") from None
    return width, height
