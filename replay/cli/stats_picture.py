"""Pictures of how failures ended: the scene at the step at which each began."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

from PIL import Image, ImageDraw

from recorder.packages import NotInstalled
from replay.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.runs.statistics import FailureCause, Statistics

_SIZE: Final = (320, 240)
_COLUMNS: Final = 4
_MAX_PICTURES: Final = 12
_CAPTION: Final = 34  # pixels below a picture
_LETTERS: Final = 52  # in a line of a caption


def picture(folder: Path, run: str, step: int | None) -> Image.Image | None:
    """Return the scene of a run at a step, or at its end; None where nothing can be drawn."""
    with Recording(folder / run) as log:
        try:
            return log.render(log.final_step() if step is None else step, size=_SIZE)
        except NotInstalled:
            raise
        except Exception:  # noqa: BLE001  no world was open, a model is lost: the others are worth more than this one
            return None


def contact_sheet(folder: Path, stats: Statistics) -> bytes:
    """Return a sheet (PNG) with the last moments of failures: of each cause the first ones."""
    chosen = list(_chosen(stats.causes))
    rows = max(1, -(-len(chosen) // _COLUMNS))
    width, height = _SIZE[0], _SIZE[1] + _CAPTION
    sheet = Image.new("RGB", (min(_COLUMNS, max(1, len(chosen))) * width, rows * height), "white")
    draw = ImageDraw.Draw(sheet)
    for at, (cause, run, step) in enumerate(chosen):
        left, top = at % _COLUMNS * width, at // _COLUMNS * height
        drawn = picture(folder, run, step)
        if drawn is not None:
            sheet.paste(drawn.convert("RGB"), (left, top))
        draw.text((left + 4, top + _SIZE[1] + 2), run[:_LETTERS], fill="black")
        draw.text((left + 4, top + _SIZE[1] + 16), cause.cause[:_LETTERS], fill="black")
    if not chosen:
        draw.text((4, 4), "no run failed", fill="black")
    return png(sheet)


def png(image: Image.Image) -> bytes:
    """Return a picture as PNG."""
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def _chosen(causes: tuple[FailureCause, ...]) -> Iterator[tuple[FailureCause, str, int | None]]:
    """Yield the failures that are shown: the first of each cause, then the second of each, and so on."""
    shown = 0
    for at in range(_MAX_PICTURES):
        for cause in causes:
            if at < len(cause.runs) and shown < _MAX_PICTURES:
                shown += 1
                yield cause, cause.runs[at], cause.steps[at]
