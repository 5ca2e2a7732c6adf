"""Arguments that several verbs take, and how numbers in them are parsed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from replay.cli.console import print_message
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.report.phrases import sampled

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from replay.recording import Recording


def add_step(parser: argparse.ArgumentParser) -> None:
    """Add the positional argument STEP."""
    parser.add_argument("step", metavar="STEP", help=HINT)


def print_moment(log: Recording, step: str, *, exact: bool = False) -> None:
    """Print how a time within a stretch of simulation is known, if that is the step."""
    within = log.state_at(step).sampled
    if within is not None:
        print_message(sampled(within, exact=exact))


def numbers(
    text: str, expected: str, *counts: int, separator: str = ",", kind: Callable[[str], float] = float
) -> list[float]:
    """Parse finite numbers, as "0.5,1,0", of one of the given counts.

    Raises:
        ReplayError: the text isn't that; it says what was ``expected``.
    """
    try:
        values = [kind(part) for part in text.split(separator)]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise ReplayError(f"{text!r}: expected {expected}")
    return values
