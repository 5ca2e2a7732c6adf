"""Reasoning queries: the last one with its answer and evidence as a page, and what its camera saw as a picture."""

from __future__ import annotations

import colorsys
import zlib
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from recorder.records import format_failure
from recorder.records.text import by_name, values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Picture, Query
    from recorder.viewer.columns import Columns, TimePoint

QUERIES: Final = "queries"
PAGE: Final = "page"
PICTURE: Final = "picture"
_MAX_CLASSES: Final = 60_000  # the viewer's classes are 16 bits
_GOLDEN_RATIO: Final = 0.618034  # steps of hue that keep neighbours apart


class QueryView:
    """Page and picture of the last query."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._page = columns.path(QUERIES, PAGE)
        self._picture = columns.path(QUERIES, PICTURE)
        self._classes: dict[str, int] = {}  # by body; the same in all pictures

    def show(self, record: Query, now: TimePoint) -> None:
        """Shows a query."""
        self._columns.add(self._page, _pages, now, _page(record))
        if record.HasField("picture"):
            self._show_picture(record.picture, now)

    def _show_picture(self, picture: Picture, now: TimePoint) -> None:
        classes = [0, *(self._class(body) for body in picture.bodies)]
        pixels = np.frombuffer(zlib.decompress(picture.pixels), dtype=np.uint8)
        image = np.array(classes, dtype=np.uint16)[pixels].reshape(picture.height, picture.width)
        self._columns.send(self._picture, now, rr.SegmentationImage(image))

    def _class(self, body: str) -> int:
        number = self._classes.get(body)
        if number is None:
            number = self._classes[body] = min(len(self._classes) + 1, _MAX_CLASSES)
            classes = [rr.AnnotationInfo(id=id_, label=name, color=_color(id_)) for name, id_ in self._classes.items()]
            context = rr.AnnotationContext([(0, "nothing near", (0, 0, 0)), *classes])
            self._columns.send_static(self._picture, context)
        return number


def _color(number: int) -> tuple[int, int, int]:
    red, green, blue = colorsys.hsv_to_rgb(number * _GOLDEN_RATIO % 1.0, 0.65, 0.95)
    return round(red * 255), round(green * 255), round(blue * 255)


def _pages(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    text = pa.array([text for (text,) in rows])
    return rr.TextDocument.columns(text=text, media_type=pa.repeat("text/markdown", len(rows)))


def _page(record: Query) -> str:
    raised = f"raised {format_failure(record.failure)}" if record.HasField("failure") else ""
    lines = [
        f"## {record.name}({values(record.arguments)})",
        f"**{raised or by_name(record.answer_json)}**",
        "",
        f"asked at step {record.seq} of {record.world}, took {record.duration_ns / 1e6:.1f} ms",
        "",
        "| evidence | |",
        "|---|---|",
        *[f"| {_cell(fact.name)} | {_cell(by_name(fact.json))} |" for fact in record.evidence[:]],
    ]
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
