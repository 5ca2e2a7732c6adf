"""Running a plan as a main program, recorded; a process does it once, or is forked for each time."""

from __future__ import annotations

import contextlib
import os
import runpy
import shlex
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import recorder
from pycram.seeding import seed_random_numbers
from recorder.closed_output import until_closed
from recorder.errors import RecordingError
from recorder.packages import NotInstalled, needed
from recorder.tracing.interrupts import Terminated

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder import Recording

_PAGE = "serve"  # of --rerun
_MAX_PRINTED = 1000  # frames of an error, and errors in a chain, that are printed
SUCCEEDED, FAILED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130  # exit codes


@dataclass(frozen=True, slots=True)
class RunSpec:
    """A plan, and everything that its run depends on."""

    plan: Path
    arguments: tuple[str, ...] = ()
    seed: int | None = None  # of random numbers; None leaves them as they are
    order: str = ""  # of branches; "" for the one that the seed draws
    motion: str = ""  # the execution environment where the plan names none; "" for "simulated"
    parameters: Mapping[str, Any] = field(default_factory=dict)  # values; the plan's other parameters have defaults
    local_variables: bool = True  # whether failures hold the plan's local variables


def run(
    spec: RunSpec,
    log: Path,
    live: str | None = None,
    *,
    overwrite: bool = False,
    durable: bool = False,
    debug: bool = False,
) -> int:
    """Run a plan as a main program, record it, and return the exit code, as :func:`pycram.cli.main` does.

    Args:
        spec: The plan, and what its run depends on.
        log: The recording. Without ``overwrite``, the next free name is taken if it exists.
        live: The live viewer; see :func:`recorder.record`.
        overwrite: Whether an existing recording is replaced.
        durable: Whether records survive a power cut.
        debug: Whether the debugger opens at a failure.
    """
    before = sys.argv, list(sys.path)
    sys.argv = [str(spec.plan), *spec.arguments]
    sys.path.insert(0, str(spec.plan.parent.resolve()))
    folder, file = Path.cwd(), log.absolute()  # a plan may change the working directory
    recording: Recording | None = None
    code = SUCCEEDED
    error: BaseException | None = None
    parameters = dict(spec.parameters)
    seed_random_numbers(spec.seed)
    try:
        with needed():
            from pycram.motions.process_module import set_default  # noqa: PLC0415  --version needs no executor
            from pycram.plan_parameters import arguments_of_main, giving  # noqa: PLC0415  as above
            from pycram.scheduling.schedule import seed_order  # noqa: PLC0415  as above
        seed_order(spec.seed, spec.order)
        set_default(spec.motion)
        recorded = recorder.record(
            file,
            live,
            name=spec.plan.stem,
            arguments=spec.arguments,
            source=spec.plan,
            seed=spec.seed,
            order=spec.order,
            environment=spec.motion,
            output=True,
            locals=spec.local_variables,
            overwrite=overwrite,
            durable=durable,
            parameters=parameters,
        )
        with recorded as recording, giving(parameters):
            try:
                arguments_for_main = arguments_of_main(spec.plan, parameters)
                names = runpy.run_path(
                    str(spec.plan.absolute()), run_name=spec.plan.stem if arguments_for_main else "__main__"
                )
                if arguments_for_main:
                    names["main"](**arguments_for_main)
            finally:
                _wait_for_threads()
    except BaseException as raised:  # noqa: BLE001  whatever the plan's own code raises
        error = raised
        code = _report(raised)
    finally:
        sys.argv, sys.path[:] = before
    if recording is not None and recording.path.is_file() and not (_was_lost(error) or isinstance(error, NotInstalled)):
        shown = recording.path if log.is_absolute() else Path(os.path.relpath(recording.path, folder))
        _print_next_steps(shown, recording.path.stat().st_size / 1e6, code)
        if live == _PAGE and not isinstance(error, KeyboardInterrupt | Terminated):
            _keep_page(recording)
        if debug and code == FAILED:
            _debug(recording.path, spec.arguments)
    return code


def _report(error: BaseException) -> int:
    """Print how a plan ended, and return the exit code."""
    from pycram.foundation.failures import PlanFailure, PycramError  # noqa: PLC0415  heavy
    from recorder.records import format_error  # noqa: PLC0415  heavy
    from recorder.records.tracebacks import format_traceback  # noqa: PLC0415  heavy

    match error:
        case RecordingError() | NotInstalled():
            tell(f"pycram: {error}")
            return WRONG_USAGE
        case Terminated():
            tell(f"\npycram: interrupted by {error.signal}")
            return int(error.code or 0)
        case SystemExit():
            if isinstance(error.code, int | None):
                return error.code or SUCCEEDED
            tell(str(error.code))
            return FAILED
        case KeyboardInterrupt():
            tell("\npycram: interrupted")
            return INTERRUPTED
    tell(format_traceback(error, frames=_MAX_PRINTED, errors=_MAX_PRINTED).rstrip())
    kind = "uses PyCRAM wrongly" if isinstance(error, PycramError) else "has an error"
    how = "failed" if isinstance(error, PlanFailure) else kind
    tell(f"\npycram: the plan {how}: {format_error(error)}")
    return FAILED


def tell(text: str) -> None:
    """Print a message; a closed output doesn't change how the plan ended."""
    with until_closed():
        print(text, file=sys.stderr)


def _was_lost(error: BaseException | None) -> bool:
    """Return whether the recording failed, before the plan did or when it was closed afterwards."""
    return isinstance(error, RecordingError) or (error is not None and isinstance(error.__context__, RecordingError))


def _keep_page(recording: Recording) -> None:
    """Serve the viewer's page until Ctrl-C, if the plan was started from a terminal."""
    if recording.viewer is None or not sys.stdin.isatty():
        return
    tell("pycram: the page stays until Ctrl-C")
    with contextlib.suppress(KeyboardInterrupt):
        recording.viewer.wait()


def _debug(log: Path, arguments: Sequence[str]) -> None:
    """Open the debugger at the failure; in a process of its own, as its package is above this one."""
    given = ["--arguments", *arguments] if arguments else []  # the recording lacks secret ones
    subprocess.run([sys.executable, "-P", "-m", "replay", "debug", str(log), *given], check=False)  # noqa: S603  ours


def _wait_for_threads() -> None:
    """Wait for threads that the plan has left running, as Python does: they are part of the plan."""
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()


def _print_next_steps(log: Path, size: float, code: int) -> None:
    tell(f"pycram: recorded to {log} ({size:.1f} MB). Next:")
    for verb in ("info", "tree", "view") if code == SUCCEEDED else ("why", "tree", "view"):
        tell(f"  pycram-replay {verb} {shlex.quote(str(log))}")
