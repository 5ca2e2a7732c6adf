"""The plan's source in a recording, and the exceptions in a traceback with the plan's lines."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder import notebook
from recorder.plan_lines import syntax_nodes
from recorder.records import Record
from replay.errors import Damaged

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader


Site: TypeAlias = "tuple[str, int]"  # a file, and the number of a line


def sites(record: Record) -> tuple[Site, ...]:
    """Return the lines of the plan that led to a record, outermost first; () if they are unknown."""
    file, callers = getattr(record, "source_file", ""), getattr(record, "callers", ())
    outer = ((caller.file or file, caller.line) for caller in callers)
    return (*outer, (file, record.source_line)) if file else ()  # type: ignore[union-attr]


@dataclass(frozen=True, slots=True)
class Line:
    """A line of the plan."""

    file: str  # path of the file when the plan ran
    number: int  # from 1
    function: str = ""  # name of the function; "" if the source isn't attached
    text: str = ""  # text of the line; "" if the source isn't attached

    def __str__(self) -> str:
        return notebook.place(name_of(self.file), self.number)


class PlanSource:
    """The attached source files of a recording; files with ambiguous names are left out."""

    def __init__(self, log: RecordReader) -> None:
        self._assets = log.assets
        keys = [key for key in log.assets if key.endswith(".py") or notebook.is_cell(name_of(key))]
        names = [name_of(key) for key in keys]
        self._keys = {name: key for name, key in zip(names, keys, strict=True) if names.count(name) == 1}
        self._texts: dict[str, str] = {}

    def line(self, file: str, number: int) -> Line | None:
        """Return the line of a file with a number; None for number 0. ``file`` is the file's path when the plan ran."""
        if not file or number < 1:
            return None
        text = self.text(file)
        lines = text.splitlines()
        if number > len(lines):
            return Line(file, number)
        functions = (node for node in syntax_nodes(text) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
        names = [node.name for node in functions if node.lineno <= number <= (node.end_lineno or node.lineno)]
        return Line(file, number, names[-1] if names else "<module>", lines[number - 1].strip())

    def handler(self, line: Line) -> Line | None:
        """Return the first line of the ``except`` block for errors of a line, in its function; None without a block."""
        around = [node for node in syntax_nodes(self.text(line.file)) if isinstance(node, ast.Try | ast.FunctionDef)]
        around = [node for node in around if node.lineno <= line.number <= node.body[-1].end_lineno]  # type: ignore[operator]
        inner = around[-1] if around else None
        body = inner.handlers[0].body if isinstance(inner, ast.Try) and inner.handlers else ()
        return self.line(line.file, body[0].lineno) if body else None

    def is_ahead(self, line: Line, reached: Line) -> bool:
        """Return whether a line of a module comes after a reached line, outside of loops and ``try`` around both."""
        if (line.file, line.function) != (reached.file, "<module>") or line.number <= reached.number:
            return False
        around = (
            node for node in syntax_nodes(self.text(line.file)) if isinstance(node, ast.For | ast.While | ast.Try)
        )
        return not any(each.lineno <= reached.number and line.number <= (each.end_lineno or 0) for each in around)

    def call_stack(self, record: Record) -> tuple[Line, ...]:
        """Return the plan's lines that led to a record, outermost first; () if unknown."""
        lines = [self.line(*site) for site in sites(record)]
        return tuple(filter(None, lines)) if lines and lines[-1] is not None else ()

    def text(self, file: str) -> str:
        """Return the text of a file; "" if the file isn't attached or is damaged."""
        key = self._keys.get(name_of(file))
        if key is None:
            return ""
        if key not in self._texts:
            try:
                self._texts[key] = self._assets[key].decode("utf-8", "replace")
            except Damaged:
                self._texts[key] = ""
        return self._texts[key]

    @property
    def files(self) -> dict[str, str]:
        """Names of attachments, by names of files."""
        return dict(self._keys)

    def has(self, file: str) -> bool:
        """Return whether a file is attached."""
        return name_of(file) in self._keys


def name_of(path: str) -> str:
    """Return the last part of a path, for any operating system."""
    return PurePosixPath(path.replace("\\", "/")).name


def is_file(path: str, name: str) -> bool:
    """Return whether a path ends with a name; the name may contain folders."""
    searched = PurePosixPath(name.replace("\\", "/")).parts
    return bool(searched) and PurePosixPath(path.replace("\\", "/")).parts[-len(searched) :] == searched


_FRAME: Final = re.compile(r'^[\s|+]*File "(?P<file>[^"]+)", line (?P<line>\d+), in (?P<function>.+)$')
_NEXT: Final = re.compile(
    r"^(?:The above exception was the direct cause of|During handling of the above exception).*$", re.MULTILINE
)
_START: Final = re.compile(r"^\s*(?:\+ )?(?:Exception Group )?Traceback \(most recent call last\):\s*$")
_TITLE: Final = re.compile(r"^(?:[\w<>]+\.)*(?P<type>[A-Za-z_]\w*)(?:: (?P<message>.*))?$", re.DOTALL)
#: The folder of PyCRAM, found from the modules that plans call.
_ROOT: Final = re.compile(
    r"^(?P<root>.*[/\\])(?:recorder[/\\](?:recording|tracing[/\\]span)"
    r"|pycram[/\\](?:world|motions|actions|planning|language|scheduling|fluents|reasoning)(?:[/\\]\w+)+"
    r"|recorder[/\\]span|pycram[/\\](?:process_module|designator|blocks|fluent|objects|bullet_world"
    r"|bullet_world_reasoning|funnel))\.py$"  # names of these modules in release 0.1.0
)
#: Files that don't belong to a plan.
_FOREIGN: Final = re.compile(r"^<|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]")


@dataclass(frozen=True, slots=True)
class ParsedException:
    """An exception in a traceback."""

    type: str
    message: str
    lines: tuple[Line, ...]  # the plan's lines that led to the exception, outermost first
    own: bool = False  # whether a line of the plan raised the exception


def parse_traceback(traceback: str, source: PlanSource) -> list[ParsedException]:
    """Return the exceptions in a traceback, the causes first."""
    frames = [frame for text in traceback.splitlines() if (frame := _FRAME.match(text))]
    roots = tuple({root["root"] for frame in frames if (root := _ROOT.match(frame["file"]))})
    parts = (part.strip("\n") for part in _NEXT.split(traceback))
    return [_parse(part, source, roots) for part in parts if part.strip()]


def _parse(part: str, source: PlanSource, roots: tuple[str, ...]) -> ParsedException:
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


def _lines(texts: list[str], source: PlanSource, roots: tuple[str, ...]) -> list[Line]:
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


def _is_plan(file: str, source: PlanSource, roots: tuple[str, ...]) -> bool:
    for root in roots:
        inside = file.removeprefix(root).replace("\\", "/") if file.startswith(root) else ""
        if inside.startswith(("pycram/", "recorder/")) and not inside.startswith("pycram/demos/"):
            return False
    return source.has(file) or not _FOREIGN.search(file)
