"""The folder of a sweep, with a recording of each run, and the state of the sweep.

``sweep.json`` describes the sweep, so that a restarted sweep makes only the missing runs. ``sweep.lock`` is locked
while a sweep runs. Files whose names begin with a dot are being written.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import UsageError
from pycram.foundation.names import export

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pycram.sweeping.one_run import RunOutcome, Spec


FORMAT: Final = 1  # of sweep.json
SWEEP: Final = "sweep.json"
_LOCK: Final = "sweep.lock"
_PART: Final = re.compile(r"\.(\d{5,}.*\.mcap|models-.*\.mcap|sweep\.json)\.part")
_MAY_CHANGE: Final = frozenset({"runs", "plan"})  # when it is started again
_KEPT: Final = 100  # outcomes of failures, and remarks: memory doesn't grow with the runs
_held: Final[set[Path]] = set()  # folders into which this process sweeps


class SweepRefused(UsageError):
    """A sweep can't be made, or not into this folder.

    Attributes:
        cause: Why not, and what to do.
    """

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause


export("pycram.sweeping", SweepRefused)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make a folder, and lock it against other sweeps while the block runs.

    Raises:
        SweepRefused: Another sweep uses it, or it can't be made.
    """
    held = folder.resolve()
    who = f"process {os.getpid()} on {platform.node()} (since {time.strftime('%Y-%m-%d %H:%M:%S')})"
    if held in _held:  # to open the file again and close it would release the lock
        raise _in_use(folder, who.partition(" (")[0])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise SweepRefused(f"{folder}: {error.strerror or error}") from error
    with os.fdopen(lock, "r+", encoding="utf-8", errors="replace") as file:
        try:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # of this process only: forks may outlive it for a moment
        except (BlockingIOError, PermissionError):
            raise _in_use(folder, file.read(200).strip() or "another process") from None
        except OSError:  # a file system without locks
            pass
        file.truncate(0)
        file.write(f"{who}\n")
        file.flush()
        _held.add(held)
        for part in folder.iterdir():
            if _PART.fullmatch(part.name):  # of a sweep that was killed
                part.unlink(missing_ok=True)
        try:
            yield
        finally:
            _held.discard(held)
            with suppress(OSError):
                file.truncate(0)


def _in_use(folder: Path, who: str) -> SweepRefused:
    return SweepRefused(f"{folder}: {who} is sweeping into it; wait for it, or name another folder")


def begin(folder: Path, facts: Mapping[str, Any]) -> Mapping[str, Any]:
    """Write the description of a sweep, and return the folder's earlier one; empty in a new folder.

    Raises:
        SweepRefused: The folder has another sweep.
    """
    file = folder / SWEEP
    before: dict[str, Any] = {}
    if file.exists():
        try:
            before = json.loads(file.read_text(encoding="utf-8"))
            known = {key: before[key] for key in facts}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SweepRefused(f"{file}: it is damaged, or another release's ({error}); name another folder") from error
        given = json.loads(json.dumps(dict(facts)))
        differing = [key for key in given if key not in _MAY_CHANGE and given[key] != known[key]]
        if differing:
            key = differing[0]
            what = f"its {key} was {known[key]!r}, not {given[key]!r}"
            what = "the plan was another" if key == "plan_sha256" else what
            raise SweepRefused(f"{folder}: a sweep is there already, and {what}; name another folder")
    write(folder, {**facts, "models": before.get("models")})
    return before


def write(folder: Path, facts: Mapping[str, Any]) -> None:
    """Write the description of a sweep, atomically."""
    part = folder / f".{SWEEP}.part"
    part.write_text(json.dumps({"format": FORMAT, **facts}, indent=1) + "\n", encoding="utf-8")
    part.replace(folder / SWEEP)


@dataclass(slots=True)
class Sweep:
    """The progress and result of a sweep."""

    folder: str  # of the recordings
    runs: int  # that were asked for
    before: int = 0  # runs that existed before
    done: int = 0  # runs that were made now
    failed: int = 0  # of those
    failures: list[RunOutcome] = field(default_factory=list)  # the first ones
    stopped: str = ""  # why it ended before all runs were made; "" if it didn't
    interrupted: bool = False  # by Ctrl-C
    remarks: list[str] = field(default_factory=list)  # errors of hooks

    def take(self, outcome: RunOutcome) -> bool:
        """Count a run; return whether it was recorded, because else no other run would be."""
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
        """Return whether the first run failed before the plan did anything, as all other runs would.

        If so, its outcome gets the name under which its recording is to be set aside.
        """
        if self.before or self.done > 1 or not self.failures:
            return False
        first = self.failures[0]
        if first.started and not first.lost:
            return False
        self.stopped = f"the first run failed before the plan did anything: {first.failure}"
        self.failures = [replace(first, name=f"{first.name}.failed")]
        return True


def facts_of(spec: Spec, runs: int) -> dict[str, Any]:
    """Return the content of a folder's ``sweep.json``."""
    digest = hashlib.sha256(Path(spec.plan).read_bytes()).hexdigest()
    return {
        "plan": spec.plan,
        "plan_sha256": digest,
        "arguments": list(spec.arguments),
        "seed": spec.seed,
        "runs": runs,
        "set": spec.listed,
        "sample": spec.sampled,
        "motion": spec.motion,
    }
