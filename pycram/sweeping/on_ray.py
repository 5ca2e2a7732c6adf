"""Sweeps on a Ray cluster: Ray tasks make batches of runs, and recordings go to a folder that all nodes can write to.

Ray repeats the batches of a lost node, but doesn't make runs again that have a recording. Each Ray process keeps a
:class:`~pycram.sweeping.local.Worker` that has loaded all modules. PyCRAM and the plan must have the same paths on all
nodes.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from pycram.sweeping import SWEEP, Sweep, SweepRefused, begin, facts_of, locked, write
from pycram.sweeping.local import RunOutcome, SweepSpec, Worker
from recorder.mcap_writer import MODELS_NAME
from recorder.packages import needed

with needed():
    import fsspec
    import ray

_BATCH: Final = 10  # number of runs of a task; starting a task takes some ms, and a lost node loses its batches
_CALLS: Final = 50  # number of batches after which a Ray process ends
_AHEAD: Final = 3  # number of waiting batches per core


def sweep_on_ray(
    spec: SweepSpec, runs: int, url: str, address: str, cores: int, progress: Callable[[Sweep, RunOutcome | None], None]
) -> Sweep:
    """Sweep into the folder ``url`` on a cluster; see :func:`pycram.sweeping.sweep`."""
    store = _Store(url)
    with ExitStack() as within, tempfile.TemporaryDirectory(prefix="pycram-sweep-") as here:
        if store.is_local:
            within.enter_context(locked(Path(store.root)))
        if not ray.is_initialized():
            ray.init(
                address=address or None, num_cpus=(cores or None) if not address else None, logging_level=logging.ERROR
            )
            within.callback(ray.shutdown)
        facts = facts_of(spec, runs)
        store.fetch(SWEEP, Path(here))
        models = (begin(Path(here), facts).get("models") or {}).get("file")
        there = store.names()
        models = models if models in there else None
        missing = [number for number in range(runs) if spec.name(number) not in there]
        result = Sweep(url, runs, before=runs - len(missing))
        store.put(Path(here) / SWEEP)
        progress(result, None)
        # the first run is a batch of its own, because it shows whether the plan can start
        batches = iter([missing[:1], *(missing[start : start + _BATCH] for start in range(1, len(missing), _BATCH))])
        try:
            for outcome in _made(spec, url, [next(batches)], models, 1):
                if not result.take(outcome):
                    return result
                if result.has_not_begun():
                    store.set_aside(outcome.name, result.failures[0].name)
                    return result
                progress(result, outcome)
            models = models or next(filter(MODELS_NAME.fullmatch, sorted(store.names())), None)
            write(Path(here), {**facts, "models": None if models is None else store.described(models)})
            store.put(Path(here) / SWEEP)
            resources: Callable[[], dict[str, float]] = ray.cluster_resources
            for outcome in _made(spec, url, batches, models, cores or int(resources().get("CPU", 1))):
                if not result.take(outcome):
                    return result
                progress(result, outcome)
        except KeyboardInterrupt:
            result.interrupted = True
    return result


def _made(spec: SweepSpec, url: str, batches: Any, models: str | None, cores: int) -> Iterator[RunOutcome]:
    """Submit a few more batches than there are cores; yield the outcomes when they arrive."""
    task = ray.remote(num_cpus=1, max_calls=_CALLS, max_retries=-1)(_make)
    waiting = iter(batches)
    running: list[Any] = []
    try:
        while True:
            while len(running) < cores * _AHEAD and (batch := next(waiting, None)) is not None:
                if batch:
                    running.append(task.remote(spec.as_json(), url, list(batch), models))
            if not running:
                return
            ended, running = ray.wait(running)
            for each in ended:
                yield from (RunOutcome(**outcome) for outcome in ray.get(each))
    finally:
        for each in running:
            ray.cancel(each, force=True)


class _Store:
    """The folder of a sweep, given by a URL; a plain path is a folder that all nodes share."""

    def __init__(self, url: str) -> None:
        given = url if "://" in url else str(Path(url).absolute())
        try:
            self._files, self.root = fsspec.core.url_to_fs(given)
        except (ImportError, ValueError) as error:  # fsspec doesn't support the protocol, or needs another package
            raise SweepRefused(f"{url}: {error}; all nodes must support this URL") from error
        kinds = (self._files.protocol, *self._files.protocol)  # the protocol is a string or a tuple
        if "memory" in kinds:
            raise SweepRefused(f"{url}: files there are lost when the process ends; name a folder or another URL")
        self.is_local = "file" in kinds
        self._files.makedirs(self.root, exist_ok=True)

    def names(self) -> set[str]:
        self._files.invalidate_cache()
        return {Path(each).name for each in self._files.ls(self.root, detail=False)}

    def has(self, name: str) -> bool:
        """Return whether a file exists; the folder isn't listed, because it may be large."""
        self._files.invalidate_cache()
        found: bool = self._files.exists(f"{self.root}/{name}")
        return found

    def put(self, file: Path, within: str = "") -> None:
        """Copy a file atomically into the folder, or into its subfolder ``within``."""
        folder = f"{self.root}/{within}" if within else self.root
        target = f"{folder}/{file.name}"
        if self.is_local:  # uploads to object storage are atomic
            self._files.makedirs(folder, exist_ok=True)
            part = f"{folder}/.{file.name}.part"
            self._files.put_file(str(file), part)
            shutil.copystat(file, part)  # tables identify recordings by their times of modification
            os.replace(part, target)  # noqa: PTH105  both are strings
        else:
            self._files.put_file(str(file), target)

    def fetch(self, name: str, folder: Path) -> None:
        if self._files.exists(f"{self.root}/{name}") and not (folder / name).exists():
            self._files.get_file(f"{self.root}/{name}", str(folder / name))

    def set_aside(self, name: str, kept: str) -> None:
        """Rename the recording of a plan that can't start, so that the folder accepts the repaired plan."""
        self._files.mv(f"{self.root}/{name}", f"{self.root}/{kept}")
        self._files.rm(f"{self.root}/{SWEEP}")

    def described(self, name: str) -> dict[str, str]:
        return {"file": name, "sha256": hashlib.sha256(self._files.cat_file(f"{self.root}/{name}")).hexdigest()}


