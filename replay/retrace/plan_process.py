"""Runs a recorded plan again in a process of its own, with what the recording says it was given."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

from recorder.packages import versions
from recorder.provenance import pycram_revision
from recorder.records import Run
from recorder.secrets import LEFT_OUT
from replay.errors import ReplayError
from replay.retrace.guide import Difference

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from replay.file.record_reader import RecordReader

_SHOWN: Final = 2000  # characters of stderr that a process which gave no result has last written
_STDERR: Final = 2


class CantRetrace(ReplayError):
    """What a recording tells of its run isn't enough to run it again, or the plan can't be run here.

    Attributes:
        cause: why, and what to do.
    """

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause


@dataclass(frozen=True, slots=True)
class Outcome:
    """What has become of a plan that ran again.

    Attributes:
        equal: number of records, from the first on, that came out the same.
        difference: the first one that didn't; None if all did that were compared.
        code: exit code of the process.
    """

    equal: int
    difference: Difference | None
    code: int


class PlanProcess:
    """A recorded plan, ready to run again.

    Args:
        log: the recording.
        plan: another file than the recorded one.
        arguments: other arguments than the recorded ones.

    Attributes:
        program: the file that will run.

    Raises:
        CantRetrace: the plan isn't there, or the recording doesn't tell how it was run.
    """

    def __init__(self, log: RecordReader, plan: str | Path | None, arguments: Sequence[str] | None) -> None:
        began = log[0]
        if not isinstance(began, Run) or not (began.directory or plan):
            raise CantRetrace(f"{log.path}: an older release made it, which didn't record how the plan was run")
        self._log = log
        self._began = began
        self.program = _program(log, began, plan)
        self._arguments = list(began.arguments) if arguments is None else list(arguments)
        if any(LEFT_OUT in text for text in self._arguments):
            raise CantRetrace(f"{log.path}: secret arguments were left out of it; give all with --arguments, last")
        self._folder = Path(began.directory) if Path(began.directory).is_dir() else Path.cwd()

    def notes(self) -> Iterator[str]:
        """Yield in words what is different from when the recording was made."""
        began = self._began
        if began.plan.sha256 and sha256(self.program.read_bytes()).hexdigest() != began.plan.sha256:
            yield f"{self.program.name} differs from the recorded source"
        if began.pycram.sha256 and began.pycram.sha256 != pycram_revision().sha256:
            yield "PyCRAM's code differs from the one that made the recording"
        now, then = versions(), self._log.metadata
        for name in ("python", "pybullet", "numpy", "machine", "platform"):
            if name in then and name in now and then[name] != now[name]:
                yield f"{name} is {now[name]} instead of {then[name]}"
        if not began.seed:
            yield "no seed is recorded: random numbers may differ"
        if not began.hash_seed.isdecimal():
            yield "no PYTHONHASHSEED is recorded: the order of sets may differ"
        if str(self._folder) != began.directory:
            yield f"the working directory {began.directory} isn't there: {self._folder} is taken"

    def run(self, *, until: int | None = None, file: Path | None = None) -> Outcome:
        """Run it to the first difference; or as a fork, to its end.

        Args:
            until: the last step that is compared; by default all are.
            file: where it goes on from there, into this recording; what it prints then goes to stderr.

        Raises:
            CantRetrace: the process has ended before it came to a result.
        """
        reading, writing = os.pipe()
        output = os.dup(_STDERR)
        request = {"until": until, "file": None if file is None else str(file.absolute())}
        with (
            tempfile.TemporaryDirectory(prefix="pycram-retrace-", ignore_cleanup_errors=True) as folder,
            tempfile.TemporaryFile() as errors,
            os.fdopen(reading, "rb") as results,
        ):
            request |= {"result": writing, "output": output, "folder": folder}
            try:
                process = self.start("replay.retrace", request, errors, (writing, output))
            finally:
                os.close(writing)
                os.close(output)
            with process:
                try:
                    line = results.readline()  # the plan's own processes may keep the pipe open
                    code = process.wait()
                except BaseException:
                    process.kill()
                    raise
            if not line:
                errors.seek(0)
                printed = errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]
                how = f"was killed by signal {-code}" if code < 0 else f"ended with {code}"
                raise CantRetrace(f"the plan's process {how}, without a result{printed and f':{chr(10)}{printed}'}")
        answer: Mapping[str, Any] = json.loads(line)
        found = answer["difference"]
        return Outcome(answer["equal"], None if found is None else Difference(**found), code)

    def start(
        self, module: str, request: Mapping[str, object], errors: IO[bytes], descriptors: Collection[int] = ()
    ) -> subprocess.Popen[bytes]:
        """Start a module as a process in which the plan can do the same again; it has no input, and shows nothing.

        Args:
            module: its name.
            request: arguments of its main function, beside the log, the plan, its arguments and seed.
            errors: for what is written to stderr.
            descriptors: open files that it gets.
        """
        began = self._began
        given = {
            "log": str(self._log.path.resolve()),
            "plan": str(self.program),
            "arguments": self._arguments,
            "seed": int(began.seed) if began.seed.isdecimal() else None,
            "by_program": began.by_program,
        }
        environment = dict(os.environ)
        if began.hash_seed.isdecimal():
            environment["PYTHONHASHSEED"] = began.hash_seed
        else:
            environment.pop("PYTHONHASHSEED", None)
        return subprocess.Popen(  # noqa: S603  no text of users is a command
            [sys.executable, "-P", "-m", module, json.dumps({**given, **request})],
            cwd=self._folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            pass_fds=descriptors,
        )


def _program(log: RecordReader, began: Run, plan: str | Path | None) -> Path:
    if plan is None and not began.program:
        raise CantRetrace(f"{log.path}: no file of a plan is recorded, as from a prompt; give one with --plan")
    program = Path(began.program if plan is None else plan)
    if not program.is_file():
        back = f"pycram-replay source {log.path} -o DIR"
        raise CantRetrace(f"{program}: the plan isn't there; give its file with --plan, or have it back: {back}")
    return program.absolute()
