"""Draw the README's animated picture, from a recording with motions in simulated time: ``make pictures``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

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


def moments(log: Recording) -> list[float]:
    """Return times of simulation in s, from the first motion to the last one, equally far apart."""
    steps = [change.sim_step for change in log.records(Mutation) if change.HasField("simulate")]
    first, last = steps[0] / STEPS_PER_SECOND, (steps[-1] - 1) / STEPS_PER_SECOND
    return [first + (last - first) * number / (FRAMES - 1) for number in range(FRAMES)]


def frames(log: Recording) -> list[Image]:
    return [log.render(f"{time:.3f}s", eye=EYE, target=TARGET, size=SIZE) for time in moments(log)]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "set_the_table.mcap"
        command = [sys.executable, "-m", "pycram", "demo", "--motion", "continuous", "--seed", "1", "--log", str(file)]
        subprocess.run(command, check=True)
        with replay.open(file) as log:
            first, *others = [image.convert("RGB").quantize(96) for image in frames(log)]
    first.save(FILM, save_all=True, append_images=others, duration=round(1000 * PLAYED / FRAMES), loop=0, optimize=True)


if __name__ == "__main__":
    main()
