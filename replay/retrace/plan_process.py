"""Runs a recorded plan again in a process of its own, under the recorded conditions and guided by the recording.

With ``recorded_source``, the source in the recording runs instead of the files on the disk. The recording contains the
plan, and the modules whose lines are in call stacks. This source is written to a folder that also has links to the
other files of the plan's folder.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

from recorder.packages import other_versions
from recorder.records import Change, Mutation, Output, Plain, Run, Task
from recorder.records.values import LEFT_OUT
from replay.compare import is_worded_alike
from replay.errors import ReplayError
from replay.history.source import name_of, sites

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

_SHOWN: Final = 2000  # maximum number of characters from the end of a process's stderr that are shown
_STDERR: Final = 2
_CACHE: Final = "__pycache__"  # folder of compiled files, which don't belong to the recorded source


def last_output(errors: IO[bytes]) -> str:
    """Return the end of the text that a process wrote to a file."""
    errors.seek(0)
    return errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]


class CantRetrace(ReplayError):
    """The recording lacks data to run the plan again, or the plan can't be run here."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """How a recording guides a run. The moments of deadlines and of workers' results come from the recording itself."""

    log: str  # path of the recording
    by_program: bool  # whether the plan itself starts the recording
    until: int | None = None  # the last step that is compared; None to compare all steps
    take_answers: bool = False  # whether queries get their recorded answers, and aren't asked
    changes: tuple[Change, ...] = ()  # changes of a fork; each is made after its step
    moved: tuple[str, str] | None = None  # folder with the recorded source of the plan, and the plan's own folder

    def as_json(self) -> dict[str, object]:
        """Return the guidance as JSON data."""
        facts = {name: getattr(self, name) for name in self.__slots__}
        changes = [{each.name: value for each, value in change.ListFields()} for change in self.changes]
        return {**facts, "changes": changes}

    @classmethod
    def of_json(cls, facts: Mapping[str, Any]) -> Guidance:
        """Return the guidance from JSON data."""
        return cls(**{**facts, "changes": tuple(Change(**each) for each in facts["changes"])})


@dataclass(frozen=True, slots=True)
class FirstDifference:
    """The first record that differs from the recording."""

    step: int  # step of the recorded record; the number of steps if the plan continues after the recording's end
    text: str  # text of the difference
    line: str = ""  # FILE:LINE of the plan that made the new record; if the plan ended, of the recorded record
    callers: tuple[str, ...] = ()  # lines of the plan that led to this line, innermost first
    #: Recorded and new values that differ, by the path of the field; empty if the records have different kinds.
    fields: dict[str, tuple[Plain, Plain]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class GuidedResult:
    """The result of a plan that ran again."""

    equal: int  # number of equal records before the first difference
    difference: FirstDifference | None  # the first difference; None if all compared records are equal
    taken: int  # number of answers that came from the recording
    notes: tuple[str, ...] = ()  # differences from the recorded conditions that were found during the run
    unused: tuple[str, ...] = ()  # answers for decisions that the plan never had to make


class PlanProcess:
    """A recorded plan, ready to run again.

    Args:
        plan: A file that runs instead of the recorded plan.
        arguments: Arguments of the plan instead of the recorded arguments.
        until: The last step that is compared; by default, the last step of the recording.
        recorded_source: Run the source in the recording instead of the files on the disk.

    Raises:
        CantRetrace: The plan is missing, or the conditions of the run aren't recorded or can't be repeated.
    """

    def __init__(
        self,
        log: RecordReader,
        plan: str | Path | None = None,
        arguments: Sequence[str] | None = None,
        *,
        until: int | None = None,
        recorded_source: bool = False,
    ) -> None:
        began = log[0]
        if not hasattr(os, "fork"):  # systems without fork also can't pass open files to processes
            raise CantRetrace("plans can't be run again on this system: it has no os.fork")
        if not isinstance(began, Run) or not (began.directory or plan):
            raise CantRetrace(
                f"{log.path}: an older release made this recording, and didn't record how the plan was run"
            )
        if recorded_source and plan is not None:
            raise CantRetrace("give either a plan or --recorded-source, not both")
        self.log = log
        self.began = began  # the record of the run's start
        self._until = until
        self._edited = plan is not None
        self._source: _RecordedSource | None = None
        if plan is None and not began.program:
            raise CantRetrace(f"{log.path}: the recording names no plan, because it was made at a prompt; use --plan")
        self.program = Path(began.program if plan is None else plan)  # file of the plan
        if recorded_source:
            self._source = _RecordedSource(log, began, self.program)
        elif not self.program.is_file():
            raise CantRetrace(f"{self.program}: there is no such plan; name it with --plan, or use --recorded-source")
        else:
            self.program = self.program.absolute()
        self.arguments = list(began.arguments) if arguments is None else list(arguments)
        if any(LEFT_OUT in each.value_json for each in began.parameters):
            raise CantRetrace(f"{log.path}: secret parameters weren't recorded, so the plan can't run again")
        if any(LEFT_OUT in text for text in self.arguments):
            raise CantRetrace(f"{log.path}: secret arguments weren't recorded; give all arguments after --arguments")
        self._folder = Path(began.directory) if Path(began.directory).is_dir() else Path.cwd()
        _refuse_unrepeatable(log, until)
        own = last_own_step(log)
        self._interrupted_after = own if own < len(log) - 1 else None
        self._running: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def notes(self) -> Iterator[str]:
        """Yield the differences from the recorded conditions, as text."""
        began = self.began
        if self._source is not None:
            yield str(self._source)
        elif began.plan.sha256 and sha256(self.program.read_bytes()).hexdigest() != began.plan.sha256:
            yield f"{self.program.name} differs from the recorded source"
        if began.pycram.sha256 and not is_worded_alike(self.log):
            yield "PyCRAM's code differs from the code that made the recording"
        yield from other_versions(self.log.metadata, "python", "pybullet", "numpy", "machine", "platform")
        if not began.seed:
            yield "no seed is recorded: random numbers may differ"
        if not began.hash_seed.isdecimal():
            yield "no PYTHONHASHSEED is recorded: the order of sets may differ"
        if self._interrupted_after is not None:
            last = self._interrupted_after
            yield f"the run was interrupted after step {last}; only the steps up to this step can be the same"
        if str(self._folder) != began.directory:
            yield f"the working directory {began.directory} doesn't exist; {self._folder} is used"

    def run(
        self,
        *,
        file: Path | None = None,
        changes: Sequence[Change] = (),
        take_answers: bool = False,
        quiet: bool = False,
    ) -> GuidedResult:
        """Run the plan until the first difference; a fork runs until the end of the plan.

        With a ``file``, the plan continues into this new recording, and prints to stderr, unless ``quiet`` is true.
        ``changes`` are made in addition to the recorded changes (:meth:`guidance`).

        Raises:
            CantRetrace: The process ended without a result.
            ReplayError: A change can't be made.
        """
        until = self._until
        if until is None:  # the plan may hang after its last step
            until = self._interrupted_after if self.log.closed else len(self.log) - 1
        reading, writing = os.pipe()
        output = os.open(os.devnull, os.O_WRONLY) if quiet else os.dup(_STDERR)
        with (
            tempfile.TemporaryDirectory(prefix="pycram-retrace-", ignore_cleanup_errors=True) as folder,
            tempfile.TemporaryFile() as errors,
            os.fdopen(reading, "rb") as results,
        ):
            facts = {"result": writing, "output": output, "file": None if file is None else str(file.absolute())}
            guidance = self.guidance(until, changes, take_answers=take_answers)
            try:
                process = self.start("replay.retrace.guided_run", guidance, folder, errors, (writing, output), **facts)
            finally:
                os.close(writing)
                os.close(output)
            self._running = process
            with process, ExitStack() as undoing:
                undoing.callback(process.kill)
                if self._stopped:  # stop() was called before the start
                    process.kill()
                line = results.readline()  # child processes of the plan may keep the pipe open
                code = process.wait()
                undoing.pop_all()
            os.set_blocking(reading, False)
            line = results.readline() or line  # the last message is the result
            if not line:
                printed = last_output(errors)
                how = f"was killed by signal {-code}" if code < 0 else f"ended with {code}"
                raise CantRetrace(f"the plan's process {how}, without a result{printed and f':{chr(10)}{printed}'}")
        answer: Mapping[str, Any] = json.loads(line)
        if "error" in answer:
            raise ReplayError(answer["error"])
        found = answer["difference"]
        difference = None if found is None else FirstDifference(**found)
        notes, unused = tuple(answer["notes"]), tuple(answer.get("unused", ()))
        return GuidedResult(answer["equal"], difference, answer["taken"], notes, unused)

    def stop(self) -> None:
        """Stop the run from another thread. Then :meth:`run` raises `CantRetrace`."""
        self._stopped = True
        if self._running is not None:
            self._running.kill()

    @property
    def recorded_files(self) -> Mapping[Path, bytes]:
        """The recorded source, by path; empty if the files on the disk run."""
        files = {} if self._source is None else self._source.files
        return {self.program.parent / place: text for place, text in files.items()}

    def guidance(
        self, until: int | None = None, changes: Sequence[Change] = (), *, take_answers: bool = False
    ) -> Guidance:
        """Return the guidance of the run. If the recorded run is a fork, its changes are made again.

        With further ``changes`` or an edited plan, only recorded changes up to the last compared step are made again.
        """
        recorded = list(self.began.origin.changes)
        if (changes or self._edited) and self._until is not None:
            recorded = [change for change in recorded if change.step <= self._until]
        log = str(self.log.path.resolve())
        return Guidance(log, self.began.by_program, until, take_answers, (*recorded, *changes))

    def start(
        self,
        module: str,
        guidance: Guidance,
        folder: str,
        errors: IO[bytes],
        descriptors: Collection[int] = (),
        **facts: object,
    ) -> subprocess.Popen[bytes]:
        """Start the ``main`` function of a module in a process under the recorded conditions, without input and output.

        Args:
            module: A module whose main function receives the run and the facts as a JSON text.
            folder: A folder for the recordings of projections and for the recorded source.
            errors: A file for the stderr of the process.
            descriptors: Open files that the process inherits.
        """
        began = self.began
        program = self.program
        if self._source is not None:
            program = self._source.write(Path(folder).resolve())
            guidance = replace(guidance, moved=(str(program.parent), str(self.program.parent)))
        request = {
            "plan": str(program),
            "arguments": self.arguments,
            "guidance": guidance.as_json(),
            "parent": os.getpid(),
            "folder": folder,
            **facts,
        }
        environment = dict(os.environ)
        if began.hash_seed.isdecimal():
            environment["PYTHONHASHSEED"] = began.hash_seed
        else:
            environment.pop("PYTHONHASHSEED", None)
        return subprocess.Popen(  # noqa: S603  the command contains no user input
            [sys.executable, "-P", "-c", f"from {module} import main; main()", json.dumps(request)],
            cwd=self._folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            pass_fds=descriptors,
        )


def last_own_step(log: RecordReader) -> int:
    """Return the last step that a plan reaches by itself: before a Ctrl-C and its effects."""
    end = log[-1]
    if not isinstance(end, Run) or not end.interrupted_by:
        return end.seq
    for record in log.backwards():
        failed = isinstance(record, Task) and record.phase == Task.FINISHED and record.status != Task.SUCCEEDED
        if not (failed or isinstance(record, Run | Output)):
            return record.seq
    return 0


def _refuse_unrepeatable(log: RecordReader, until: int | None) -> None:
    """Reject worlds with a window or in real time, because runs with them can't be repeated."""
    for record in log.records(Mutation, 0, len(log) if until is None else until + 1):
        window = record.HasField("open_world") and record.open_world.mode == "GUI"
        if window or (record.HasField("set_realtime") and record.set_realtime.enabled):
            what = f"{record.world} has a window" if window else f"{record.world} runs in real time"
            why = "effects of a person or of the clock can't be repeated"
            raise CantRetrace(f"{log.path}: from step {record.seq} on {what}; {why}. Fork before that step")


