"""Run a plan as a main program: the settings of a run, its seed, and its recording.

The order of Python's sets depends on the value of ``PYTHONHASHSEED`` when Python starts. A command that runs a plan
therefore sets this variable to the seed, and restarts itself once.
"""

from __future__ import annotations

import contextlib
import os
import random
import runpy
import shlex
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from linecache import getline
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import recorder
from recorder.errors import RecordingError, until_closed
from recorder.packages import NotInstalled, needed
from recorder.tracing.interrupts import Terminated

if TYPE_CHECKING:
    from recorder import Recording

SUCCEEDED, FAILED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130  # exit codes
MAX_SEED: Final = 2**32 - 1  # largest seed that PYTHONHASHSEED and NumPy accept
_HASH: Final = "PYTHONHASHSEED"
#: :func:`restart` sets this variable to the id and the seed of the restarted process. Child processes have other ids.
_RESTARTED: Final = "PYCRAM_SEEDED"
_PAGE: Final = "serve"  # value of --rerun


@dataclass(frozen=True, slots=True)
class RunSpec:
    """A plan, and all settings that affect its run."""

    plan: Path
    arguments: tuple[str, ...] = ()
    seed: int | None = None  # None if the run doesn't seed random numbers
    order: str = ""  # text of the order of branches; "" for the seed's order
    motion: str = ""  # execution environment of plans that don't name one; "" for "simulated"
    parameters: Mapping[str, Any] = field(default_factory=dict)  # values of parameters; others have defaults
    checks: tuple[str, ...] = ()  # properties to watch
    only_record: bool = False  # whether violations of the properties are recorded without an error
    local_variables: bool = True  # whether recorded failures contain the plan's local variables

    def recorded(
        self, file: Path, live: str | None = None, **options: bool
    ) -> contextlib.AbstractContextManager[Recording]:
        """Return a context that records the run; :func:`recorder.record` describes ``live`` and ``options``."""
        return recorder.record(
            file,
            live,
            name=self.plan.stem,
            arguments=self.arguments,
            source=self.plan,
            seed=self.seed,
            order=self.order,
            environment=self.motion,
            locals=self.local_variables,
            parameters=dict(self.parameters),
            **options,
        )


def run(
    spec: RunSpec,
    log: Path,
    live: str | None = None,
    *,
    overwrite: bool = False,
    durable: bool = False,
    debug: bool = False,
) -> int:
    """Run a plan as a main program, record it, and return the exit code; see :func:`pycram.cli.main`.

    Without ``overwrite``, an existing recording stays, and the new recording gets the next free name. ``live`` and
    ``durable`` are described at :func:`recorder.record`. With ``debug``, the debugger opens at a failure.
    """
    before = sys.argv, list(sys.path)
    sys.argv = [str(spec.plan), *spec.arguments]
    sys.path.insert(0, str(spec.plan.parent.resolve()))
    folder, file = Path.cwd(), log.absolute()  # absolute, because a plan may change the working directory
    recording: Recording | None = None
    code = SUCCEEDED
    error: BaseException | None = None
    violations: list[str] = []
    seed_random_numbers(spec.seed)
    try:
        with needed():
            watching = _watching(spec)
            from pycram.motions.process_module import set_default  # noqa: PLC0415  slow; --help doesn't need it
            from pycram.plan_parameters import arguments_of_main, giving  # noqa: PLC0415  as above
            from pycram.scheduling.schedule import seed_order  # noqa: PLC0415  as above
        seed_order(spec.seed, spec.order)
        set_default(spec.motion)
        recorded = spec.recorded(file, live, output=True, overwrite=overwrite, durable=durable)
        with recorded as recording, giving(spec.parameters), watching as violations:
            try:
                arguments_for_main = arguments_of_main(spec.plan, spec.parameters)
                names = runpy.run_path(
                    str(spec.plan.absolute()), run_name=spec.plan.stem if arguments_for_main else "__main__"
                )
                if arguments_for_main:
                    names["main"](**arguments_for_main)
            finally:
                for thread in threading.enumerate():  # a run ends after the plan's threads, as any Python program
                    if thread is not threading.current_thread() and not thread.daemon:
                        thread.join()
    except BaseException as raised:  # noqa: BLE001  a plan may raise any error
        error = raised
        code = _report(raised)
    finally:
        sys.argv, sys.path[:] = before
    for violation in violations if code == SUCCEEDED else ():  # the plan handled it, or violations are only recorded
        tell(f"pycram: {violation}")
    unrecorded = isinstance(error, RecordingError | NotInstalled)
    # closing the recording may fail after an error of the plan; the plan's error is then the context
    unrecorded |= isinstance(getattr(error, "__context__", None), RecordingError)
    if recording is not None and recording.path.is_file() and not unrecorded:
        shown = recording.path if log.is_absolute() else Path(os.path.relpath(recording.path, folder))
        tell(f"pycram: recorded to {shown} ({recording.path.stat().st_size / 1e6:.1f} MB). Next:")
        _tell_next(shlex.quote(str(shown)), code, error)
        if live == _PAGE and not isinstance(error, KeyboardInterrupt | Terminated):
            _keep_page(recording)
        if debug and code == FAILED:
            given = ["--arguments", *spec.arguments] if spec.arguments else []  # a recording hides secret arguments
            command = [sys.executable, "-P", "-m", "replay", "debug", str(recording.path), *given]
            subprocess.run(command, check=False)  # noqa: S603  this package must not import replay
    return code


