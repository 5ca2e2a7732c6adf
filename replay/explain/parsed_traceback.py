"""Parses a printed traceback into its exceptions, each with the lines of the plan."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from replay.explain.plan_source import Line

if TYPE_CHECKING:
    from replay.explain.plan_source import Source

_FRAME: Final = re.compile(r'^[\s|+]*File "(?P<file>[^"]+)", line (?P<line>\d+), in (?P<function>.+)$')
_NEXT: Final = re.compile(
    r"^(?:The above exception was the direct cause of|During handling of the above exception).*$", re.MULTILINE
)
_START: Final = re.compile(r"^\s*(?:\+ )?(?:Exception Group )?Traceback \(most recent call last\):\s*$")
_TITLE: Final = re.compile(r"^(?:[\w<>]+\.)*(?P<type>[A-Za-z_]\w*)(?:: (?P<message>.*))?$", re.DOTALL)
#: The executor's folder, recognised by the modules through which plans enter it.
_ROOT: Final = re.compile(
    r"^(?P<root>.*[/\\])(?:recorder[/\\](?:recording|tracing[/\\]span)"
    r"|pycram[/\\](?:world|motions|language|scheduling|fluents|reasoning)(?:[/\\]\w+)+"
    r"|recorder[/\\]span|pycram[/\\](?:process_module|designator|blocks|fluent|objects|bullet_world"
    r"|bullet_world_reasoning|funnel))\.py$"  # as they were named in release 0.1.0
)
#: Files that are no plans.
_FOREIGN: Final = re.compile(r"^<|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]")


@dataclass(frozen=True, slots=True)
class ParsedException:
    """One exception.

    Attributes:
        type: its type's name.
        message: its message.
        lines: the plan's own lines that led to it, outermost first.
        own: whether the last of these raised it itself.
    """

    type: str
    message: str
    lines: tuple[Line, ...]
    own: bool = False


def parse_traceback(traceback: str, source: Source) -> list[ParsedException]:
    """Return the exceptions in a traceback as Python prints it, causes first."""
    frames = [frame for text in traceback.splitlines() if (frame := _FRAME.match(text))]
    roots = tuple({root["root"] for frame in frames if (root := _ROOT.match(frame["file"]))})
    parts = (part.strip("\n") for part in _NEXT.split(traceback))
    return [_parse(part, source, roots) for part in parts if part.strip()]


def _parse(part: str, source: Source, roots: tuple[str, ...]) -> ParsedException:
    lines = part.splitlines()
    start = next((at for at, text in enumerate(lines) if _START.match(text)), -1)
    end = start + 1
    while end < len(lines) and (lines[end][:1] in (" ", "\t") or not lines[end].strip()):
        end += 1
    title = _TITLE.match("\n".join(lines[end:]).strip())
    innermost = next((frame for text in reversed(lines[:end]) if (frame := _FRAME.match(text))), None)
    return ParsedException(
        title["type"] if title else "",
        (title["message"] or "") if title else "\n".join(lines[end:]).strip(),
        tuple(_lines(lines[:end], source, roots)),
        innermost is not None and _is_plan(innermost["file"], source, roots),
    )


def _lines(texts: list[str], source: Source, roots: tuple[str, ...]) -> list[Line]:
    lines = []
    for at, text in enumerate(texts):
        frame = _FRAME.match(text)
        if frame is None or not _is_plan(frame["file"], source, roots):
            continue
        printed = texts[at + 1].strip() if at + 1 < len(texts) and not _FRAME.match(texts[at + 1]) else ""
        attached = source.line(frame["file"], int(frame["line"]))
        function = (attached and attached.function) or frame["function"].strip()
        lines.append(Line(frame["file"], int(frame["line"]), function, (attached and attached.text) or printed))
    return lines


def _is_plan(file: str, source: Source, roots: tuple[str, ...]) -> bool:
    for root in roots:
        inside = file.removeprefix(root).replace("\\", "/") if file.startswith(root) else ""
        if inside.startswith(("pycram/", "recorder/")) and not inside.startswith("pycram/demos/"):
            return False
    return source.has(file) or not _FOREIGN.search(file)
