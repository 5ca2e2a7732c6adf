"""The log: a line for each record, with its level. Each kind of record has an entity, so that kinds can be hidden.

Lines begin with the step, which is what people type: the viewer's own column of times has room for two digits, and
shows another time line when one is chosen.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import TOPICS
from recorder.records.text import has_line
from recorder.viewer.colors import RED, YELLOW

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Record
    from recorder.viewer.columns import Columns, TimePoint

LOG: Final = "log"
_COLORS: Final = {"ERROR": [RED], "WARN": [YELLOW]}  # of lines; the viewer's own are of the level alone, and dark
_LEVELS: Final = {Log.DEBUG: "DEBUG", Log.INFO: "INFO", Log.WARNING: "WARN", Log.ERROR: "ERROR"}


def numbered(text: str, now: TimePoint) -> str:
    """A text with its step before it."""
    return f"#{now.step} {text}"


class LogLines:
    """The lines of all records."""

    def __init__(self, columns: Columns) -> None:
        self._lines = {kind: columns.series(columns.path(LOG, topic[1:]), _lines) for kind, topic in TOPICS.items()}

    def show(self, record: Record, text: str, level: Log.Level.ValueType, now: TimePoint) -> None:
        """Adds a record's line, if it has one."""
        if has_line(record):
            self._lines[type(record)].add(now, (numbered(text, now), _LEVELS[level]))


def _lines(rows: Sequence[tuple[Any, ...]]) -> list[rr.ComponentColumn]:
    text, levels = zip(*rows, strict=True)
    colors = [_COLORS.get(level, []) for level in levels]
    colored = rr.TextLog.columns(color=[*chain.from_iterable(colors)]).partition([*map(len, colors)])
    return [*rr.TextLog.columns(text=pa.array(text), level=pa.array(levels)), *colored]
