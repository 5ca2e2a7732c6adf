"""The folder of a sweep: a recording a run, named by its number and parameters, and what was swept.

``sweep.json`` says what was swept, so that a sweep which is started again does what is missing and nothing else.
``sweep.lock`` is locked while one runs. Names that begin with a dot are being written.
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
import re
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import UsageError
from pycram.foundation.names import export
from recorder.records.values import LEFT_OUT, is_secret

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

FORMAT: Final = 1  # of sweep.json
SWEEP: Final = "sweep.json"
_LOCK: Final = "sweep.lock"
_UNSAFE: Final = re.compile(r"[^\w.+-]+", re.ASCII)  # in names of files, on any system
_MAX_LETTERS: Final = 120  # characters of a name
_PART: Final = re.compile(r"\.(\d{5,}.*\.mcap|models-.*\.mcap|sweep\.json)\.part")
_MAY_CHANGE: Final = frozenset({"runs", "plan"})  # when it is started again
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


def name_of(number: int, values: Mapping[str, Any]) -> str:
    """Return the name of a run's recording: for people, as the recording itself has the values."""
    shown = ((name, LEFT_OUT if is_secret(name) else value) for name, value in values.items())
    words = ",".join(f"{name}={_shown(value)}" for name, value in shown)
    return f"{number:05}{'.' if words else ''}{words[:_MAX_LETTERS]}.mcap"


def _shown(value: object) -> str:
    return _UNSAFE.sub("_", f"{value:.4g}" if isinstance(value, float) else str(value))


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make a folder, and keep it from other sweeps while the block runs.

    Raises:
        SweepRefused: One runs into it, or it can't be made.
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
    """Write down what is swept, and return what the folder had from before, which is empty in a new one.

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
    """Write down what is swept, whole or not at all."""
    part = folder / f".{SWEEP}.part"
    part.write_text(json.dumps({"format": FORMAT, **facts}, indent=1) + "\n", encoding="utf-8")
    part.replace(folder / SWEEP)
