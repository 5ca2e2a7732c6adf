"""Runs of a sweep on this machine, in forks of this process, or of a process of its own.

:class:`Local` forks this process, after it has done the work that all runs share. A run whose process crashes, hangs or
is killed is tried once more; if that fails too, its recording says so.

:class:`Worker` uses another process, because this one can't fork: it has threads, like Ray's and Jupyter's, or worlds.
The worker reads batches as lines of JSON. It writes a line with each run's outcome, and after each batch one with the
file of models. It stays warm between batches.
"""

from __future__ import annotations

import contextlib
import glob
import json
import os
import subprocess
import sys
import time
from collections import deque
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.models import store, warming
from pycram.projection.child import die_with, usable_cores
from pycram.projection.pool import GRACE, ChildPool, run_from_start
from pycram.sweeping.one_run import RunOutcome, Spec, hooks, run_once
from recorder.mcap_writer import SharedModels, share_models
from recorder.packages import versions
from recorder.recording import look_up_revisions

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

    from pycram.projection.child import Child
    from pycram.projection.pool import ChildResult


_ATTEMPTS: Final = 2


class _Job(NamedTuple):
    """A run to be made, or a lost run to be recorded."""

    number: int
    attempt: int = 1
    lost: str = ""  # why its process ended in each attempt


class Local:
    """Makes runs in forks of this process.

    Args:
        spec: Of the sweep.
        cores: Maximum number of parallel runs; 0 for one on each core.
        models: Name of the file of models that recordings share; None until a run has loaded some.
    """

    def __init__(self, spec: Spec, cores: int = 0, models: str | None = None) -> None:
        # the modules that plans import, once for all runs
        import numpy.random  # noqa: F401, PLC0415

        from pycram import bullet_world_reasoning, event, fluent, language, process_module  # noqa: F401, PLC0415

        self._spec = spec
        self._pool: ChildPool[_Job] = ChildPool(cores or usable_cores(), spec.limit, GRACE)
        self._models = SharedModels.of(Path(spec.folder) / models) if models else None
        self._warm = False  # whether this process has computed what a run has noted
        store.folder()  # shared by all runs
        hooks()
        versions()
        look_up_revisions(Path(spec.plan))

    @property
    def models(self) -> dict[str, str] | None:
        """Name and hash of the file of models; None as long as there is none."""
        return None if self._models is None else {"file": self._models.file, "sha256": self._models.sha256}

    def close(self) -> None:
        """Release nothing; a :class:`Worker` has a process to end."""

    def run(self, numbers: Iterable[int]) -> Generator[RunOutcome, None, None]:
        """Make runs; yield their outcomes as they end. Closing the generator kills the remaining runs."""
        waiting = deque(map(_Job, numbers))
        going = {job.number for job in waiting}
        try:
            with closing(self._pool.run(waiting, self._start)) as results:
                for job, result in results:
                    again = self._again(job, result)
                    if again is not None:
                        waiting.appendleft(again)
                    else:
                        going.discard(job.number)
                        yield self._outcome(job, result)
        finally:
            for number in going:  # incomplete recordings of runs that were killed
                self._spec.part(number).unlink(missing_ok=True)

    def _start(self, job: _Job) -> Child:
        began = time.monotonic()  # no later than its time limit begins
        once = partial(run_once, self._spec, job.number, job.attempt, self._models, began)
        return run_from_start(partial(once, noting=not self._warm, lost=job.lost))

    def _again(self, job: _Job, result: ChildResult) -> _Job | None:
        """Return the next job for a run that didn't end by itself; None if it did, or nothing more can be done."""
        if job.lost or (result.answer and not result.late):
            return None
        if job.attempt < _ATTEMPTS:
            recording = Path(self._spec.folder) / self._spec.name(job.number)
            for left in (recording, *recording.parent.glob(f"{glob.escape(recording.stem)}.projection-*")):
                left.unlink(missing_ok=True)
            return _Job(job.number, job.attempt + 1)
        if result.answer:  # it was interrupted, and its recording says so
            return None
        how = f"its process {result.how}"
        cause = f"it still ran after {self._spec.limit:g} s, and had to be killed" if result.late else how
        cause += f", at each of {_ATTEMPTS} attempts"
        part = self._spec.part(job.number)
        if part.exists():
            kept = part.replace(Path(self._spec.folder) / f"{self._spec.name(job.number)}.killed")
            cause += f"; what it had recorded is in {kept.name}"
        return _Job(job.number, job.attempt, cause)

    def _outcome(self, job: _Job, result: ChildResult) -> RunOutcome:
        if not result.answer:  # even its loss couldn't be recorded
            how = f"its process {result.how}"
            return RunOutcome(job.number, self._spec.name(job.number), succeeded=False, unrecorded=how)
        answer = json.loads(result.answer)
        outcome = RunOutcome(**answer["outcome"])
        if answer["notes"] is not None and not self._warm:
            warming.warm(answer["notes"])
            self._warm = True
        if self._models is None and not outcome.unrecorded:
            self._models = share_models(Path(self._spec.folder) / outcome.name)
        return outcome


class WorkerLost(RuntimeError):
    """The process that makes runs has ended."""


class Worker:
    """Makes runs as :class:`Local` does, in forks of another process; takes the same arguments."""

    def __init__(self, spec: Spec, cores: int = 0, shared: str | None = None) -> None:
        self.spec = spec  # of the next batch
        self.shared = shared  # name of the file of models, for the next batch
        self.models: dict[str, str] | None = None  # name and hash of that file after the last batch
        self._cores = cores
        self._process = subprocess.Popen(  # noqa: S603  ours
            [sys.executable, "-P", "-c", f"from {__name__} import main; main()", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONHASHSEED": str(spec.seed)},
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C goes to the sweeping process, which kills this one
        )

    def close(self) -> None:
        """Kill the process, and with it its runs."""
        self._process.kill()
        self._process.communicate()

    def run(self, numbers: Iterable[int]) -> Generator[RunOutcome, None, None]:
        """Make runs; yield their outcomes as they end. Closing the generator kills the remaining runs.

        Raises:
            WorkerLost: The process has ended.
        """
        left = dict.fromkeys(numbers)
        if not left:
            return
        batch = {"spec": asdict(self.spec), "numbers": [*left], "models": self.shared, "cores": self._cores}
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
            raise WorkerLost(f"the process that makes runs has ended with {self._process.wait()}")
        finally:
            if left:
                self.close()
            for number in left:  # incomplete recordings of runs that were killed
                self.spec.part(number).unlink(missing_ok=True)


def main() -> None:
    """Make the runs of batches until stdin ends."""
    die_with(int(sys.argv[1]))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # libraries may print there
    local: Local | None = None
    of: object = None
    for line in sys.stdin:
        batch = json.loads(line)
        key = batch["spec"], batch["models"]
        if local is None or of != key:
            spec = Spec(**{**batch["spec"], "arguments": tuple(batch["spec"]["arguments"])})
            local, of = Local(spec, batch["cores"], batch["models"]), key
        for outcome in local.run(batch["numbers"]):
            print(json.dumps({"outcome": asdict(outcome)}), file=answers, flush=True)
        print(json.dumps({"models": local.models}), file=answers, flush=True)
