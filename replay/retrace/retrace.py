"""Retrace a recording: run the plan again, and compare it with the recording, record by record.

The same plan, seed, arguments and working directory give the same records in the same order. The first difference is
therefore due to a later change of the plan, of PyCRAM or of the engine, or to outside data, such as clocks, files or
the network. Lines that may read outside data are recognised by the names of common functions; plans may also read such
data in other ways.
"""

from __future__ import annotations

import ast
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from recorder.plan_lines import syntax_nodes
from recorder.records import Run, Task
from replay.retrace.plan_process import FirstDifference, PlanProcess

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

_MAX_LINES: Final = 3  # maximum number of lines of a file that are named
_CLOCK, _FILE, _NETWORK = "the clock", "a file", "the network"
_PROGRAM, _RANDOM, _INPUT = "another program", "random numbers without a seed", "its input"

#: Sources of outside data, by the name of a call or the beginning of the name.
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
_STDIN: Final = "sys.stdin"  # an object whose methods, or loops over it, read outside data
_METHODS: Final = dict.fromkeys(("read_text", "read_bytes"), _FILE)  # methods of these names read data, for any object


@dataclass(frozen=True, slots=True)
class Retracing:
    """The result of retracing a recording."""

    plan: Path  # file of the plan
    steps: int  # number of steps of the recording
    equal: int  # number of equal records before the first difference
    difference: FirstDifference | None  # None if each intact record equals the record of the new run
    notes: tuple[str, ...]  # differences from the recorded conditions
    seconds: float  # duration of the run in s
    taken: int = 0  # number of queries that got recorded answers

    @property
    def identical(self) -> bool:
        """Whether all records are equal."""
        return self.difference is None


def retrace(
    log: RecordReader,
    *,
    plan: str | Path | None = None,
    arguments: Sequence[str] | None = None,
    answers: Literal["asked", "recorded"] = "asked",
    recorded_source: bool = False,
) -> Retracing:
    """Run a recorded plan again in another process, and compare records up to the first difference.

    Effects outside of the plan's worlds (files, network) happen again. The plan has no input, and its output isn't
    shown. :class:`.PlanProcess` explains the choice of the plan, its arguments and its source.

    With ``answers="asked"``, reasoning queries are repeated, and their answers are compared. With "recorded", the
    answers come from the recording, which is faster; only the queries and their moments are compared.

    If the plan is missing, or if the conditions of the run aren't recorded or can't be repeated, CantRetrace is raised.
    """
    process = PlanProcess(log, plan, arguments, recorded_source=recorded_source)
    return compared(process, log, take_answers=answers == "recorded")


def compared(process: PlanProcess, log: RecordReader, *, take_answers: bool = False) -> Retracing:
    """Run a plan again until the first difference from its recording."""
    notes = tuple(process.notes())
    start = time.perf_counter()
    outcome = process.run(take_answers=take_answers)
    seconds = time.perf_counter() - start
    notes += outcome.notes
    if outcome.difference is not None:
        notes += tuple(likely_reasons(log, outcome.difference))
    return Retracing(process.program, len(log), outcome.equal, outcome.difference, notes, seconds, outcome.taken)


def likely_reasons(log: RecordReader, difference: FirstDifference) -> Iterator[str]:
    """Yield possible causes of a difference outside of the plan, as text."""
    yield from reads_before(difference)
    began, step = log[0], difference.step
    if isinstance(began, Run) and began.HasField("looks"):  # the moments of these ends guided the run
        return
    begun: dict[int, int] = {}
    for record in log.records(Task):
        if record.phase == Task.STARTED:
            begun[record.task] = record.seq
        elif record.checkpoint and begun.get(record.task, 0) <= step <= record.seq:
            by = "a worker thread" if record.kind == "in-thread" else "the clock"
            yield f"{by} ended {record.kind} {record.name} at step {record.seq}: no seed determines this moment"


def reads_before(difference: FirstDifference) -> Iterator[str]:
    """Yield the lines before a difference that read outside data, as text, the nearest line first."""
    files = set()
    for place in (difference.line, *difference.callers):
        file, _, number = place.rpartition(":")
        if not file or file in files:
            continue
        files.add(file)
        reads = [read for read in _reads(Path(file)) if read[0] <= int(number)]
        for line, call, what in sorted(reads, reverse=True)[:_MAX_LINES]:
            yield f"{Path(file).name}:{line} reads {what}: {call}"


def _reads(file: Path) -> Iterator[tuple[int, str, str]]:
    """Yield the line, the text and the source of the data for each read of outside data in a file."""
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
            parts = f"{names.get(first, first)}{dot}{rest}".split(".")
            outer = (".".join(parts[:end]) for end in range(len(parts), 0, -1))
            what = next((_READS[name] for name in outer if name in _READS), _METHODS.get(called.rpartition(".")[2]))
            if what == _RANDOM and "default_rng" in called and (node.args or node.keywords):
                continue
            if what is not None:
                yield node.lineno, f"{called}()", what


def _imported(nodes: tuple[ast.AST, ...]) -> Iterator[tuple[str, str]]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((each.asname, each.name) for each in node.names if each.asname)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((each.asname or each.name, f"{node.module}.{each.name}") for each in node.names)
