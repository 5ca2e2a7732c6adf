"""One run of a sweep, in a child process: its seed and parameters, the plan from its start, and the whole recording."""

from __future__ import annotations

import ast
import json
import math
import random
import re
import time
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field
from functools import cache, lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pycram import running
from pycram.failures import PlanFailure
from pycram.foundation.failures import BadArgument
from pycram.models import warming
from pycram.plan_parameters import parsed, split
from pycram.projection.child import limit_memory
from pycram.seeding import MAX_SEED
from recorder.errors import RecordingError, suggestion
from recorder.mcap_sink import McapSink
from recorder.provenance import metadata
from recorder.recording import record, redirected
from recorder.records import Query, Run, Task, format_failure
from recorder.records.values import LEFT_OUT, is_secret
from recorder.tracing.journal import NullSink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from recorder.mcap_writer import SharedModels
    from recorder.records import Record
    from recorder.tracing.journal import Sink


HOOKS: Final = "pycram.runs"
"""Group of entry points: functions that are called with the path of a recording whose plan began, in its run's process.

They aren't called for a first run that fails before the plan did anything, because its recording is renamed.
"""
_TIME_LIMIT: Final = "TimeLimit"
_UNSAFE: Final = re.compile(r"[^\w.+-]+", re.ASCII)  # in names of files, on any system
_MAX_LETTERS: Final = 120  # characters of a name
#: Distributions by name: number of arguments, and function that draws.
_DISTRIBUTIONS: Final[Mapping[str, tuple[int, Callable[..., Any]]]] = {
    "uniform": (2, lambda dice, a, b: dice.uniform(a, b)),
    "normal": (2, lambda dice, mean, deviation: dice.gauss(mean, deviation)),
    "integers": (2, lambda dice, a, b: dice.randint(a, b)),
    "choice": (0, lambda dice, *values: dice.choice(values)),
}
_CALL: Final = re.compile(r"(\w+)\s*\((.*)\)", re.DOTALL)
_WORD: Final = re.compile(r"[^()\[\]{}'\"=]+")
_EXPECTED: Final = "uniform(a,b), normal(mean,deviation), integers(first,last) or choice(a,b,...)"


class RunLost(PlanFailure):
    """The process of a run ended before the plan did, and again when it was tried once more."""


@dataclass(frozen=True, slots=True)
class Spec:
    """The settings that all runs of a sweep share."""

    plan: str  # file, absolute
    folder: str  # for recordings, absolute
    seed: int = 0  # determines the seeds and sampled parameters of the runs
    arguments: tuple[str, ...] = ()  # of the plan
    listed: Mapping[str, list[Any]] = field(default_factory=dict)  # values of parameters
    sampled: Mapping[str, str] = field(default_factory=dict)  # distributions of parameters
    motion: str = ""  # execution environment where the plan names none; "" for "simulated"
    local_variables: bool = True  # whether failures hold the plan's local variables
    limit: float = 300.0  # s of wall-clock time for a run
    memory: int = 0  # bytes of additional memory for a run; 0 for no limit

    def values(self, number: int) -> dict[str, Any]:
        """Return the values of a run's parameters."""
        return Variations(self.listed, self.sampled).of(self.seed, number)

    def seed_of(self, number: int) -> int:
        """Return a run's seed."""
        return (self.seed + number) % (MAX_SEED + 1)

    def name(self, number: int) -> str:
        """Return the name of a run's recording."""
        return name_of(number, self.values(number))

    def part(self, number: int) -> Path:
        """Return the file of a run's incomplete recording."""
        return Path(self.folder) / f".{self.name(number)}.part"


def name_of(number: int, values: Mapping[str, Any]) -> str:
    """Return the name of a run's recording, with its parameters shortened for people."""
    shown = ((name, LEFT_OUT if is_secret(name) else value) for name, value in values.items())
    words = ",".join(f"{name}={_shown(value)}" for name, value in shown)
    return f"{number:05}{'.' if words else ''}{words[:_MAX_LETTERS]}.mcap"


