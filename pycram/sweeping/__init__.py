"""Sweeps: a plan runs many times, with different seeds and parameters, and records each run into a folder.

Each run is a fork of a process that has already loaded the modules and models of all runs. A run executes the whole
plan with its own seed, so its recording can be verified and retraced. ``sweep.json`` in the folder describes the sweep.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shlex
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from pycram import plan_parameters
from pycram.foundation import checks
from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, UsageError
from pycram.plan_parameters import Variations
from pycram.projection.child import can_limit_memory
from pycram.running import MAX_SEED, RunSpec
from pycram.scheduling.schedule import refuse_held
from pycram.sweeping.local import Local, RunLost, RunOutcome, SweepSpec, Worker, WorkerLost
from pycram.world.world import open_worlds
from recorder import system
from recorder.errors import similar_files
from recorder.tracing import forking

__all__ = ["LIMIT", "RunLost", "RunOutcome", "Sweep", "SweepRefused", "sweep"]

LIMIT: Final = 300.0  # default time limit of a run in s
FORMAT: Final = 1  # version of the format of sweep.json
SWEEP: Final = "sweep.json"
_LOCK: Final = "sweep.lock"
_PART: Final = re.compile(r"\.(\d{5,}.*\.mcap|models-.*\.mcap|sweep\.json)\.part")
_MAY_CHANGE: Final = frozenset({"runs", "plan"})  # the entries of sweep.json that a restarted sweep may change
_KEPT: Final = 100  # maximum number of failures and of remarks that a Sweep keeps
_held: Final[set[Path]] = set()  # folders into which this process is sweeping


class SweepRefused(UsageError):
    """A sweep can't run, or can't use this folder."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause  # why the sweep can't run, and what to do


export("pycram.sweeping", SweepRefused)


@dataclass(slots=True)
class Sweep:
    """The progress and result of a sweep."""

    folder: str  # folder of the recordings
    runs: int  # requested number of runs
    before: int = 0  # number of runs that earlier sweeps made into this folder
    done: int = 0  # number of runs that this sweep made
    failed: int = 0  # number of runs of this sweep that failed
    failures: list[RunOutcome] = field(default_factory=list)  # the first failed runs
    stopped: str = ""  # why the sweep stopped before its last run; "" if it made all runs
    interrupted: bool = False  # whether Ctrl-C interrupted the sweep
    remarks: list[str] = field(default_factory=list)  # errors of hooks

    def take(self, outcome: RunOutcome) -> bool:
        """Count a run; return whether it was recorded. Without a record, the sweep stops."""
        if outcome.unrecorded:
            self.stopped = f"run {outcome.number} couldn't be recorded: {outcome.unrecorded}"
            return False
        if outcome.remark and len(self.remarks) < _KEPT:
            self.remarks.append(f"{outcome.name}: {outcome.remark}")
        self.done += 1
        if not outcome.succeeded:
            self.failed += 1
            if len(self.failures) < _KEPT:
                self.failures.append(outcome)
        return True

    def has_not_begun(self) -> bool:
        """Return whether the first run failed before the plan began to act; then all other runs would fail, too."""
        if self.before or self.done > 1 or not self.failures:
            return False
        first = self.failures[0]
        if first.started and not first.lost:
            return False
        self.stopped = f"the first run failed before the plan did anything: {first.failure}"
        self.failures = [replace(first, name=f"{first.name}.failed")]  # the recording gets another name
        return True


