"""``sql``: execute an SQL statement on the tables of a folder of recordings."""

from __future__ import annotations

import argparse
import csv
import sys
from decimal import Decimal
from typing import TYPE_CHECKING, Any, Final

from replay.cli.console import print_json_list, print_text, visible
from replay.errors import ReplayError
from replay.report.phrases import plural
from replay.runs.schema import RUN, TABLES

if TYPE_CHECKING:
    from replay.runs.folder import Answer, Runs

_WIDEST: Final = 60  # number of characters above which a cell is shortened
_NUMBERS: Final = frozenset({int, float, Decimal, type(None)})  # types of the values in a column of numbers


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "The statement must be a query (DuckDB's SQL). --schema prints the tables and their columns."
    parser.add_argument("statement", metavar="SQL", nargs="?", help='"select outcome, count(*) from runs group by 1"')
    parser.add_argument("--schema", action="store_true", help="print the tables and their columns")
    parser.add_argument("--csv", action="store_true", help="print CSV with untruncated values")


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    if (options.statement is None) != options.schema:
        raise ReplayError('give a statement, such as "select * from runs", or --schema for the tables')
    if options.schema:
        _print_schema(as_json=options.json)
        return
    answer = runs.sql(options.statement)
    if options.json:
        print_json_list(dict(zip(answer.columns, map(_plain, row), strict=True)) for row in answer.rows())
    elif options.csv:
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(answer.columns)
        writer.writerows([_text(value) for value in row] for row in answer.rows())
    else:
        print_text("\n".join(_lines(answer)))


def _print_schema(*, as_json: bool) -> None:
    if as_json:
        print_json_list(
            {"table": table.name, "column": column.name, "kind": column.kind, "meaning": column.meaning}
            for table in TABLES
            for column in (RUN, *table.columns)
        )
        return
    lines = []
    for table in TABLES:
        lines += [f"{table.name}: each row is {table.meaning}"]
        lines += [f"  {column.name:12} {column.kind:7} {column.meaning}".rstrip() for column in (RUN, *table.columns)]
    print_text("\n".join(lines))


def _lines(answer: Answer) -> list[str]:
    texts = ((_text(value).replace("\n", " ").replace("\t", " ") for value in row) for row in answer.rows())
    rows = [[visible(text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}...") for text in row] for row in texts]
    widths = [max([len(name), *(len(row[at]) for row in rows)]) for at, name in enumerate(answer.columns)]
    numbers = [bool(rows) and {type(row[at]) for row in answer.rows()} <= _NUMBERS for at in range(len(widths))]
    lines = []
    for cells in (answer.columns, ["-" * width for width in widths], *rows):
        aligned = (
            f"{cell:>{width}}" if number else f"{cell:{width}}"
            for cell, width, number in zip(cells, widths, numbers, strict=True)
        )
        lines.append("  ".join(aligned).rstrip())
    return [*lines, f"({plural(len(rows), 'row')})"]


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float | Decimal):
        return f"{value:.6g}"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list) and all(isinstance(each, tuple) for each in value):
        return ", ".join(f"{key}={item}" for key, item in value)
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        pairs = value and all(isinstance(each, tuple) for each in value)
        return dict(value) if pairs else [_plain(each) for each in value]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Decimal):
        return float(value)
    return value if isinstance(value, bool | int | float | str | None) else str(value)
