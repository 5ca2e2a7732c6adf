"""Draw the README's film and the pictures of the gallery, from recordings of the demos: ``make pictures``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import replay
from recorder.records import STEPS_PER_SECOND, Mutation

if TYPE_CHECKING:
    from PIL.Image import Image

    from replay.recording import Recording

FILM = Path(__file__).with_name("set_the_table.gif")
SIZE = (560, 350)
FRAMES = 60
PLAYED = 14.0  # s
EYE, TARGET = (-0.2, -1.6, 3.0), (0.2, 1.0, 0.6)  # m, from above the island's end
KITCHEN = (-2.6, -1.6, 2.8)  # m, the viewpoint of the kitchen


def moments(log: Recording) -> list[float]:
    """Return times of simulation in s, from the first motion to the last one, equally far apart."""
    steps = [change.sim_step for change in log.records(Mutation) if change.HasField("simulate")]
    first, last = steps[0] / STEPS_PER_SECOND, (steps[-1] - 1) / STEPS_PER_SECOND
    return [first + (last - first) * number / (FRAMES - 1) for number in range(FRAMES)]


def frames(log: Recording) -> list[Image]:
    return [log.render(f"{time:.3f}s", eye=EYE, target=TARGET, size=SIZE) for time in moments(log)]


class Shot(NamedTuple):
    """A picture of the gallery."""

    name: str
    command: str
    """What follows ``pycram demo``."""
    moment: str | float
    """A step as `render` takes it, or a part of the recording from 0 to 1."""
    view: str | tuple[float, float, float] | None = None
    """Viewpoint as `render` takes it."""
    camera: str | None = None
    """Frame of the robot whose view is drawn."""


GALLERY = Path(__file__).with_name("gallery")
SHOTS = (
    Shot("pr2", "--robot pr2", 0.5, EYE),
    Shot("tiago_pro", "--robot tiago_pro", 0.5),
    Shot("panda", "--robot panda", 0.5),
    Shot("ur5", "--robot ur5", 0.5),
    Shot("drawer", "breakfast", 0.188, KITCHEN),
    Shot("fridge", "breakfast", 0.375, KITCHEN),
    Shot("island", "breakfast", 0.562, KITCHEN),
    Shot("cleared", "breakfast", 1.0, KITCHEN),
    Shot("fails", "fails_to_reach", "failure"),
    Shot("fails_seen", "fails_to_reach", "failure", camera="wide_stereo_optical_frame"),
    Shot("scattered", "scattered_table", 1.0, EYE),
)


def record(command: str, file: Path) -> None:
    """Run a demo with seed 1; one of them fails on purpose."""
    line = [sys.executable, "-m", "pycram", "demo", *command.split(), "--seed", "1", "--log", str(file)]
    if subprocess.run(line, check=False).returncode not in (0, 1):
        raise SystemExit(f"failed: {' '.join(line)}")


def draw_gallery(folder: Path) -> None:
    GALLERY.mkdir(exist_ok=True)
    for command in dict.fromkeys(shot.command for shot in SHOTS):
        file = folder / f"{command.replace(' ', '_')}.mcap"
        record(command, file)
        with replay.open(file) as log:
            for shot in (shot for shot in SHOTS if shot.command == command):
                step = shot.moment if isinstance(shot.moment, str) else round(shot.moment * (log.final_step() - 1))
                target = TARGET if shot.view else None
                image = log.render(step, camera=shot.camera, eye=shot.view, target=target, size=SIZE)
                image.convert("RGB").quantize(128).save(GALLERY / f"{shot.name}.png", optimize=True)


def draw_film(folder: Path) -> None:
    file = folder / "set_the_table.mcap"
    record("--motion continuous", file)
    with replay.open(file) as log:
        first, *others = [image.convert("RGB").quantize(96) for image in frames(log)]
    first.save(FILM, save_all=True, append_images=others, duration=round(1000 * PLAYED / FRAMES), loop=0, optimize=True)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        draw_gallery(Path(folder))
        draw_film(Path(folder))


if __name__ == "__main__":
    main()
