"""What a run failed of, in words that are the same for all runs that failed so.

Two failures have one cause if their type, the first pair of links that would have met, and the names of the tasks
around them are the same; where no links are on record, the first line of the message without its numbers. So
coordinates, seeds and numbers of attempts make no two causes of one.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from recorder.records import argument_values
from recorder.records.text import pair_text

if TYPE_CHECKING:
    from recorder.records import Failure

_NUMBER: Final = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
_LIST: Final = re.compile(r"[\[(]#(?:, #)*[\])]")


def without_numbers(text: str) -> str:
    """Return the first line of a text with # for each number, and for each list of numbers."""
    return _LIST.sub("#", _NUMBER.sub("#", text.strip().partition("\n")[0]))


def pairs_of(failure: Failure) -> list[str]:
    """Return the links that would have met, in words, in the order in which they are on record."""
    recorded = argument_values(failure.data).get("pairs") if failure.data else None
    return [pair_text(pair) for pair in recorded if isinstance(pair, dict)] if isinstance(recorded, list) else []


def cause_of(failure: Failure, path: str) -> str:
    """Return what a failure is called together with all others of its cause.

    Args:
        failure: the failure.
        path: names of the tasks in which it began.
    """
    pairs = pairs_of(failure)
    what = pairs[0] if pairs else without_numbers(failure.message)
    where = f" at {without_numbers(path)}" if path else ""
    return f"{failure.type}{where}{f': {what}' if what else ''}"
