"""Console output: results to stdout, messages to stderr.

Control characters are printed as escapes, because terminals obey them, and recorded texts may come from strangers. JSON
is ASCII, so the encoding of a terminal can't lose characters.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Final

from recorder.terminal import messages, painted
from replay.errors import ReplayError

if TYPE_CHECKING:
    from replay.recording import Recording

_STDOUT, _STDERR = 1, 2
_PROGRESS_PERIOD: Final = 0.2  # minimum time in s between two messages of progress
#: Texts with a colour on a terminal.
_COLOURED: Final = re.compile(
    r"(?P<bold>^[a-z]{1,10}(?=  +\S)|(?:(?<=\n\n)|(?<=\A\n)|\A)[A-Z][^\n.]*(?=\n  ))"  # names of fields, and headings
    r"|(?P<yellow>\bsteps? \d+(?:-\d+)?|^ *\d+(?= +(?:[\d.]+s )?[a-z-]+ ))"
    r"|(?P<dim>\b\d+\.\d+s(?= [a-z])|(?<=[, ])\d+\.\d ms\b)"
    r"|(?P<cyan>(?:/|\b)[\w./-]+\.py:\d+|^ *pycram(?:-replay)? \S.*$)"
    r"|(?P<red>\b(?:failed|rejected)\b|^[> ] *X(?= )|^X(?= ))"
    r"|(?P<green>\bsucceeded\b|(?<=^complete     )yes|^[> ] *\+(?= )|^\+(?= ))",
    re.MULTILINE,
)
#: Control characters except newlines and tabs, characters that change the direction of text, and surrogates.
_CONTROL: Final = re.compile("[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u202a-\\u202e\\u2066-\\u2069\\ud800-\\udfff]")


def visible(text: str) -> str:
    r"""Return a text with control characters as escapes, such as ``\x1b``; newlines and tabs aren't changed."""
    return _CONTROL.sub(lambda match: ("\\x%02x" if match[0] < "\u0100" else "\\u%04x") % ord(match[0]), text)


def print_text(text: str, *, end: str = "\n", flush: bool = False) -> None:
    """Print a result, in colours on a terminal."""
    print(painted(visible(text), _COLOURED, sys.stdout), end=end, flush=flush)


def print_json(value: object, *, flush: bool = False) -> None:
    """Print a result as a line of JSON. NaN and infinity become strings, and invalid bytes become escapes."""
    print(_json(value), flush=flush)


def print_json_list(values: Iterable[object]) -> None:
    """Print results as a JSON list while they arrive."""
    between = "["
    for value in values:
        print(between, _json(value), sep="", end="")
        between = ", "
    print("[]" if between == "[" else "]")


def _json(value: object) -> str:
    try:
        text = json.dumps(value, allow_nan=False)
    except ValueError:  # only inconsistent recordings contain nan or infinity
        text = json.dumps(_sound(value), allow_nan=False)
    if "\\udc" in text:  # invalid bytes, or parts of valid surrogate pairs
        text = json.dumps(_sound(value), allow_nan=False)
    return text.replace("\x7f", "\\u007f")


def print_result(data: Callable[[], object], lines: Iterable[str], *, as_json: bool) -> None:
    """Print a result as JSON data or as lines."""
    if as_json:
        print_json(data())
    else:
        print_text("\n".join(lines))


def _sound(value: object) -> object:
    if isinstance(value, dict):
        return {_sound(key): _sound(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_sound(item) for item in value]
    if isinstance(value, str):
        from recorder.records import escaped  # noqa: PLC0415  slow to import

        return escaped(value)
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def print_message(text: str) -> None:
    """Print a message on stderr."""
    print(f"pycram-replay: {visible(text)}", file=messages())


@contextmanager
def progress(words: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that prints the progress, such as "step 3 of 9"; the line is removed at the end of the block.

    Nothing is printed if stderr isn't a terminal.
    """
    began = printed = time.monotonic()

    def show(done: int, of: int) -> None:
        nonlocal printed
        if time.monotonic() - printed > _PROGRESS_PERIOD and sys.stderr.isatty():
            printed = time.monotonic()
            print(f"\r{words} {done} of {of}", end="", file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        if printed > began:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


@contextmanager
def native_output_to_stderr() -> Iterator[None]:
    """Redirect the file descriptor of stdout to stderr, but not ``sys.stdout``."""
    from pycram.foundation.redirect import redirected  # noqa: PLC0415  verbs that only read don't need it

    python = sys.stdout
    python.flush()
    with ExitStack() as undoing:
        if _is_descriptor_of_stdout(python):
            stdout = os.fdopen(os.dup(_STDOUT), "w", encoding=python.encoding, errors=python.errors, buffering=1)
            undoing.callback(stdout.close)
            undoing.callback(setattr, sys, "stdout", python)
            sys.stdout = stdout
        undoing.enter_context(redirected(_STDOUT, to=_STDERR))
        yield


def _is_descriptor_of_stdout(stream: object) -> bool:
    try:
        return stream.fileno() == _STDOUT  # type: ignore[attr-defined, no-any-return]
    except (AttributeError, OSError, ValueError):
        return False


def print_moment(log: Recording, step: str, *, exact: bool = False) -> None:
    """If the step is a time within a simulation, print how exact the state at this time is."""
    from replay.report.phrases import sampled  # noqa: PLC0415  slow to import

    within = log.state_at(step).sampled
    if within is not None:
        print_message(sampled(within, exact=exact))


def numbers(
    text: str, expected: str, *counts: int, separator: str = ",", kind: Callable[[str], float] = float
) -> list[float]:
    """Parse finite numbers, such as "0.5,1,0". ``counts`` contains the allowed numbers of values.

    For an invalid text, raise ReplayError with the text ``expected``.
    """
    try:
        values = [kind(part) for part in text.split(separator)]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise ReplayError(f"{text!r}: expected {expected}")
    return values
