"""Runs of a sweep on this machine: each run is a forked child of this process, or of a worker process.

If the process of a run crashes, hangs or is killed, the run is retried once. If the retry also fails, the run's
recording contains the reason. A process that has worlds, or threads like those of Ray and Jupyter, can't fork runs; it
starts a :class:`Worker`, whose process keeps loaded modules and models between batches.
"""

from __future__ import annotations

import contextlib
import glob
import json
import os
import re
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, NamedTuple

from pycram import running
from pycram.failures import PlanFailure
from pycram.foundation.errors import call_all, export
from pycram.models import load, shapes, store
from pycram.plan_parameters import Variations
from pycram.projection import child
from pycram.running import MAX_SEED, RunSpec
from recorder.errors import RecordingError
from recorder.mcap_sink import McapSink
from recorder.mcap_writer import SharedModels, share_models
from recorder.packages import versions
from recorder.provenance import look_up_revisions, metadata
from recorder.recording import redirected
from recorder.records import Mutation, Query, Record, Run, Task, format_failure
from recorder.records.values import LEFT_OUT, is_secret
from recorder.tracing.journal import NullSink, Sink

HOOKS: Final = "pycram.runs"
"""Group of entry points for hooks: functions that a run's process calls with the path of the recording.

Hooks aren't called if the first run fails before the plan began to act, because the recording gets another name.
"""
_ATTEMPTS: Final = 2
_TIME_LIMIT: Final = "TimeLimit"
_UNSAFE: Final = re.compile(r"[^\w.+-]+", re.ASCII)  # some systems forbid these characters in names of files
_MAX_LETTERS: Final = 120  # maximum length of the parameters in the name of a file


class RunLost(PlanFailure):
    """The process of a run ended before the plan did, also in the retry."""


export("pycram.sweeping", RunLost)


@dataclass(frozen=True, slots=True)
class SweepSpec:
    """A sweep: the settings that all runs share, and the settings that vary."""

    shared: RunSpec  # the settings of a run; its seed and parameters aren't used
    folder: str  # absolute path of the folder for recordings
    seed: int = 0  # determines the seeds and the drawn parameters of runs
    listed: Mapping[str, list[Any]] = field(default_factory=dict)  # values by parameter
    sampled: Mapping[str, str] = field(default_factory=dict)  # distributions by parameter
    limit: float = 300.0  # limit in s of wall-clock time for a run
    memory: int = 0  # limit in bytes of additional memory for a run; 0 for no limit

    def run(self, number: int) -> RunSpec:
        """Return the settings of a run."""
        values = Variations(self.listed, self.sampled).of(self.seed, number)
        return replace(self.shared, seed=(self.seed + number) % (MAX_SEED + 1), parameters=values)

    def name(self, number: int) -> str:
        """Return the name of a run's recording, which contains the shortened parameters."""
        shown = {name: LEFT_OUT if is_secret(name) else value for name, value in self.run(number).parameters.items()}
        texts = {name: f"{value:.4g}" if isinstance(value, float) else str(value) for name, value in shown.items()}
        words = ",".join(f"{name}={_UNSAFE.sub('_', text)}" for name, text in texts.items())
        return f"{number:05}{'.' if words else ''}{words[:_MAX_LETTERS]}.mcap"

    def part(self, number: int) -> Path:
        """Return the file of a run's incomplete recording."""
        return Path(self.folder) / f".{self.name(number)}.part"

    def as_json(self) -> dict[str, Any]:
        """Return the sweep as JSON data."""
        facts = asdict(self)
        return {**facts, "shared": {**facts["shared"], "plan": str(self.shared.plan)}}

    @classmethod
    def of_json(cls, facts: Mapping[str, Any]) -> SweepSpec:
        """Return the sweep from JSON data."""
        given = facts["shared"]
        texts = {name: tuple(given[name]) for name in ("arguments", "checks")}
        return cls(**{**facts, "shared": RunSpec(**{**given, **texts, "plan": Path(given["plan"])})})


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """The result of a run."""

    number: int
    name: str  # name of the recording
    succeeded: bool
    failure: str = ""  # the failure, as text
    seconds: float = 0.0
    started: bool = True  # whether the run had a task or a query
    lost: bool = False  # whether the process ended before the plan did
    unrecorded: str = ""  # why the run couldn't be recorded; "" if it was recorded
    remark: str = ""  # error that a hook raised


class _RunSink(McapSink):
    end: Run | None = None
    started = False
    late: Callable[[], str] = str
    models: tuple[tuple[str, list[float], float], ...] = ()  # paths, colours and scales of the loaded models

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.started = self.started or isinstance(record, Task | Query)
        if isinstance(record, Mutation) and record.HasField("load_body"):
            model = record.load_body
            self.models = (*self.models, (model.path, list(model.color), model.scale or 1.0))
        if isinstance(record, Run) and record.phase == Run.FINISHED:
            if record.interrupted_by and (cause := self.late()):
                record.failure.type, record.failure.message = _TIME_LIMIT, cause
                payload = record.SerializeToString()
            self.end = record
        super().write(topic, record, payload)


