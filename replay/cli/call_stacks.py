"""Call stacks: the plan's lines that led to something, as text and as JSON data."""

from __future__ import annotations

from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING, TypeAlias

from replay.cli import formatting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.explain.plan_source import Line

CallStack: TypeAlias = "tuple[Line, ...]"  # outermost first


def facts(stack: CallStack) -> dict[str, object]:
    """Return the plan's lines that led to something as JSON data."""
    lines = [line_facts(line) for line in stack]
    return {"line": lines[-1] if lines else None, "callers": lines[:-1]}


def line_facts(line: Line) -> dict[str, object]:
    """Return a line of the plan as JSON data."""
    return {"file": line.file, "line": line.number, "function": line.function, "text": line.text}


def lines(stack: CallStack, printed: list[CallStack]) -> Iterator[str]:
    """Yield the lines of a call stack, innermost first, down to those that were printed with another one."""
    common = (takewhile(lambda pair: pair[0] == pair[1], zip(stack, earlier, strict=False)) for earlier in printed)
    shared = max((len(list(pairs)) for pairs in common), default=0)
    printed.append(stack)
    word = "from"
    for line in reversed(stack[shared:] if shared > 1 else stack):
        yield f"{word} {formatting.location(line)}"
        word = "called from"
    if shared > 1:
        yield f"{word} {formatting.location(replace(stack[shared - 1], text=''))}, as above"
