"""The outlet: the one way of results to stdout, and of talk to stderr.

Texts of a recording are somebody else's, and a terminal obeys what stands in them: control characters are shown as
escapes, never sent. JSON goes out in ASCII, so that no terminal's encoding loses anything of it. While a world lives,
what native code prints goes to stderr; stdout belongs to results.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_STDOUT, _STDERR = 1, 2
#: What a terminal obeys or hides, but for newlines and tabs: control characters, and those that turn the direction.
_CONTROL: Final = re.compile("[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u202a-\\u202e\\u2066-\\u2069]")


def visible(text: str) -> str:
    r"""A text whose control characters stand in it as escapes, as ``\x1b``; newlines and tabs stay.

    Args:
        text: somebody's.
    """
    return _CONTROL.sub(_escape, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def tell(text: str, *, end: str = "\n", flush: bool = False) -> None:
    """Prints a result.

    Args:
        text: one line, or several.
        end: what follows it.
        flush: whether it must be seen at once.
    """
    print(visible(text), end=end, flush=flush)


def print_json(value: object, *, flush: bool = False) -> None:
    """Prints a result for machines, as a line of JSON.

    Args:
        value: of JSON's own types; numbers that JSON doesn't have are told as texts, as "nan".
        flush: whether it must be seen at once.
    """
    try:
        text = json.dumps(value, allow_nan=False)
    except ValueError:  # rare: only in recordings that make no sense
        text = json.dumps(_finite(value), allow_nan=False)
    print(text.replace("\x7f", "\\u007f"), flush=flush)


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def remark(text: str) -> None:
    """Says something on stderr.

    Args:
        text: what to say.
    """
    print(f"pycram-replay: {visible(text)}", file=sys.stderr)


@contextmanager
def results_only() -> Iterator[None]:
    """Turns the file descriptor of stdout to stderr; Python's own ``sys.stdout`` goes on to where it went."""
    from pycram.foundation.redirect import redirected  # noqa: PLC0415  what only reads doesn't need it

    python = sys.stdout
    python.flush()
    with ExitStack() as undoing:
        if _is_descriptor(python):
            outlet = os.fdopen(os.dup(_STDOUT), "w", encoding=python.encoding, errors=python.errors, buffering=1)
            undoing.callback(outlet.close)
            undoing.callback(setattr, sys, "stdout", python)
            sys.stdout = outlet
        undoing.enter_context(redirected(_STDOUT, to=_STDERR))
        yield


def _is_descriptor(stream: object) -> bool:
    """Whether Python's stdout is the descriptor; tests and notebooks put others in its place."""
    try:
        return stream.fileno() == _STDOUT  # type: ignore[attr-defined, no-any-return]
    except (AttributeError, OSError, ValueError):
        return False
