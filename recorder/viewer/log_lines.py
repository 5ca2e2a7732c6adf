"""What happened, a line each, with levels; one entity for each kind of record, so that kinds can be hidden.

Lines begin with the step, which is what people type: the viewer's own column of times has room for two digits, and
tells another time line when one is chosen.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import TOPICS
from recorder.records.text import has_line
from recorder.viewer.marks import RED, YELLOW

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Record
    from recorder.viewer.columns import Columns, Moment

LOG: Final = "log"
_COLORS: Final = {"ERROR": [RED], "WARN": [YELLOW]}  # of lines; the viewer's own are of the level alone, and dark
_LEVELS: Final = {Log.DEBUG: "DEBUG", Log.INFO: "INFO", Log.WARNING: "WARN", Log.ERROR: "ERROR"}


class Lines:
    """The log.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._lines = {kind: columns.series(columns.path(LOG, topic[1:]), _texts) for kind, topic in TOPICS.items()}

    def show(self, record: Record, text: str, level: Log.Level.ValueType, now: Moment) -> None:
        """Shows a record's line, where there is something to say.

        Args:
            record: the record.
            text: what it tells; see :func:`recorder.records.text.text_of`.
            level: how grave that is.
            now: when.
        """
        if has_line(record):
            self._lines[type(record)].add(now, (numbered(text, now), _LEVELS[level]))


def numbered(text: str, now: Moment) -> str:
    """A line of the log.

    Args:
        text: what happened.
        now: when.
    """
    return f"#{now.step} {text}"


def _texts(rows: Sequence[tuple[Any, ...]]) -> list[rr.ComponentColumn]:
    text, level = zip(*rows, strict=True)
    colors = [_COLORS.get(one, []) for one in level]
    colored = rr.TextLog.columns(color=[*chain.from_iterable(colors)]).partition([*map(len, colors)])
    return [*rr.TextLog.columns(text=pa.array(text), level=pa.array(level)), *colored]
