"""Record everything that happens in a block."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import time
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from recorder import notebook, provenance
from recorder.errors import RecordingError
from recorder.mcap_sink import McapSink, free_path
from recorder.packages import hint
from recorder.records import Run, Task, escaped
from recorder.records.values import AssetFile
from recorder.tracing import journal, span
from recorder.tracing.call_stack import failure_with_frames
from recorder.tracing.context import current_name
from recorder.tracing.forking import process
from recorder.tracing.interrupts import Uninterrupted, drop_pending, interrupted_at, interrupted_by, terminable
from recorder.tracing.journal import Journal, Sink
from recorder.tracing.output import recorded_output
from recorder.viewer.live import RerunSink

_MAX_ERRORS: Final = 1000  # maximum number of errors in the traceback of an error that ends a plan or thread


@dataclass(frozen=True, slots=True, repr=False)
class Recording:
    """A recording in progress."""

    path: Path
    journal: Journal
    viewer: RerunSink | None = None

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {self.length} record{'' if self.length == 1 else 's'}>"

    @property
    def length(self) -> int:
        """Number of records so far; the next record has this step."""
        return self.journal.length


@contextmanager
def record(
    path: str | Path,
    live: str | None = None,
    *,
    name: str | None = None,
    arguments: Sequence[str] | None = None,
    source: str | Path | None = None,
    seed: int | None = None,
    order: str = "",
    environment: str = "",
    output: bool = False,
    locals: bool = True,  # noqa: A002  Python's names
    overwrite: bool = False,
    durable: bool = False,
    parameters: Mapping[str, Any] | None = None,
) -> Iterator[Recording]:
    """Record all worlds and plans of this process while the block runs.

    The first records are keyframes of existing worlds and the tasks that already run. The last records are the tasks
    that still run when the recording ends.

    Args:
        path: The MCAP file to write. If RUN.mcap exists, RUN.2.mcap is written instead, and its name is printed on
            stderr. :attr:`Recording.path` is the name of the written file.
        live: How to show the recording live in Rerun. "spawn" opens a viewer, or uses an open viewer. "connect" and
            "connect:rerun+http://HOST:PORT/proxy" use a viewer that another program starts, now or later. "serve"
            prints the address of a page for browsers on this machine, until this process ends. A slow or missing viewer
            doesn't delay the plan.
        name: Name of the plan, by default the name of the program or notebook.
        arguments: Arguments of the plan, by default the arguments of the program.
        source: The plan's file, by default the program's file. The recording contains this file.
        seed: The plan's seed. ``record`` only writes this seed and the following inputs into the file.
        output: Record printed and logged lines, too.
        locals: Record the local variables of the plan's functions with failures.
        overwrite: Replace an existing recording.
        durable: Write each chunk of the file to the disk, so that a power loss loses few records.

    Raises:
        RecordingError: An argument is invalid, the source is missing, or the file can't be written, at the start or
            later. This error is also raised if another program changes the file.
        Terminated: SIGTERM or SIGHUP has interrupted the plan, and the program doesn't handle the signal.
    """
    own = [] if notebook.is_running() else sys.argv[1:]  # a notebook's arguments are the kernel's
    given = own if arguments is None else arguments
    _check(path, name=name, live=live, source=source, arguments=given)
    program = provenance.main_program() if source is None else Path(source)
    title = escaped(name or (program.stem if program else notebook.title() or "plan"))
    began = Run(phase=Run.STARTED, name=title, thread=current_name())
    provenance.describe(began, given, program, seed, order, parameters or {})
    began.environment = environment
    main = provenance.main_program()
    began.by_program = bool(program and main and main.exists() and main.samefile(program))
    if began.by_program:
        began.called_as = escaped(sys.argv[0])
    began.looks = journal.looks()
    began.number = _numbers[title] = _numbers[title] + 1
    start = time.perf_counter_ns()
    sink = _redirect(began) if _redirect is not None else None
    file = Path(path) if overwrite or sink is not None else free_path(Path(path))
    with terminable():
        recording = _begin(file, live, began, program, sink, local_variables=locals, durable=durable)
        log, owner = recording.journal, process()

        def end(_: object, error: BaseException | None, __: object) -> None:
            if process() != owner:  # in a forked child, the file belongs to the parent process
                return
            try:
                _finish(log, title, start, error)
            except OSError as failed:
                if error is None:
                    raise
                failed.__context__, error.__context__ = error.__context__, failed
                # the plan's own error is raised, so the error of the recording is printed
                if not isinstance(error, RecordingError):
                    print(f"recorder: {failed}", file=sys.stderr)

        with ExitStack() as ending:
            ending.push(end)
            ending.enter_context(_recording_uncaught(log, title))
            if output:
                ending.enter_context(recorded_output(log))
            yield recording


_started: list[tuple[AbstractContextManager[Recording], Recording]] = []  # a process has at most one recording


def start(path: str | Path, live: str | None = None, **options: Any) -> Recording:
    """Record until :func:`stop` or the end of the process, for notebooks.

    A recording that was started earlier stops first. :func:`record` describes arguments and errors.
    """
    stop()
    block = record(path, live, **options)
    recording = block.__enter__()
    _started.append((block, recording))
    atexit.register(stop)
    return recording


def stop() -> Recording | None:
    """Stop and return the recording that :func:`start` has started; return None without such a recording."""
    if not _started:
        return None
    block, recording = _started.pop()
    atexit.unregister(stop)
    block.__exit__(None, None, None)
    return recording


def _check(path: object, *, source: object, arguments: object, **texts: object) -> None:
    if not isinstance(path, str | Path) or "\0" in str(path) or not str(path):
        raise RecordingError(repr(path), "isn't the path of a file")
    for argument, value in texts.items():
        if not isinstance(value, str | None):
            raise RecordingError(path, f"{argument} is {value!r}, not a string")
    if isinstance(arguments, str) or not isinstance(arguments, Iterable):
        raise RecordingError(path, f"arguments are {arguments!r}, not a list of strings")
    if source is not None and not (isinstance(source, str | Path) and Path(source).is_file()):
        raise RecordingError(path, f"there is no source {source!r} to attach")


_numbers: Final[Counter[str]] = Counter()  # number of recordings that this process has begun with each name
_redirect: Callable[[Run], Sink | None] | None = None  # the function of :func:`redirected` that returns sinks


@contextmanager
def redirected(sink_of: Callable[[Run], Sink | None]) -> Iterator[None]:
    """Write the recordings that begin inside the block to other sinks instead of files and viewers.

    The block runs a program from its start, so its recordings are numbered from 1 again. Recordings of forked processes
    aren't redirected. ``sink_of`` gets the record of the run's start, which it may complete, and returns a sink, or
    None for an ordinary recording.
    """
    global _redirect  # noqa: PLW0603  the process has only one redirection
    owner = process()
    before, _redirect = _redirect, lambda run: sink_of(run) if process() == owner else None
    numbers = Counter(_numbers)
    _numbers.clear()
    try:
        yield
    finally:
        _redirect = before
        _numbers.clear()
        _numbers.update(numbers)


def _begin(
    file: Path,
    live: str | None,
    began: Run,
    program: Path | None,
    other: Sink | None,
    *,
    local_variables: bool,
    durable: bool,
) -> Recording:
    """Open the file and the viewer, and record the existing worlds. After an error, both are closed."""
    with ExitStack() as undoing:
        viewer = sink = None
        if other is None:
            if live is not None and find_spec("rerun") is None:
                raise RecordingError(live, f"the viewer isn't installed; {hint('viewer')}")
            if live is not None:
                viewer = RerunSink(live, began.name)
                undoing.callback(viewer.close)
            final_metadata = dict if viewer is None else viewer.final_metadata
            sink = McapSink(file, provenance.metadata(began), final_metadata, durable=durable)
            undoing.callback(sink.close)
        log = Journal([each for each in (other, sink, viewer) if each is not None], local_variables=local_variables)
        _leave_to_parent(other if isinstance(other, McapSink) else sink, log)
        log.append(began)
        if program is not None and program.is_file():
            log.attach([AssetFile(program.name, program.read_bytes(), "text/x-python")])
        journal.open_journal(log, span.running())
        undoing.pop_all()
    return Recording(file, log, viewer)


@contextmanager
def _recording_uncaught(log: Journal, title: str) -> Iterator[None]:
    """Record the errors that end threads while the block runs. The hook that was set before is still called."""
    before = threading.excepthook
    ended = False

    def hook(args: threading.ExceptHookArgs) -> None:
        try:
            if not ended and args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
                name = escaped((args.thread or threading.current_thread()).name)
                failed = failure_with_frames(args.exc_value, errors=_MAX_ERRORS)
                with suppress(OSError):  # the next record raises this error
                    log.append(Run(phase=Run.THREAD_FAILED, name=title, thread=name, failure=failed))
        finally:
            before(args)

    threading.excepthook = hook
    try:
        yield
    finally:
        ended = True
        if threading.excepthook is hook:  # otherwise a hook that was set later still calls this hook
            threading.excepthook = before


def _finish(log: Journal, title: str, start: int, error: BaseException | None) -> None:
    with Uninterrupted(), ExitStack() as ending:  # a second Ctrl-C must not lose the end of the recording
        if isinstance(error, KeyboardInterrupt):
            ending.callback(drop_pending)
        ending.callback(journal.close_journal, log)
        succeeded = error is None or (isinstance(error, SystemExit) and not error.code)
        end = Run(
            phase=Run.FINISHED,
            name=title,
            thread=current_name(),
            succeeded=succeeded,
            duration_ns=time.perf_counter_ns() - start,
        )
        if error is not None and not succeeded:
            end.failure.CopyFrom(failure_with_frames(error, errors=_MAX_ERRORS))
            if isinstance(error, KeyboardInterrupt):
                end.interrupted_by, end.checkpoint = interrupted_by(), interrupted_at()
        with span.running() as tasks:
            for began in reversed(tasks):
                left = Task(phase=Task.LEFT, status=began.status, duration_ns=time.time_ns() - began.began_ns)
                for field in ("task", "parent", "world", "sim_step", "thread", "kind", "name", "attempt"):
                    setattr(left, field, getattr(began, field))
                log.append(left)
            log.append(end)
            journal.forget_journal(log)


def _leave_to_parent(sink: McapSink | None, log: Journal) -> None:
    """Stop recording in forked children, because the file belongs to this process."""
    sink_reference = (lambda: None) if sink is None else weakref.ref(sink)
    log_reference = weakref.ref(log)
    owner = process()

    def forget() -> None:
        if process() == owner:
            return
        sink, log = sink_reference(), log_reference()
        if sink is not None:
            sink.abandon()
        if log is not None:
            journal.forget_journal(log)

    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=forget)
