"""``export``: what a recording has, as a table for other programs."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Final, get_type_hints

from replay.cli.console import print_message, print_result
from replay.errors import ReplayError
from replay.state.motion_table import Row, rows

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable

    from replay.recording import Recording

_FORMATS: Final = ("csv", "parquet")


def add(parser: argparse.ArgumentParser) -> None:
    """Add what to export, and where to."""
    parser.add_argument(
        "--trajectories",
        action="store_true",
        required=True,
        help="where each joint and base was to be, and where it was: a row a moment",
    )
    parser.add_argument("-o", dest="file", metavar="FILE", help="the table (default: CSV to standard output)")
    parser.add_argument("--format", choices=_FORMATS, help="of the file (default: by its name's end, else csv)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Write the table."""
    suffix = Path(options.file or "").suffix.removeprefix(".")
    form = options.format or (suffix if suffix in _FORMATS else "csv")
    if form == "parquet" and options.file is None:
        raise ReplayError("a Parquet table needs a file: -o FILE.parquet")
    table = list(rows(log))
    if not table:
        print_message(f"{log.path}: nothing followed a trajectory")
    if options.file is None:
        print_result(lambda: [row._asdict() for row in table], _csv(table).splitlines(), as_json=options.json)
        return 0
    try:
        if form == "parquet":
            _write_parquet(table, options.file)
        else:
            Path(options.file).write_text(_csv(table), encoding="utf-8")
    except OSError as error:
        raise ReplayError(f"{options.file}: can't be written: {error}") from error
    data = {"file": options.file, "format": form, "rows": len(table)}
    print_result(lambda: data, [f"{options.file}: {len(table)} rows"], as_json=options.json)
    return 0


def _csv(table: Iterable[Row]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row._fields)
    writer.writerows(table)
    return text.getvalue()


def _write_parquet(table: list[Row], file: str) -> None:
    import pyarrow as pa  # noqa: PLC0415  comes with the viewer, and is slow to import
    from pyarrow import parquet  # noqa: PLC0415

    kinds = {str: pa.string(), int: pa.int64()}
    schema = pa.schema([(name, kinds.get(kind, pa.float64())) for name, kind in get_type_hints(Row).items()])
    parquet.write_table(pa.Table.from_pylist([row._asdict() for row in table], schema), file)