def sweep(
    plan: str | Path,
    runs: int,
    folder: str | Path,
    *,
    seed: int = 0,
    set: Mapping[str, Sequence[Any]] | None = None,  # noqa: A002  the option's name on the command line
    sample: Mapping[str, str] | None = None,
    cores: int = 0,
    limit: float = LIMIT,
    memory: int = 0,
    arguments: Sequence[str] = (),
    motion: str = "",
    locals: bool = True,  # noqa: A002  Python's names
    check: Sequence[str] = (),
    ray: str | None = None,
    progress: Callable[[Sweep, RunOutcome | None], None] = lambda _, __: None,
) -> Sweep:
    """Run a plan many times, and record each run into a file of a folder.

    Runs are forks of this process. If this process has worlds or threads, runs are forks of another process.

    Args:
        runs: Number of runs, which are numbered from 0.
        folder: Folder for the recordings. If the folder already contains runs of this sweep, only the missing runs are
            made. With ``ray``, the folder is shared by all nodes, or is any URL that fsspec supports.
        seed: Run N has the seed ``seed + N``, which also determines its drawn parameters.
        set: Values of parameters; the runs take all combinations in turn.
        sample: Distributions of parameters, such as ``"uniform(0,1)"``, ``normal``, ``integers`` or ``choice``.
        cores: Maximum number of parallel runs; 0 for one per core.
        limit: Time limit of each run in seconds of wall-clock time.
        memory: Limit of additional memory for each run in bytes; 0 for no limit.
        motion: The execution environment if the plan doesn't name one.
        locals: Whether failures contain the local variables of the plan's functions.
        check: Properties (docs/reference/properties.md); a violation fails the run.
        ray: The address of a Ray cluster, or "" for a cluster on this machine; None for no cluster.
        progress: Called at the start and after each run.

    Raises:
        SweepRefused: The folder has another sweep or is in use, or the system can't fork.
        UnknownParameter: The plan doesn't declare the parameter.
        BadArgument: An argument is wrong.
        LockHeld: The caller holds a lock.
    """
    refuse_held()
    file, listed, sampled = Path(plan), set or {}, sample or {}
    if not file.is_file():
        raise BadArgument("plan", str(plan), f"the file of a plan{similar_files(file)}")
    _check(limit, memory, seed, runs, cores)
    try:
        for values in Variations(listed, sampled).every():
            plan_parameters.check(file, values)
    except SyntaxError as error:
        raise SweepRefused(f"{plan}: {error}") from error
    spec = SweepSpec(
        RunSpec(file.absolute(), tuple(arguments), motion=motion, checks=tuple(check), local_variables=locals),
        str(Path(folder).absolute()),
        int(seed),
        {name: list(values) for name, values in listed.items()},
        dict(sampled),
        float(limit),
        int(memory),
    )
    if ray is not None:
        from pycram.sweeping.on_ray import sweep_on_ray  # noqa: PLC0415  needs an extra

        return sweep_on_ray(spec, runs, str(folder), ray, cores, progress)
    if "://" in str(folder):
        raise BadArgument("folder", str(folder), "a folder; a URL is for a Ray cluster (--ray)")
    if not hasattr(os, "fork"):
        raise SweepRefused("this system can't copy a process (os.fork)")
    if memory and not can_limit_memory():
        raise SweepRefused("this system can't limit the memory of a run; leave out the limit (memory, --memory)")
    with locked(Path(spec.folder)):
        return _sweep(spec, runs, cores, progress)


def _check(limit: float, memory: int, seed: int, runs: int, cores: int) -> None:
    if checks.number("limit", limit) <= 0 or limit > threading.TIMEOUT_MAX:
        raise BadArgument("limit", limit, "seconds, more than 0")
    if checks.number("memory", memory) < 0:
        raise BadArgument("memory", memory, "bytes, 0 for no limit")
    if checks.number("seed", seed) != int(seed) or not 0 <= seed <= MAX_SEED:
        raise BadArgument("seed", seed, f"a whole number from 0 to {MAX_SEED}")
    checks.count("runs", runs, least=1)
    checks.count("cores", cores)


