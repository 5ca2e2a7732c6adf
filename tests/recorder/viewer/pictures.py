"""The demo's scene as it looks at five moments: golden pictures, and how others are compared with them.

Compared is what is where, in grey and coarse: releases of the viewer differ in what they draw around the scene, in the
size that they leave it, and in the sky. After a change of how things look, draw the golden pictures, and README's,
anew with ``python -m tests.recorder.viewer.pictures``, and look at each.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import replay
from recorder.viewer.connection import free_port
from replay.cli.main import main
from replay.view import convert
from tests.recorder.viewer.conftest import Headless, wait_until

WORLD = "world_1"
MOMENTS = ("pick-up#1@end", "place#1@end", "pick-up#2@end", "place#3@end", "place#4@end")
ROBOT = 2000  # pixels of its blue parts, at least
LIKENESS = 0.99  # between releases it is 0.999
_GOLDEN = Path(__file__).parent / "golden"
_SIZE = (132, 88)
_SKY = 10  # rows of these, at the top
_README = Path(__file__).parents[3] / "docs" / "viewer.png"
_MENU = 36  # pixels above what README shows
_WIDE = 1440


def structure(scene: Image.Image) -> np.ndarray:
    """What is where in the middle of a scene, which the viewer scales by its height."""
    width, height = scene.size
    reach = height * _SIZE[0] / _SIZE[1] / 2
    middle = scene.convert("L").crop((round(width / 2 - reach), 0, round(width / 2 + reach), height))
    return np.asarray(middle.resize(_SIZE, Image.Resampling.BOX), dtype=float)[_SKY:]


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of two pictures: 1 if they are the same but for brightness and contrast."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def golden(moment: str) -> np.ndarray:
    """What is where at one of the moments."""
    with Image.open(_file(moment)) as picture:
        return np.asarray(picture, dtype=float)


def robot_pixels(scene: Image.Image) -> int:
    """Pixels of the PR2's blue parts; nothing else in the kitchen is so blue."""
    red, green, blue = np.asarray(scene, dtype=int).transpose(2, 0, 1)
    return int(((blue > 90) & (red < 40) & (green < 40)).sum())


def _file(moment: str) -> Path:
    return _GOLDEN / f"{moment.replace('#', '_').replace('@', '_')}.png"


def _draw(folder: Path) -> None:
    """Draws the golden pictures, and README's of a failure."""
    viewer = Headless(free_port(0))
    try:
        with replay.open(_recorded("set_the_table", folder)) as log:
            convert([log], folder / "demo.rrd")
            viewer.open(folder / "demo.rrd")
            for moment in MOMENTS:
                viewer.go_to(log.step(f"task:{moment}"))
                scene = _at_rest(viewer, folder, WORLD)
                reduced = Image.fromarray(structure(scene).round().astype(np.uint8))
                reduced.save(_file(moment))
    finally:
        viewer.end()
    viewer = Headless(free_port(0))
    try:
        main(["view", str(_recorded("fails_to_reach", folder)), "--at", "failure", "--connect", viewer.url])
        wait_until(viewer.has_loaded, "it is loaded")
        seen = _at_rest(viewer, folder)
        width, height = seen.size
        seen.crop((0, _MENU, width, height)).resize((_WIDE, round((height - _MENU) * _WIDE / width))).save(_README)
    finally:
        viewer.end()


def _recorded(demo: str, folder: Path) -> Path:
    file = folder / f"{demo}.mcap"
    subprocess.run([sys.executable, "-m", "pycram", "demo", demo, "--log", file], check=False, capture_output=True)
    return file


def _at_rest(viewer: Headless, folder: Path, view: str = "") -> Image.Image:
    """The picture when the robot is there and nothing moves any more."""
    pictures = [viewer.picture(folder / "seen.png", view)]

    def rests() -> bool:
        pictures.append(viewer.picture(folder / "seen.png", view))
        return robot_pixels(pictures[-1]) > ROBOT and pictures[-1] == pictures[-2]

    wait_until(rests, "it rests")
    return pictures[-1]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        _draw(Path(folder))