def run_once(
    spec: SweepSpec, number: int, attempt: int, models: SharedModels | None, began: float, *, lost: str = ""
) -> bytes:
    """Run the plan once in a child of the sweep, and return the outcome as JSON.

    ``attempt`` counts from 1; ``began`` is the start of the run by the monotonic clock in s. ``lost`` is the reason for
    which the run's process ended in each attempt: the plan then doesn't run, and the recording contains the reason.
    """
    run, part, name = spec.run(number), spec.part(number), spec.name(number)
    if spec.memory and not lost:
        child.limit_memory(spec.memory)
    sinks: list[_RunSink] = []
    refused: list[str] = []

    def late() -> str:
        return f"the run was still running after {spec.limit:g} s" if time.monotonic() - began >= spec.limit else ""

    def sink_of(start: Run) -> Sink:
        if sinks:  # if the plan itself starts a recording, all runs would write it to the same file
            return NullSink()
        start.sweep.number, start.sweep.seed, start.sweep.attempt = number, spec.seed, attempt
        try:
            sinks.append(_RunSink(part, metadata(start), models=models))
        except RecordingError as error:
            refused.append(error.cause)
            raise
        sinks[0].late = late
        sinks[0].path = Path(spec.folder) / name  # recordings of projections are written next to this file
        return sinks[0]

    with redirected(sink_of):
        if lost:
            with suppress(RunLost), run.recorded(part, overwrite=True):
                raise RunLost(lost)
        else:
            running.run(run, part, overwrite=True)
    sink = sinks[0] if sinks else None
    if sink is None or sink.lost or sink.end is None:
        part.unlink(missing_ok=True)
        why = "".join(refused) if sink is None else sink.lost
        why = why or "the end of the recording is missing"
        return _answer(RunOutcome(number, name, succeeded=False, unrecorded=why))
    path = part.replace(Path(spec.folder) / name)
    failure = "" if sink.end.succeeded else format_failure(sink.end.failure)
    errors = []
    if sink.started or sink.end.succeeded:
        errors = call_all([hooks]) or call_all(partial(hook, path) for hook in hooks())
    outcome = RunOutcome(
        number,
        name,
        sink.end.succeeded,
        failure,
        seconds=time.monotonic() - began,
        started=sink.started,
        lost=bool(lost),
        remark="; ".join(f"{type(error).__name__}: {error}" for error in errors),
    )
    return _answer(outcome, sink.models)


def _answer(outcome: RunOutcome, models: Sequence[tuple[str, list[float], float]] = ()) -> bytes:
    return json.dumps({"outcome": asdict(outcome), "models": models}).encode()


@cache
def hooks() -> tuple[Callable[[Path], object], ...]:
    """Return the functions for recordings that installed packages register."""
    return tuple(each.load() for each in entry_points(group=HOOKS))


class _Job(NamedTuple):
    """A run to make, or a lost run to record."""

    number: int
    attempt: int = 1
    lost: str = ""  # why the run's process ended in each attempt; not empty for a lost run