def _sweep(spec: SweepSpec, runs: int, cores: int, progress: Callable[[Sweep, RunOutcome | None], None]) -> Sweep:
    folder = Path(spec.folder)
    facts = facts_of(spec, runs)
    models = (begin(folder, facts).get("models") or {}).get("file")
    there = {each.name for each in folder.iterdir()}
    missing = [number for number in range(runs) if spec.name(number) not in there]
    result = Sweep(spec.folder, runs, before=runs - len(missing))
    progress(result, None)
    if not missing:
        return result
    # a fork would have none of this process's threads, but all of its worlds
    kind = Worker if forking.others() or open_worlds() else Local
    try:
        with closing(kind(spec, cores, models if models in there else None)) as process:
            for numbers in (missing[:1], missing[1:]):
                with closing(process.run(numbers)) as outcomes:
                    for outcome in outcomes:
                        if not result.take(outcome):
                            return result
                        if result.has_not_begun():
                            kept = (folder / outcome.name).replace(folder / result.failures[0].name)
                            (folder / SWEEP).unlink(missing_ok=True)  # the folder then accepts the repaired plan
                            result.stopped += f"; pycram-replay why {shlex.quote(str(kept))}"
                            return result
                        progress(result, outcome)
                if process.models:
                    write(folder, {**facts, "models": process.models})
    except KeyboardInterrupt:
        result.interrupted = True
    except WorkerLost as error:
        result.stopped = f"{error}; restart the sweep to make the missing runs"
    return result


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create and lock a folder for the ``with`` block; raise SweepRefused if another sweep uses it, or on errors."""
    held = folder.resolve()
    who = f"process {os.getpid()} on {platform.node()} (since {time.strftime('%Y-%m-%d %H:%M:%S')})"
    if held in _held:  # if the file were opened and closed again, the lock would be released
        raise _in_use(folder, who.partition(" (")[0])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | system.OPENED | system.NO_LINK, 0o666)
    except OSError as error:
        raise SweepRefused(f"{folder}: {error.strerror or error}") from error
    with os.fdopen(lock, "r+", encoding="utf-8", errors="replace") as file:
        try:
            system.lock(lock, by_process=True)  # forks don't hold this lock, because they may outlive this process
        except BlockingIOError:
            raise _in_use(folder, file.read(200).strip() or "another process") from None
        except OSError:  # the file system has no locks
            pass
        file.truncate(0)
        file.write(f"{who}\n")
        file.flush()
        _held.add(held)
        for part in folder.iterdir():
            if _PART.fullmatch(part.name):  # a killed sweep has left this file
                part.unlink(missing_ok=True)
        try:
            yield
        finally:
            _held.discard(held)
            with suppress(OSError):
                file.truncate(0)


def _in_use(folder: Path, who: str) -> SweepRefused:
    return SweepRefused(f"{folder}: {who} is sweeping into this folder; wait for its end, or name another folder")


def begin(folder: Path, facts: Mapping[str, Any]) -> Mapping[str, Any]:
    """Write a sweep's description; return the folder's earlier one, or {}; raise SweepRefused for another sweep."""
    file = folder / SWEEP
    before: dict[str, Any] = {}
    if file.exists():
        try:
            before = json.loads(file.read_text(encoding="utf-8"))
            known = {key: before[key] for key in facts}
        except (OSError, ValueError, KeyError, TypeError) as error:
            cause = f"the file is damaged, or from another release ({error})"
            raise SweepRefused(f"{file}: {cause}; name another folder") from error
        given = json.loads(json.dumps(dict(facts)))
        differing = [key for key in given if key not in _MAY_CHANGE and given[key] != known[key]]
        if differing:
            key = differing[0]
            what = f"the {key} was {known[key]!r}, not {given[key]!r}"
            what = "the plan was different" if key == "plan_sha256" else what
            raise SweepRefused(f"{folder}: the folder has another sweep, and {what}; name another folder")
    write(folder, {**facts, "models": before.get("models")})
    return before


def write(folder: Path, facts: Mapping[str, Any]) -> None:
    """Write the description of a sweep, atomically."""
    part = folder / f".{SWEEP}.part"
    part.write_text(json.dumps({"format": FORMAT, **facts}, indent=1) + "\n", encoding="utf-8")
    part.replace(folder / SWEEP)


def facts_of(spec: SweepSpec, runs: int) -> dict[str, Any]:
    """Return the content of a folder's ``sweep.json``."""
    shared = spec.shared
    return {
        "plan": str(shared.plan),
        "plan_sha256": hashlib.sha256(shared.plan.read_bytes()).hexdigest(),
        "arguments": list(shared.arguments),
        "seed": spec.seed,
        "runs": runs,
        "set": spec.listed,
        "sample": spec.sampled,
        "motion": shared.motion,
        **({"check": list(shared.checks)} if shared.checks else {}),
    }
