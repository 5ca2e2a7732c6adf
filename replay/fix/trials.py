"""Trials: whole runs of edited plans under the recorded conditions, each in a separate process and folder."""

from __future__ import annotations

import inspect
import json
import math
import os
import random
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Self

from pycram.exploration import Ending, EndingSink
from pycram.models import store
from pycram.projection.child import GRACE, Child, ChildPool, run_from_start, usable_cores
from pycram.world.object import Object
from recorder.mcap_sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected
from recorder.records import Run
from recorder.system import cache_folder
from recorder.tracing.journal import NullSink, Sink
from replay.compare import is_worded_alike, signature
from replay.errors import ReplayError
from replay.file.record_reader import RecordReader
from replay.history.source import PlanSource
from replay.retrace.guided_run import run_plan, spec_of
from replay.retrace.plan_process import PlanProcess, lay

_DISPLACED: Final = 0.01  # m
LIMIT: Final = 10.0  # maximum duration of a trial: a multiple of the control run's duration,
LEAST: Final = 20.0  # but at least this many seconds of wall-clock time
_SLOWER: Final = 10.0  # the control run may last so many times longer than a trial, because the machine may be busy now
#: Python's audit events for access to other processes and machines.
_REACHING: Final = frozenset(
    {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "socket.bind"}
)
#: Python's audit events for changes of files, with the index of the path among the event's arguments.
_CHANGING: Final = {"os.remove": 0, "os.rename": 1, "os.rmdir": 0, "os.mkdir": 0, "shutil.rmtree": 0}
_WRITES: Final = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


class OutsideEffect(BaseException):
    """A trial has an effect outside of its folder. Plans don't catch this error, because it isn't an ``Exception``."""


class PlanHasEffects(ReplayError):
    """A plan can't be tried, because it would change files outside of its folder, or reach other processes."""

    def __init__(self, what: str) -> None:
        super().__init__(
            f"the plan has effects outside of its folder: {what}; allow them in each trial with --allow-effects"
        )
        self.what = what


@dataclass(frozen=True, slots=True)
class Version:
    """A version of a plan, and how the conditions of its run differ from the recorded conditions."""

    text: str  # the source of the plan's main file
    file: Path | None = None  # its recording
    seed: int | None = None
    elsewhere: int = 0  # seed for displacing each loose object by 1 cm; 0 for no displacement


class Trials:
    """Runs edited versions of a recorded plan, several in parallel.

    Raises:
        CantRetrace: the plan is missing, the recording lacks the run's conditions, or they can't be repeated.
    """

    def __init__(self, log: RecordReader, *, allow_effects: bool = False) -> None:
        process = PlanProcess(log, recorded_source=True)
        self.log = log
        self.program = process.program  # the main file of the plan
        self.text = PlanSource(log).text(str(process.program))  # its recorded source
        self.runs = 0  # number of started runs
        self.failed: set[str] = set()  # versions that a search has already rejected
        self.reference = Ending("")  # the ending of the run of the unchanged plan
        # made here, because children must not read the recording's file
        self._spec = spec_of(log, process.began, process.program, process.arguments)
        self._began = process.began
        self._allow_effects = allow_effects
        self._limit = max(LEAST, LIMIT * (log[-1].monotonic_ns - process.began.monotonic_ns) / 1e9)
        self._undoing = ExitStack()
        self._folder = Path(self._undoing.enter_context(tempfile.TemporaryDirectory(prefix="pycram-trials-")))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._undoing.close()

    def control(self) -> Ending:
        """Run the unchanged plan; its ending is the reference.

        Raises:
            ReplayError: the run doesn't end like the recorded run.
        """
        least = self._limit
        self._limit = _SLOWER * least
        began = time.monotonic()
        self.reference = self.one(self.text)
        self._limit = max(least, LIMIT * (time.monotonic() - began))
        recorded = EndingSink()
        for record in self.log:
            recorded.write("", record, b"")
        if not alike(recorded.ending, self.reference, worded=is_worded_alike(self.log)):
            now = self.reference.failure or self.reference.kind
            raise ReplayError(f"the plan doesn't end as recorded: now {now}; was {recorded.ending.failure}")
        return self.reference

    def one(self, text: str, file: Path | None = None) -> Ending:
        """Run one version, and record it if a file is given."""
        return self.all([Version(text, file)])[0]

    def all(self, versions: Sequence[Version]) -> list[Ending]:
        """Run versions in parallel; return their endings."""
        pool: ChildPool[tuple[int, Version]] = ChildPool(usable_cores(), self._limit, GRACE)
        endings: dict[int, Ending] = {}

        def start(job: tuple[int, Version]) -> Child:
            self.runs += 1
            place = self._folder / str(self.runs) / self.program.parent.name
            lay({Path(self.program.name): job[1].text.encode()}, self.program.parent, place)
            plan = place / self.program.name
            return run_from_start(partial(self._answer, plan, job[1], job[1].file and job[1].file.absolute()))

        with closing(pool.run(deque(enumerate(versions)), start)) as results:
            for (index, _), result in results:
                answer = json.loads(result.answer) if result.answer else {}
                if answer.get("outside"):
                    raise PlanHasEffects(answer["outside"])
                endings[index] = Ending(**answer["ending"]) if answer else Ending("died", f"its process {result.how}")
                if result.late:
                    endings[index] = Ending("time limit", f"it was still running after {self._limit:.0f} s")
        return [endings[index] for index in range(len(versions))]

    def _answer(self, plan: Path, version: Version, file: Path | None) -> bytes:
        """Run a plan in this child process, which changes its folder; return its ending as JSON."""
        sinks: list[EndingSink] = []
        outside: list[str] = []

        def sink_of(began: Run) -> Sink:
            if sinks:
                return NullSink()  # only the plan's first recording counts
            sinks.append(EndingSink(None if file is None else McapSink(file, metadata(began))))
            if not self._allow_effects:  # not earlier, because the recorder runs git to read the plan's revision
                allowed = filter(None, (plan.parents[1], store.folder(), file and file.parent, cache_folder()))
                _watch_effects([each.resolve() for each in allowed], outside)
            return sinks[-1]

        tempfile.tempdir = str(plan.parents[1])
        with suppress(OSError):
            os.chdir(self._began.directory)
        seed = self._spec.seed if version.seed is None else version.seed
        spec = replace(self._spec, plan=plan, seed=seed)
        with redirected(sink_of), _loose_objects_elsewhere(version.elsewhere):
            run_plan(self._began, spec, file or Path(os.devnull), overwrite=True)
        ending = sinks[0].ending if sinks else Ending("died", "it couldn't be recorded")
        return json.dumps({"ending": asdict(ending), "outside": outside[0] if outside else ""}).encode()


