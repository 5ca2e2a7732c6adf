"""Arguments that several verbs take, and how numbers in them are parsed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from replay.errors import ReplayError
from replay.explain.step_names import HINT

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable


def add_step(parser: argparse.ArgumentParser) -> None:
    """Add the positional argument STEP."""
    parser.add_argument("step", metavar="STEP", help=HINT)


def add_world(parser: argparse.ArgumentParser, text: str) -> None:
    """Add the option ``--world``."""
    parser.add_argument("--world", metavar="NAME", help=text)


def numbers(
    text: str, expected: str, *counts: int, separator: str = ",", kind: Callable[[str], float] = float
) -> list[float]:
    """Parse finite numbers.

    Args:
        text: as "0.5,1,0".
        expected: the form that is expected, for the error.
        counts: how many numbers there may be.
        separator: between them.
        kind: float, or int for whole numbers.

    Raises:
        ReplayError: it isn't that.
    """
    try:
        values = [kind(part) for part in text.split(separator)]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise ReplayError(f"{text!r}: expected {expected}")
    return values