def _shown(value: object) -> str:
    return _UNSAFE.sub("_", f"{value:.4g}" if isinstance(value, float) else str(value))


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """The result of a run."""

    number: int
    name: str  # of its recording
    succeeded: bool
    failure: str = ""  # in words
    seconds: float = 0.0  # that it took
    started: bool = True  # whether it had a task or a query
    lost: bool = False  # whether its process ended before the plan did
    unrecorded: str = ""  # why it couldn't be recorded; "" if it was
    remark: str = ""  # error of a hook


class _RunSink(McapSink):
    """The recording of a run, with its end."""

    end: Run | None = None
    started = False
    late: Callable[[], str] = str

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.started = self.started or isinstance(record, Task | Query)
        if isinstance(record, Run) and record.phase == Run.FINISHED:
            if record.interrupted_by and (cause := self.late()):
                record.failure.type, record.failure.message = _TIME_LIMIT, cause
                payload = record.SerializeToString()
            self.end = record
        super().write(topic, record, payload)


def run_once(
    spec: Spec,
    number: int,
    attempt: int,
    models: SharedModels | None,
    began: float,
    *,
    noting: bool = False,
    lost: str = "",
) -> bytes:
    """Run the plan once, in a child of the sweep; return the outcome, and notes with which to warm later runs.

    Args:
        spec: Of the sweep.
        number: Of the run.
        attempt: Its number, from 1.
        models: Files that the recording refers to.
        began: Its start by the system's monotonic clock, in s.
        noting: Whether to take those notes.
        lost: Why the run's process ended in each attempt; then only this is recorded.
    """
    plan, part = Path(spec.plan), spec.part(number)
    values, seed = spec.values(number), spec.seed_of(number)
    if spec.memory and not lost:
        limit_memory(spec.memory)
    sinks: list[_RunSink] = []
    refused: list[str] = []

    def late() -> str:
        over = time.monotonic() - began >= spec.limit
        return f"the run still went on after {spec.limit:g} s" if over else ""

    def sink_of(run: Run) -> Sink:
        if sinks:  # a recording that the plan itself makes: all runs would write to the same file
            return NullSink()
        run.sweep.number, run.sweep.seed, run.sweep.attempt = number, spec.seed, attempt
        try:
            sinks.append(_RunSink(part, metadata(run), models=models))
        except RecordingError as error:
            refused.append(error.cause)
            raise
        sinks[0].late = late
        sinks[0].path = Path(spec.folder) / spec.name(number)  # projections are recorded next to it
        return sinks[0]

    with redirected(sink_of), warming.noted() if noting and not lost else nullcontext() as notes:
        if lost:
            _record_loss(spec, values, seed, lost)
        else:
            one = running.RunSpec(
                plan,
                spec.arguments,
                seed,
                motion=spec.motion,
                parameters=values,
                local_variables=spec.local_variables,
            )
            running.run(one, part, overwrite=True)
    sink = sinks[0] if sinks else None
    name = spec.name(number)
    if sink is None or sink.lost or sink.end is None:
        part.unlink(missing_ok=True)
        why = "".join(refused) if sink is None else sink.lost
        return _answer(RunOutcome(number, name, succeeded=False, unrecorded=why or "its end is missing"))
    path = part.replace(Path(spec.folder) / name)
    failure = "" if sink.end.succeeded else format_failure(sink.end.failure)
    remark = _call_hooks(path) if sink.started or sink.end.succeeded else ""
    outcome = RunOutcome(
        number,
        name,
        sink.end.succeeded,
        failure,
        seconds=time.monotonic() - began,
        started=sink.started,
        lost=bool(lost),
        remark=remark,
    )
    return _answer(outcome, notes)


def _record_loss(spec: Spec, values: Mapping[str, Any], seed: int, cause: str) -> None:
    plan = Path(spec.plan)
    with (
        suppress(RunLost),
        record(
            spec.part(0),  # the sink knows where
            name=plan.stem,
            arguments=spec.arguments,
            source=plan,
            seed=seed,
            environment=spec.motion,
            parameters=values,
            overwrite=True,
        ),
    ):
        raise RunLost(cause)


def _answer(outcome: RunOutcome, notes: warming.Notes | None = None) -> bytes:
    return json.dumps({"outcome": asdict(outcome), "notes": notes and notes.text()}).encode()