def _watch_effects(allowed: Sequence[Path], outside: list[str]) -> None:
    """Reject effects of this process outside of the given folders, and store the first rejected effect."""

    def is_inside(path: object) -> bool:
        if isinstance(path, int):
            return True  # a file descriptor of a file that is already open
        with suppress(OSError, ValueError, TypeError):
            target = Path(os.fsdecode(path)).resolve()  # type: ignore[arg-type]
            return target == Path(os.devnull) or any(target.is_relative_to(folder) for folder in allowed)
        return True

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, mode, flags = arguments
            writes = bool(flags & _WRITES) if isinstance(flags, int) else bool(set(str(mode)) & set("wax+"))
            refused = writes and not is_inside(path)
        elif event in _CHANGING:
            path = arguments[_CHANGING[event]]
            refused = not is_inside(path) and not (event == "os.mkdir" and Path(os.fsdecode(path)).is_dir())
        else:
            refused = event in _REACHING
            path = arguments
        if refused:
            outside.append(f"{event} {path!r:.100}")
            raise OutsideEffect(outside[0])

    sys.addaudithook(audit)


@contextmanager
def _loose_objects_elsewhere(draw: int) -> Iterator[None]:
    """In this process, load loose objects 1 cm away from where the plan loads them, on the ground plane."""
    if not draw:
        yield
        return
    dice, load = random.Random(draw), Object.__init__

    def moved(*given: Any, **named: Any) -> None:
        bound = inspect.signature(load).bind(*given, **named)
        bound.apply_defaults()
        if bound.arguments["type"] not in ("robot", "environment"):
            angle = dice.uniform(-math.pi, math.pi)
            x, y, z = bound.arguments["position"]
            bound.arguments["position"] = [x + _DISPLACED * math.cos(angle), y + _DISPLACED * math.sin(angle), z]
        load(*bound.args, **bound.kwargs)

    Object.__init__ = moved  # type: ignore[method-assign]
    try:
        yield
    finally:
        Object.__init__ = load  # type: ignore[method-assign]


def alike(one: Ending, other: Ending, *, worded: bool = True) -> bool:
    """Return whether two runs ended with the same failure at the same line (:func:`replay.compare.signature`)."""
    ends = (one, other)
    return len({(each.kind, signature(each.failure, worded=worded), Path(each.plan_line).name) for each in ends}) == 1
