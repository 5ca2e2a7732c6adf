"""What a plan got from the world outside, which no seed knows: lines that read clocks, files, the network; deadlines.

Lines are found in the source, by the names that Python's own modules and a few others give to such calls; a plan may
read in other ways as well.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.records import Run, Task
from replay.explain.plan_source import syntax_nodes

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from replay.file.record_reader import RecordReader
    from replay.retrace.guide import Difference

_MAX_LINES: Final = 3  # that are named
_CLOCK, _FILE, _NETWORK = "the clock", "a file", "the network"
_PROGRAM, _RANDOM, _INPUT = "another program", "random numbers without a seed", "its input"

#: What a call reads, by its name or the beginning of it.
_READS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("time.time", "time.monotonic", "time.perf_counter", "time.process_time"), _CLOCK),
    **dict.fromkeys((f"{name}_ns" for name in ("time.time", "time.monotonic", "time.perf_counter")), _CLOCK),
    **dict.fromkeys(("datetime.datetime.now", "datetime.datetime.utcnow", "datetime.date.today"), _CLOCK),
    **dict.fromkeys(("time.localtime", "time.strftime"), _CLOCK),
    **dict.fromkeys(("open", "os.listdir", "os.scandir", "os.stat", "os.path", "numpy.load", "numpy.loadtxt"), _FILE),
    **dict.fromkeys(("socket", "urllib", "http", "requests", "httpx", "aiohttp"), _NETWORK),
    **dict.fromkeys(("subprocess", "os.system", "os.popen"), _PROGRAM),
    **dict.fromkeys(("random.SystemRandom", "os.urandom", "secrets", "uuid.uuid1", "uuid.uuid4"), _RANDOM),
    "numpy.random.default_rng": _RANDOM,
    "input": _INPUT,
    "fileinput": _INPUT,
}
_STDIN: Final = "sys.stdin"  # whatever reads it: a call, a loop
_METHODS: Final = dict.fromkeys(("read_text", "read_bytes"), _FILE)  # of whatever object


def likely_reasons(log: RecordReader, difference: Difference) -> Iterator[str]:
    """Yield in words what of the world outside may be why a record came out differently."""
    yield from reads_before(difference)
    yield from decided_outside(log, difference.step)


def reads_before(difference: Difference) -> Iterator[str]:
    """Yield in words the lines that may be why a record came out differently, nearest first: those that led to it."""
    files = set()
    for place in (difference.line, *difference.callers):
        file, _, number = place.rpartition(":")
        if not file or file in files:
            continue
        files.add(file)
        reads = [read for read in _reads(Path(file)) if read[0] <= int(number)]
        for line, call, what in sorted(reads, reverse=True)[:_MAX_LINES]:
            yield f"{Path(file).name}:{line} reads {what}: {call}"


def decided_outside(log: RecordReader, step: int) -> Iterator[str]:
    """Yield in words the tasks around a step that the clock or a worker thread ended in an old recording.

    Newer ones tell at which look that was.
    """
    began = log[0]
    if isinstance(began, Run) and began.HasField("looks"):  # then the recording guides that
        return
    begun: dict[int, int] = {}
    for record in log.records(Task):
        if record.phase == Task.STARTED:
            begun[record.task] = record.seq
        elif record.checkpoint and begun.get(record.task, 0) <= step <= record.seq:
            by = "a worker thread" if record.kind == "in-thread" else "the clock"
            yield f"{by} ended {record.kind} {record.name} at step {record.seq}: when that comes, no seed knows"


def _reads(file: Path) -> Iterator[tuple[int, str, str]]:
    """Yield line, text and kind of what reads the world outside in a file."""
    try:
        nodes = syntax_nodes(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return
    names = dict(_imported(nodes))
    for node in nodes:
        if isinstance(node, ast.Attribute | ast.Name):
            first, dot, rest = ast.unparse(node).partition(".")
            if names.get(first, first) + dot + rest == _STDIN:
                yield node.lineno, _STDIN, _INPUT
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            first, dot, rest = called.partition(".")
            what = _kind(names.get(first, first) + dot + rest) or _METHODS.get(called.rpartition(".")[2])
            if what == _RANDOM and "default_rng" in called and (node.args or node.keywords):
                continue
            if what is not None:
                yield node.lineno, f"{called}()", what


def _imported(nodes: tuple[ast.AST, ...]) -> Iterator[tuple[str, str]]:
    """Yield what a file imports, by the names that it has there."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((each.asname, each.name) for each in node.names if each.asname)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((each.asname or each.name, f"{node.module}.{each.name}") for each in node.names)


def _kind(name: str) -> str | None:
    parts = name.split(".")
    return next((_READS[key] for end in range(len(parts), 0, -1) if (key := ".".join(parts[:end])) in _READS), None)