@cache
def hooks() -> tuple[Callable[[Path], object], ...]:
    """Return the functions of installed packages for recordings."""
    return tuple(each.load() for each in entry_points(group=HOOKS))


def _call_hooks(path: Path) -> str:
    """Call the hooks, and return their error, "" for none; the run doesn't depend on it."""
    try:
        for hook in hooks():
            hook(path)
    except Exception as error:  # noqa: BLE001  hooks are code of other packages
        return f"{type(error).__name__}: {error}"
    return ""


# --- parameters -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Variations:
    """The parameters that vary from run to run.

    Raises:
        BadArgument: A parameter has no values, is given twice, or a distribution is invalid.
    """

    #: Values by name; runs take all combinations in turn, and the last name's values change fastest.
    listed: Mapping[str, Sequence[Any]]
    #: Distributions by name, as text; a value depends only on the seed, the run's number and the name.
    sampled: Mapping[str, str]

    def __post_init__(self) -> None:
        for name in self.listed.keys() & self.sampled.keys():
            raise BadArgument("sample", name, "a parameter that has no listed values")
        for name, values in self.listed.items():
            if isinstance(values, str) or not values:
                raise BadArgument(name, values, "a list of one or more values")
        for name, text in self.sampled.items():
            _distribution(name, str(text))

    def of(self, seed: int, number: int) -> dict[str, Any]:
        """Return the values of a run."""
        values: dict[str, Any] = dict.fromkeys(self.listed)
        rest = number
        for name in [*self.listed][::-1]:
            rest, index = divmod(rest, len(self.listed[name]))
            values[name] = self.listed[name][index]
        for name, text in self.sampled.items():
            kind, arguments = _distribution(name, str(text))
            dice = random.Random(f"{seed}/{number}/{name}")  # a text's own hash, whatever PYTHONHASHSEED
            values[name] = _DISTRIBUTIONS[kind][1](dice, *arguments)
        return values

    def every(self) -> Iterator[dict[str, Any]]:
        """Yield combinations that contain each listed value, and a value of each distribution."""
        drawn = self.of(0, 0)
        yield drawn
        for name, values in self.listed.items():
            yield from ({**drawn, name: value} for value in values)


def listed(text: str) -> tuple[str, list[Any]]:
    """Parse ``name=1,2,3``: values are JSON, or else texts; values with commas are in brackets or quotes.

    Raises:
        BadArgument: The text has another form.
    """
    expected = "name=value or name=value,value,..."
    name, values = split("set", text, expected)
    if not values:
        raise BadArgument("set", text, expected)
    try:
        whole: list[Any] = json.loads(f"[{values}]")
    except ValueError:
        return name, [parsed(part) for part in values.split(",")]
    return name, whole


def sampled(text: str) -> tuple[str, str]:
    """Parse ``name=uniform(a,b)``.

    Raises:
        BadArgument: The text has another form.
    """
    name, distribution = split("sample", text, f"name={_EXPECTED}")
    _distribution(name, distribution)
    return name, distribution


@lru_cache  # each run's name has its values
def _distribution(name: str, text: str) -> tuple[str, list[Any]]:
    call = _CALL.fullmatch(text.strip())
    if call is None:
        raise BadArgument(name, text, _EXPECTED)
    kind, values = call.groups()
    if kind not in _DISTRIBUTIONS:
        raise BadArgument(name, text, f"a distribution; {suggestion(kind, _DISTRIBUTIONS)}")
    try:
        arguments = list(ast.literal_eval(f"({values},)"))
    except (SyntaxError, ValueError):  # choice(cup.stl,bowl.stl): texts without quotes
        words = [each.strip() for each in values.split(",")]
        if not all(map(_WORD.fullmatch, words)):
            raise BadArgument(name, text, _EXPECTED) from None
        arguments = list(map(parsed, words))
    count = _DISTRIBUTIONS[kind][0]
    numbers = all(isinstance(each, int | float) and math.isfinite(each) for each in arguments)
    whole = kind != "integers" or (all(isinstance(each, int) for each in arguments) and arguments == sorted(arguments))
    if (count and (len(arguments) != count or not numbers)) or not arguments or not whole:
        raise BadArgument(name, text, _EXPECTED)
    return kind, arguments
