"""Runs of a sweep on this machine: forks of this process, which has done what all begin with.

A run whose process crashes, hangs or is killed is tried once more; when that fails too, its recording says so.
"""

from __future__ import annotations

import glob
import json
import time
from collections import deque
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.models import store, warming
from pycram.physics.head_start import HeadStart
from pycram.projection.child import usable_cores
from pycram.projection.limited import Several
from pycram.sweeping.one_run import Outcome, hooks, run_once
from recorder.mcap.shared_models import SharedModels, share_models
from recorder.packages import versions
from recorder.recording import look_up_revisions

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    from pycram.projection.limited import LimitedChild
    from pycram.sweeping.one_run import Spec

_ATTEMPTS: Final = 2
_COMPARED: Final = 2  # runs, to see in what they begin alike


class _Job(NamedTuple):
    """A run that is to be made, or its loss that is to be recorded."""

    number: int
    attempt: int = 1
    lost: str = ""


class Local:
    """Makes runs on this machine.

    Args:
        spec: The sweep's.
        cores: How many at once; 0 for as many as there are.
        models: The name of the file of models that recordings share; None until a run has loaded some.
    """

    def __init__(self, spec: Spec, cores: int = 0, models: str | None = None) -> None:
        # what plans import, once for all runs
        import numpy.random  # noqa: F401, PLC0415

        from pycram import bullet_world_reasoning, event, fluent, language, process_module  # noqa: F401, PLC0415

        self._spec = spec
        self._several: Several[_Job] = Several(cores or usable_cores(), spec.limit)
        self._models = SharedModels.of(Path(spec.folder) / models) if models else None
        self._calls: list[str] = []  # of runs, as they have noted them
        self._start: HeadStart | None = None
        store.folder()  # all share it
        hooks()
        versions()
        look_up_revisions(Path(spec.plan))

    @property
    def models(self) -> dict[str, str] | None:
        """Name and hash of the file of models; None as long as there is none."""
        return None if self._models is None else {"file": self._models.file, "sha256": self._models.sha256}

    def close(self) -> None:
        """End the head start of runs; none of them goes on when the iteration over them has ended."""
        if self._start is not None:
            self._start.close()

    def run(self, numbers: Iterable[int]) -> Generator[Outcome, None, None]:
        """Make runs; yield their outcomes as they end. None goes on when the iteration has ended."""
        waiting = deque(map(_Job, numbers))
        going = {job.number for job in waiting}
        try:
            with closing(self._several.run(waiting, self._answer_of)) as ended:
                for job, process in ended:
                    again = self._again(job, process)
                    if again is not None:
                        waiting.appendleft(again)
                    else:
                        going.discard(job.number)
                        yield self._outcome(job, process)
        finally:
            for number in going:  # what those have written that were ended
                self._spec.part(number).unlink(missing_ok=True)

    def _answer_of(self, job: _Job) -> Callable[[], bytes]:
        began = time.monotonic()  # of its time limit, which a process can't begin later than it counts
        start = self._start
        return partial(run_once, self._spec, job.number, job.attempt, self._models, began, start=start, lost=job.lost)

    def _again(self, job: _Job, process: LimitedChild) -> _Job | None:
        """Return what is to be done about a run that hasn't ended by itself; None if it has, or nothing can be."""
        received = bool(process.child.received)
        if job.lost or (received and not process.late):
            return None
        if job.attempt < _ATTEMPTS:
            recording = Path(self._spec.folder) / self._spec.name(job.number)
            for left in (recording, *recording.parent.glob(f"{glob.escape(recording.stem)}.projection-*")):
                left.unlink(missing_ok=True)
            return _Job(job.number, job.attempt + 1)
        if received:  # it was interrupted, and its recording says so
            return None
        cause = f"it still ran after {self._spec.limit:g} s, and had to be killed" if process.late else process.how
        cause += f", at each of {_ATTEMPTS} attempts"
        part = self._spec.part(job.number)
        if part.exists():
            kept = part.replace(Path(self._spec.folder) / f"{self._spec.name(job.number)}.killed")
            cause += f"; what it had recorded is in {kept.name}"
        return _Job(job.number, job.attempt, cause)

    def _outcome(self, job: _Job, process: LimitedChild) -> Outcome:
        if not process.child.received:  # not even that could be recorded
            return Outcome(job.number, self._spec.name(job.number), succeeded=False, unrecorded=process.how)
        answer = json.loads(process.child.received)
        outcome = Outcome(**answer["outcome"])
        if answer["noted"] is not None and self._start is None:
            self._prepare(*answer["noted"])
        if self._models is None and not outcome.unrecorded:
            self._models = share_models(Path(self._spec.folder) / outcome.name)
        return outcome

    def _prepare(self, notes: str, calls: str) -> None:
        """Do what runs had better find done."""
        if not self._calls:
            warming.warm(notes)
        self._calls.append(calls)
        if len(self._calls) == _COMPARED:
            self._start = HeadStart(*self._calls)
            self._calls.clear()