def _tell_next(log: str, code: int, error: BaseException | None) -> None:
    for verb in ("info", "tree", "view") if code == SUCCEEDED else ("why", "tree", "view"):
        tell(f"  pycram-replay {verb} {log}")
    if code == FAILED and isinstance(error, Exception):
        tell(f"  pycram-replay show {log} last  # the whole traceback")


def _report(error: BaseException) -> int:
    from pycram.foundation.failures import PlanFailure, PropertyViolated, PycramError  # noqa: PLC0415  heavy
    from recorder.properties import BadProperty  # noqa: PLC0415  heavy
    from recorder.records import format_assertion, format_error  # noqa: PLC0415  heavy
    from recorder.records.tracebacks import entries  # noqa: PLC0415  heavy
    from recorder.tracing.call_stack import is_plan  # noqa: PLC0415  heavy
    from recorder.tracing.folding import format_folded  # noqa: PLC0415  heavy

    match error:
        case RecordingError() | NotInstalled() | BadProperty():
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
    if not isinstance(error, PropertyViolated) or any(is_plan(each.tb_frame) for each in entries(error.__traceback__)):
        tell(format_folded(error, PycramError).rstrip())
    kind = "uses PyCRAM wrongly" if isinstance(error, PycramError) else "has an error"
    text = f"the plan {'failed' if isinstance(error, PlanFailure) else kind}: {format_error(error)}"
    innermost = entries(error.__traceback__)[-1:]
    if type(error) is AssertionError and innermost and is_plan(innermost[0].tb_frame):
        line = getline(innermost[0].tb_frame.f_code.co_filename, innermost[0].tb_lineno)
        text = format_assertion(format_error(error).partition(": ")[2], line.strip())
    tell(f"\npycram: {text.partition(chr(10))[0]}")
    return FAILED


def _watching(spec: RunSpec) -> contextlib.AbstractContextManager[list[str]]:
    """Return a context that watches a run's properties; it yields the messages of violations."""
    if not spec.checks:
        return contextlib.nullcontext([])
    from pycram.monitoring import watched  # noqa: PLC0415  heavy

    return watched(spec.checks, by_run=True, only_record=spec.only_record)


def tell(text: str) -> None:
    """Print a message to stderr. If stderr is closed, the message is lost."""
    with until_closed():
        print(text, file=sys.stderr)


def _keep_page(recording: Recording) -> None:
    """Serve the viewer's page until Ctrl-C if a terminal started the plan."""
    if recording.viewer is None or not sys.stdin.isatty():
        return
    tell("pycram: the page is served until Ctrl-C")
    with contextlib.suppress(KeyboardInterrupt):
        recording.viewer.wait()


def chosen_seed(given: int | None) -> int:
    """Return a run's seed: the given seed, the user's ``PYTHONHASHSEED``, or a random seed."""
    if given is not None:
        return given
    process, _, inherited = os.environ.get(_RESTARTED, "").partition(":")
    text = os.environ.get(_HASH, "")
    chosen_by_run = text == inherited and process != str(os.getpid())  # PYTHONHASHSEED comes from a plan's process
    if text.isdecimal() and int(text) <= MAX_SEED and not chosen_by_run:
        return int(text)
    return random.SystemRandom().randrange(MAX_SEED + 1)


def restart(seed: int) -> None:
    """Restart this command in this process with ``PYTHONHASHSEED`` set, unless it already has this seed."""
    mark = f"{os.getpid()}:{seed}"
    if os.environ.get(_RESTARTED) == mark or sys.flags.ignore_environment:
        return
    if os.environ.get(_HASH) == str(seed) and (sys.flags.hash_randomization or not seed):
        return
    environment = os.environ | {_HASH: str(seed), _RESTARTED: mark}
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)  # noqa: S606  the same command


def seed_random_numbers(seed: int | None) -> None:
    """Seed the global random generators of Python and NumPy; do nothing for None."""
    if seed is None:
        return
    import numpy as np  # noqa: PLC0415  imported here, because only the restarted process needs it

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  plans may use NumPy's old interface


def seed(number: int) -> None:
    """Seed the random numbers of Python and NumPy and the order of branches, as ``run --seed`` does.

    ``PYTHONHASHSEED`` determines the order of sets of texts, which is fixed when Python starts.

    Raises:
        BadArgument: The number isn't an integer from 0 to 2**32 - 1.
    """
    from pycram.foundation.failures import BadArgument  # noqa: PLC0415  imported here: slow, and --help doesn't need it
    from pycram.scheduling.schedule import seed_order  # noqa: PLC0415  as above

    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= MAX_SEED:
        raise BadArgument("number", number, f"an integer from 0 to {MAX_SEED}")
    seed_random_numbers(number)
    seed_order(number)
