"""The rows of a recording as its own process leaves them, for readers of its folder.

The process that made a recording calls :func:`write_rows`; readers make the rows of all others. They lie in one file,
the tables one after the other, until readers merge them into the folder's tables (:mod:`replay.runs.folder`).
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

import pyarrow as pa

from replay.file.record_reader import RecordReader
from replay.runs.record_rows import tables_of
from replay.runs.schema import TABLES, VERSION, arrow_schema

if TYPE_CHECKING:
    import os
    from pathlib import Path

FOLDER: Final = "tables"
"""Where the tables of a folder of recordings lie, beside the recordings."""
NEW: Final = "new"
"""Where the rows of recordings lie in it until they are merged."""
_PACKED: Final = pa.ipc.IpcWriteOptions(compression="lz4", use_threads=False)  # the system's processors have runs to do


def write_rows(path: Path) -> None:
    """Write the rows of a recording that has its name and is whole, for readers of its folder.

    Raises:
        ReplayError: it can't be read.
        OSError: the rows can't be written.
    """
    with RecordReader(path) as log:
        tables = tables_of(log)
        state = path.stat()
    rows, partial = written_rows(path), partial_rows(path)
    rows.parent.mkdir(parents=True, exist_ok=True)
    try:
        with partial.open("wb") as file:
            for name, table in tables.items():
                marked = table.replace_schema_metadata(_marks(name, state))
                with pa.ipc.new_stream(file, marked.schema, options=_PACKED) as stream:
                    stream.write_table(marked)
        with suppress(FileNotFoundError):  # a reader that was faster has removed it
            partial.replace(rows)
    finally:
        partial.unlink(missing_ok=True)


def read_rows(path: Path, state: os.stat_result) -> dict[str, pa.Table] | None:
    """Return the rows that the process of a recording wrote; None if there are none, or not of the file as it is.

    Args:
        path: the recording.
        state: what the system says of its file.
    """
    tables = {}
    with suppress(OSError, pa.ArrowInvalid), written_rows(path).open("rb") as file:
        for table in TABLES:
            with pa.ipc.open_stream(file) as stream:
                rows = stream.read_all()
            marks = {key.decode(): value.decode() for key, value in (rows.schema.metadata or {}).items()}
            if marks != _marks(table.name, state) or not rows.schema.equals(arrow_schema(table)):
                return None
            tables[table.name] = rows.replace_schema_metadata(None)
    return tables if len(tables) == len(TABLES) else None


def written_rows(path: Path) -> Path:
    """Return where the rows of a recording lie that its own process wrote."""
    return path.parent / FOLDER / NEW / f"{path.name}.arrows"


def partial_rows(path: Path) -> Path:
    """Return where they lie while they are written, and stay if that is killed."""
    rows = written_rows(path)
    return rows.with_name(f".{rows.name}")


def _marks(table: str, state: os.stat_result) -> dict[str, str]:
    """Return what says of which recording rows are, and that they are these tables'."""
    return {"table": table, "version": str(VERSION), "file": f"{state.st_size} {state.st_mtime_ns}"}
