"""What the camera of the last reasoning query saw, as an image whose pixels name bodies."""

from __future__ import annotations

import colorsys
import zlib
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from recorder.viewer.query_page import QUERIES

if TYPE_CHECKING:
    from recorder.records import Query
    from recorder.viewer.columns import Columns, TimePoint

PICTURE: Final = "picture"
_MAX_CLASSES: Final = 60_000  # the viewer's classes are 16 bits
MAX_PIXELS: Final = 1 << 24  # of a picture; robots' cameras have a tenth of it
_GOLDEN_RATIO: Final = 0.618034  # steps of hue that keep neighbours apart


class QueryPicture:
    """Picture of the last query that has one."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._path = columns.path(QUERIES, PICTURE)
        self._classes: dict[str, int] = {}  # by body; the same in all pictures

    def show(self, record: Query, now: TimePoint) -> None:
        """Shows a query's picture."""
        if not record.HasField("picture"):
            return
        picture = record.picture
        classes = [0, *(self._class(body) for body in picture.bodies)]
        size = picture.width * picture.height
        if not 0 < size <= MAX_PIXELS:
            raise ValueError(f"a picture of {picture.width} x {picture.height} pixels")
        pixels = np.frombuffer(zlib.decompressobj().decompress(picture.pixels, size), dtype=np.uint8)
        image = np.array(classes, dtype=np.uint16)[pixels].reshape(picture.height, picture.width)
        self._columns.send(self._path, now, rr.SegmentationImage(image))

    def _class(self, body: str) -> int:
        number = self._classes.get(body)
        if number is None:
            number = self._classes[body] = min(len(self._classes) + 1, _MAX_CLASSES)
            classes = [rr.AnnotationInfo(id=id_, label=name, color=_color(id_)) for name, id_ in self._classes.items()]
            context = rr.AnnotationContext([(0, "nothing near", (0, 0, 0)), *classes])
            self._columns.send_static(self._path, context)
        return number


def _color(number: int) -> tuple[int, int, int]:
    red, green, blue = colorsys.hsv_to_rgb(number * _GOLDEN_RATIO % 1.0, 0.65, 0.95)
    return round(red * 255), round(green * 255), round(blue * 255)