_worker: Worker | None = None  # the worker of this Ray process


def _warm(spec: SweepSpec, models: str | None) -> Worker:
    """Return the worker of this Ray process, which records into a temporary folder."""
    global _worker  # noqa: PLW0603
    if _worker is None:
        folder = tempfile.mkdtemp(prefix="pycram-sweep-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        _worker = Worker(replace(spec, folder=folder), 1)
    _worker.spec, _worker.shared = replace(spec, folder=_worker.spec.folder), models
    return _worker


def _make(spec_facts: dict[str, Any], url: str, numbers: list[int], models: str | None) -> list[dict[str, Any]]:
    global _worker  # noqa: PLW0603
    spec, store = SweepSpec.of_json(spec_facts), _Store(url)
    worker = _warm(spec, models)
    folder = Path(worker.spec.folder)
    if models is not None:
        store.fetch(models, folder)
    missing = [number for number in numbers if not store.has(spec.name(number))]
    # a node made these runs, but was lost with their outcomes
    outcomes = [_known(store, spec, number, folder) for number in numbers if number not in missing]
    finished = False
    try:
        for outcome in worker.run(missing):
            if not outcome.unrecorded:
                for made in sorted(folder.rglob(f"{outcome.number:05}.*"), reverse=True):  # also its neighbouring files
                    within = made.parent.relative_to(folder).as_posix().removeprefix(".")
                    if store.is_local or not within:  # copies have new times, which tables don't know
                        store.put(made, within)
                    made.unlink()
            outcomes.append(asdict(outcome))
        finished = True
    finally:
        if not finished:  # the worker may still be running this batch
            worker.close()
            _worker = None
    for made in folder.glob("models-*.mcap"):
        if not store.has(made.name):
            store.put(made)
    return outcomes


def _known(store: _Store, spec: SweepSpec, number: int, folder: Path) -> dict[str, Any]:
    from mcap.reader import make_reader  # noqa: PLC0415

    from recorder.records import Run, format_failure  # noqa: PLC0415

    name = spec.name(number)
    store.fetch(name, folder)
    with (folder / name).open("rb") as file:
        runs = [Run.FromString(each.data) for _, _, each in make_reader(file).iter_messages(topics=["/run"])]
    (folder / name).unlink()
    ends = [run for run in runs if run.phase == Run.FINISHED]
    succeeded = bool(ends) and ends[-1].succeeded
    return asdict(
        RunOutcome(number, name, succeeded, "" if succeeded or not ends else format_failure(ends[-1].failure))
    )