class _RecordedSource:
    """The recorded source of the plan ``program``; raise CantRetrace if the plan's source isn't attached."""

    def __init__(self, log: RecordReader, began: Run, program: Path) -> None:
        self.program = program
        keys = [key for key in log.assets if key.endswith(".py")]
        main = [key for key in keys if name_of(key) == program.name and key.startswith(began.plan.sha256)]
        if len(main) != 1:
            raise CantRetrace(f"{log.path}: the recording lacks the source of {program.name}")
        places = {Path(file) for record in log for file, _ in sites(record)} - {program}
        self.files = {Path(program.name): log.assets[main[0]]}  # attached files, by their path in the plan's folder
        self.left_out: list[str] = []  # attached files whose paths are unknown or outside of the plan's folder
        for key in keys:
            if key == main[0]:
                continue
            fitting = [place for place in places if place.name == name_of(key)]
            shared = sum(name_of(other) == name_of(key) for other in keys) > 1
            if len(fitting) == 1 and not shared and fitting[0].is_relative_to(program.parent):
                self.files[fitting[0].relative_to(program.parent)] = log.assets[key]
            else:
                self.left_out.append(name_of(key))

    def write(self, folder: Path) -> Path:
        """Write the source into a folder, with links to the plan's other files. Return the plan's file there."""
        name = self.program.parent.name
        target = folder / (name if name not in ("", "..") else "plan")  # the plan's path may begin with ../
        lay(self.files, self.program.parent, target)
        return target / self.program.name

    def __str__(self) -> str:
        names = ", ".join(sorted(map(str, self.files)))
        others = f"{', '.join(sorted(set(self.left_out)))} and " if self.left_out else ""
        return f"run from the recorded source: {names}; run from the disk: {others}all other files"


def lay(texts: Mapping[Path, bytes], original: Path, target: Path) -> None:
    """Write files into a folder, and add links to all other files of the original folder."""
    target.mkdir(parents=True)
    within: dict[str, dict[Path, bytes]] = {}
    for place, text in texts.items():
        if len(place.parts) == 1:
            (target / place).write_bytes(text)
        else:
            within.setdefault(place.parts[0], {})[Path(*place.parts[1:])] = text
    for name, parts in within.items():
        lay(parts, original / name, target / name)
    for other in original.iterdir() if original.is_dir() else ():
        if other.name != _CACHE and not (target / other.name).exists():
            (target / other.name).symlink_to(other)
