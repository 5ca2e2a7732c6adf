"""``show``: one record whole."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from replay.cli.console import print_json, tell
from replay.explain import wording
from replay.explain.step_names import HINT
from replay.state.json_data import kind_of, record_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.recording import Recording
    from replay.state.json_data import Plain

_WIDTH = 100  # characters; longer values are spread over lines


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step."""
    parser.add_argument("step", metavar="STEP", help=HINT)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the record."""
    record = log[log.step(options.step)]
    told = record_data(record)
    if options.json:
        print_json(told)
        return 0
    tell(f"step {record.seq}: {kind_of(record)}: {wording.line(record)}")
    told.pop("step")
    told.pop("kind")
    for line in _lines(told, "  "):
        tell(line)
    return 0


def _lines(value: dict[str, Plain], indent: str) -> Iterator[str]:
    for key, item in value.items():
        short = json.dumps(item, ensure_ascii=False)
        if isinstance(item, str) and "\n" in item:
            yield f"{indent}{key}:"
            yield from (f"{indent}  {line}" for line in item.rstrip().splitlines())
        elif len(short) + len(indent) + len(key) <= _WIDTH or not isinstance(item, dict | list):
            yield f"{indent}{key}: {item if isinstance(item, str) else short}"
        elif isinstance(item, dict):
            yield f"{indent}{key}:"
            yield from _lines(item, indent + "  ")
        else:
            yield f"{indent}{key}:"
            yield from _items(item, indent + "  ")


def _items(values: list[Plain], indent: str) -> Iterator[str]:
    for item in values:
        if isinstance(item, dict):
            first, *others = _lines(item, indent + "  ")
            yield f"{indent}- {first.strip()}"
            yield from others
        else:
            yield f"{indent}- {json.dumps(item, ensure_ascii=False)}"
