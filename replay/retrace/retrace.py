"""Retraces a recording: runs the plan's code again, and compares what happens with the recording, record by record.

The same plan, seed, arguments and working directory give the same records in the same order. So the first difference is
due to what has changed since: the plan, PyCRAM, the engine, or what the plan reads of the world outside.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recorder.packages import versions
from recorder.provenance import pycram_revision
from recorder.records import Run
from recorder.secrets import LEFT_OUT
from replay.errors import ReplayError
from replay.retrace.guide import Difference

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from replay.file.record_reader import RecordReader

_SHOWN: Final = 2000  # characters of stderr that a process which gave no result has last written


class CantRetrace(ReplayError):
    """What a recording tells of its run isn't enough to run it again, or the plan can't be run here.

    Attributes:
        cause: why, and what to do.
    """

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause


@dataclass(frozen=True, slots=True)
class Retracing:
    """The result of retracing a recording.

    Attributes:
        plan: the file that was run.
        steps: of the recording.
        equal: number of records, from the first on, that came out the same.
        difference: the first one that didn't; None if all did, or those up to where the recording was cut or damaged.
        notes: what else is different from when it was recorded, and may be why.
        seconds: how long it took.
    """

    plan: Path
    steps: int
    equal: int
    difference: Difference | None
    notes: tuple[str, ...]
    seconds: float

    @property
    def identical(self) -> bool:
        """Whether no record came out differently."""
        return self.difference is None


def retrace(log: RecordReader, *, plan: str | Path | None = None, arguments: Sequence[str] | None = None) -> Retracing:
    """Run a recorded plan again in a process of its own, and compare record by record up to the first difference.

    The plan acts as it did then: what it does outside of its worlds (files, network) happens again. It has no input,
    and what it prints is not shown.

    Args:
        log: the recording.
        plan: another file than the recorded one.
        arguments: other arguments than the recorded ones.

    Raises:
        CantRetrace: the plan isn't there, or the recording doesn't tell how it was run; nothing has run.
    """
    began = log[0]
    if not isinstance(began, Run) or not (began.directory or plan):
        raise CantRetrace(f"{log.path}: an older release made it, which didn't record how the plan was run")
    program = _program(log, began, plan)
    given = list(began.arguments) if arguments is None else list(arguments)
    if any(LEFT_OUT in text for text in given):
        raise CantRetrace(f"{log.path}: secret arguments were left out of it; give all with --arguments, last")
    folder = Path(began.directory) if Path(began.directory).is_dir() else Path.cwd()
    notes = tuple(_notes(log, began, program, folder))
    start = time.perf_counter()
    request = {
        "log": str(log.path.resolve()),
        "plan": str(program),
        "arguments": given,
        "seed": int(began.seed) if began.seed.isdecimal() else None,
        "by_program": began.by_program,
    }
    answer = _run(request, folder, began.hash_seed)
    found = answer["difference"]
    difference = None if found is None else Difference(**found)  # its pairs are lists now
    return Retracing(program, len(log), answer["equal"], difference, notes, time.perf_counter() - start)


def _program(log: RecordReader, began: Run, plan: str | Path | None) -> Path:
    if plan is None and not began.program:
        raise CantRetrace(f"{log.path}: no file of a plan is recorded, as from a prompt; give one with --plan")
    program = Path(began.program if plan is None else plan)
    if not program.is_file():
        back = f"pycram-replay source {log.path} -o DIR"
        raise CantRetrace(f"{program}: the plan isn't there; give its file with --plan, or have it back: {back}")
    return program.absolute()


def _notes(log: RecordReader, began: Run, program: Path, folder: Path) -> Iterator[str]:
    """Yield in words what is different from when the recording was made."""
    if began.plan.sha256 and sha256(program.read_bytes()).hexdigest() != began.plan.sha256:
        yield f"{program.name} differs from the recorded source"
    if began.pycram.sha256 and began.pycram.sha256 != pycram_revision().sha256:
        yield "PyCRAM's code differs from the one that made the recording"
    now = versions()
    for name in ("python", "pybullet", "numpy", "machine", "platform"):
        if name in log.metadata and name in now and log.metadata[name] != now[name]:
            yield f"{name} is {now[name]} instead of {log.metadata[name]}"
    if not began.seed:
        yield "no seed is recorded: random numbers may differ"
    if not began.hash_seed.isdecimal():
        yield "no PYTHONHASHSEED is recorded: the order of sets may differ"
    if str(folder) != began.directory:
        yield f"the working directory {began.directory} isn't there: {folder} is taken"


def _run(request: Mapping[str, object], folder: Path, hash_seed: str) -> dict[str, Any]:
    """Run the process to its end, and return its result."""
    environment = dict(os.environ)
    if hash_seed.isdecimal():
        environment["PYTHONHASHSEED"] = hash_seed
    else:
        environment.pop("PYTHONHASHSEED", None)
    reading, writing = os.pipe()
    with tempfile.TemporaryFile() as errors, os.fdopen(reading, "rb") as results:
        try:
            process = subprocess.Popen(  # noqa: S603  no text of users is a command
                [sys.executable, "-P", "-m", "replay.retrace.process", json.dumps({**request, "result": writing})],
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                pass_fds=[writing],
            )
        finally:
            os.close(writing)
        with process:
            try:
                line = results.readline()  # the plan's own processes may keep the pipe open
            except BaseException:
                process.kill()
                raise
            code = process.wait()
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer
        errors.seek(0)
        printed = errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]
    how = f"was killed by signal {-code}" if code < 0 else f"ended with {code}"
    raise CantRetrace(f"the plan's process {how}, without a result" + (f":\n{printed}" if printed else ""))