class Local:
    """Makes runs in forks of this process, at most ``cores`` in parallel; 0 means one per core.

    ``models`` names the file of models that all recordings share; None before a run has loaded models.
    """

    def __init__(self, spec: SweepSpec, cores: int = 0, models: str | None = None) -> None:
        # the runs also import these modules
        import numpy.random  # noqa: F401, PLC0415

        from pycram import action_designators, event, fluent, language, process_module  # noqa: F401, PLC0415
        from pycram.bullet_world_reasoning import blocking, contact, stable, visible  # noqa: F401, PLC0415

        self._spec = spec
        self._pool: child.ChildPool[_Job] = child.ChildPool(cores or child.usable_cores(), spec.limit, child.GRACE)
        self._models = SharedModels.of(Path(spec.folder) / models) if models else None
        self._warm = False  # whether this process has loaded the models of a run
        store.folder()  # creates the folder that all runs use
        hooks()
        versions()
        look_up_revisions(spec.shared.plan)

    @property
    def models(self) -> dict[str, str] | None:
        """Name and hash of the file of models; None if there is no file."""
        return None if self._models is None else {"file": self._models.file, "sha256": self._models.sha256}

    def close(self) -> None:
        """Do nothing; only :class:`Worker` has a process to end."""

    def run(self, numbers: Iterable[int]) -> Generator[RunOutcome, None, None]:
        """Make runs, and yield each outcome when the run ends. Closing the generator kills the remaining runs."""
        waiting = deque(map(_Job, numbers))
        going = {job.number for job in waiting}

        def start(job: _Job) -> child.Child:
            began = time.monotonic()  # measured now, because the child's time limit begins later
            once = partial(run_once, self._spec, job.number, job.attempt, self._models, began)
            return child.run_from_start(partial(once, lost=job.lost))

        try:
            with closing(self._pool.run(waiting, start)) as results:
                for job, result in results:
                    again = self._again(job, result)
                    if again is not None:
                        waiting.appendleft(again)
                    else:
                        going.discard(job.number)
                        yield self._outcome(job, result)
        finally:
            for number in going:  # the runs were killed
                self._spec.part(number).unlink(missing_ok=True)

    def _again(self, job: _Job, result: child.ChildResult) -> _Job | None:
        """Return the job that repeats or records a run whose process was killed; None for other runs."""
        if job.lost or (result.answer and not result.late):
            return None
        if job.attempt < _ATTEMPTS:
            recording = Path(self._spec.folder) / self._spec.name(job.number)
            for left in (recording, *recording.parent.glob(f"{glob.escape(recording.stem)}.projection-*")):
                left.unlink(missing_ok=True)
            return _Job(job.number, job.attempt + 1)
        if result.answer:  # the plan was interrupted, as its recording shows
            return None
        how = f"its process {result.how}"
        cause = f"the run was still running after {self._spec.limit:g} s, and was killed" if result.late else how
        cause += f", at each of {_ATTEMPTS} attempts"
        part = self._spec.part(job.number)
        if part.exists():
            kept = part.replace(Path(self._spec.folder) / f"{self._spec.name(job.number)}.killed")
            cause += f"; its incomplete recording is {kept.name}"
        return _Job(job.number, job.attempt, cause)

    def _outcome(self, job: _Job, result: child.ChildResult) -> RunOutcome:
        if not result.answer:  # the child that records the lost run has failed, too
            how = f"its process {result.how}"
            return RunOutcome(job.number, self._spec.name(job.number), succeeded=False, unrecorded=how)
        answer = json.loads(result.answer)
        outcome = RunOutcome(**answer["outcome"])
        for path, color, scale in () if self._warm else answer["models"]:
            with suppress(Exception):  # the next run reports this error
                model = load.load(path, color or None, scale=scale)
                shapes.shapes_of(model.path)
                if len(model.urdf.links) == 1:  # the runs grasp such objects
                    shapes.solids_of(model.path)
            self._warm = True
        if self._models is None and not outcome.unrecorded:
            self._models = share_models(Path(self._spec.folder) / outcome.name)
        return outcome


class WorkerLost(RuntimeError):
    """The process that makes the runs has ended."""


class Worker:
    """Makes runs as :class:`Local` does, but in forks of another process."""

    def __init__(self, spec: SweepSpec, cores: int = 0, shared: str | None = None) -> None:
        self.spec = spec  # the sweep of the next batch
        self.shared = shared  # name of the file of models for the next batch
        self.models: dict[str, str] | None = None  # name and hash of the file of models after the last batch
        self._cores = cores
        self._process = subprocess.Popen(  # noqa: S603  the interpreter that runs this process
            [sys.executable, "-P", "-c", f"from {__name__} import main; main()", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONHASHSEED": str(spec.seed)},
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C reaches only this process, which kills the worker afterwards
        )

    def close(self) -> None:
        """Kill the process and its runs."""
        self._process.kill()
        self._process.communicate()

    def run(self, numbers: Iterable[int]) -> Generator[RunOutcome, None, None]:
        """Make runs and yield their outcomes, as :meth:`Local.run`; raise WorkerLost if the process has ended."""
        left = dict.fromkeys(numbers)
        if not left:
            return
        batch = {"spec": self.spec.as_json(), "numbers": [*left], "models": self.shared, "cores": self._cores}
        sent, received = self._process.stdin, self._process.stdout
        try:
            if sent is not None and received is not None:
                with contextlib.suppress(BrokenPipeError):
                    sent.write(json.dumps(batch) + "\n")
                    sent.flush()
                for line in received:
                    answer = json.loads(line)
                    if "outcome" not in answer:
                        self.models = answer["models"]
                        return
                    outcome = RunOutcome(**answer["outcome"])
                    left.pop(outcome.number)
                    yield outcome
            raise WorkerLost(f"the worker process of the sweep ended with exit code {self._process.wait()}")
        finally:
            if left:
                self.close()
            for number in left:  # the runs were killed
                self.spec.part(number).unlink(missing_ok=True)


def main() -> None:
    """Make the runs of batches until stdin ends."""
    child.die_with(int(sys.argv[1]))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # libraries may also print to stdout
    local: Local | None = None
    of: object = None
    for line in sys.stdin:
        batch = json.loads(line)
        key = batch["spec"], batch["models"]
        if local is None or of != key:
            local, of = Local(SweepSpec.of_json(batch["spec"]), batch["cores"], batch["models"]), key
        for outcome in local.run(batch["numbers"]):
            print(json.dumps({"outcome": asdict(outcome)}), file=answers, flush=True)
        print(json.dumps({"models": local.models}), file=answers, flush=True)
