"""``show``: one whole record."""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Final

from replay.cli.arguments import add_step
from replay.cli.console import print_result
from replay.report import phrases
from replay.state.json_data import kind_of, record_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from recorder.records import Plain
    from replay.recording import Recording

_WIDTH: Final = 100  # characters; longer values are printed on several lines
_MAX_IN_LINE: Final = 12  # numbers; more are printed in rows
_MANY: Final = 100  # numbers that are printed
_ENDS: Final = 18  # of more than that, which are printed at each end


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step."""
    add_step(parser)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the record."""
    record = log[log.step(options.step)]
    fields = record_data(record)
    further = {key: item for key, item in fields.items() if key not in ("step", "kind")}
    lines = [f"step {record.seq}: {kind_of(record)}: {phrases.record_line(record)}", *_lines(further, "  ")]
    print_result(lambda: fields, lines, as_json=options.json)
    return 0


def _lines(fields: dict[str, Plain], indent: str) -> Iterator[str]:
    for key, item in fields.items():
        short = json.dumps(item, ensure_ascii=False)
        if isinstance(item, str) and "\n" in item:
            yield f"{indent}{key}:"
            yield from (f"{indent}  {line}" for line in item.rstrip().splitlines())
        elif len(short) + len(indent) + len(key) <= _WIDTH or not isinstance(item, dict | list):
            yield f"{indent}{key}: {item if isinstance(item, str) else short}"
        else:
            yield f"{indent}{key}:"
            yield from _lines(item, indent + "  ") if isinstance(item, dict) else _items(item, indent + "  ")


def _items(values: list[Plain], indent: str) -> Iterator[str]:
    if len(values) > _MAX_IN_LINE and all(isinstance(item, float | int) for item in values):
        yield from (f"{indent}{line}" for line in _numbers([json.dumps(item) for item in values]))
        return
    for item in values:
        if isinstance(item, dict) and item:
            first, *rest = _lines(item, indent + "  ")
            yield f"{indent}- {first.strip()}"
            yield from rest
        else:
            yield f"{indent}- {json.dumps(item, ensure_ascii=False)}"


def _numbers(texts: list[str]) -> Iterator[str]:
    """Numbers in rows; of very many, as of a trajectory, the first and last."""
    if len(texts) <= _MANY:
        yield from textwrap.wrap(", ".join(texts), _WIDTH)
        return
    yield from textwrap.wrap(", ".join(texts[:_ENDS]), _WIDTH)
    yield f"... {len(texts) - 2 * _ENDS} more, all with --json"
    yield from textwrap.wrap(", ".join(texts[-_ENDS:]), _WIDTH)
