"""Sweeps: a plan runs many times, with different seeds and parameters, and each run is recorded.

Each run is a fork of a process that has imported and parsed the modules and models of runs. It executes the whole plan
from its start, with its own seed: so each recording is complete, and can be verified and retraced. A sweep that is
started again makes only the missing runs.
"""

from __future__ import annotations

import os
import shlex
import threading
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pycram import plan_parameters
from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.scheduling.locks import refuse_held
from pycram.seeding import MAX_SEED
from pycram.sweeping import folder as folders
from pycram.sweeping.folder import Sweep, SweepRefused, facts_of
from pycram.sweeping.local import Local, Worker, WorkerLost
from pycram.sweeping.one_run import RunLost, RunOutcome, Spec, Variations
from pycram.world.world import open_worlds
from recorder.tracing import forking

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

__all__ = ["LIMIT", "RunLost", "RunOutcome", "Sweep", "SweepRefused", "sweep"]

LIMIT: Final = 300.0  # s


def sweep(
    plan: str | Path,
    runs: int,
    folder: str | Path,
    *,
    seed: int = 0,
    set: Mapping[str, Sequence[Any]] | None = None,  # noqa: A002  as the command has it
    sample: Mapping[str, str] | None = None,
    cores: int = 0,
    limit: float = LIMIT,
    memory: int = 0,
    arguments: Sequence[str] = (),
    motion: str = "",
    locals: bool = True,  # noqa: A002  as they are called in Python
    ray: str | None = None,
    progress: Callable[[Sweep, RunOutcome | None], None] = lambda _, __: None,
) -> Sweep:
    """Run a plan many times; each run's recording is a file of a folder.

    If this process has threads, like a notebook, or worlds, the runs are forks of another process.

    Args:
        plan: Its file.
        runs: Number of runs; they are numbered from 0.
        folder: For the recordings; if it has a part of this sweep, the rest is made. With ``ray``, a folder that all
            nodes share, or any URL that fsspec knows.
        seed: Run N has the seed ``seed + N``, and draws its parameters from it.
        set: Values of parameters; the runs take all combinations in turn.
        sample: Distributions of parameters, as ``"uniform(0,1)"``; also normal, integers, choice.
        cores: Maximum number of parallel runs; 0 for one on each core.
        limit: Seconds of wall-clock time for each run.
        memory: Bytes of additional memory for each run; 0 for no limit.
        arguments: Of the plan.
        motion: The execution environment where the plan names none.
        locals: Whether failures hold the local variables of the plan's functions.
        ray: The address of a Ray cluster, or "" for one on this machine; None to use none.
        progress: Called at the start and after each run.

    Raises:
        SweepRefused: The folder has another sweep or is in use, or the system can't fork.
        UnknownParameter: The plan doesn't declare a parameter.
        BadArgument: An argument is wrong.
        LockHeld: The caller holds a lock.
    """
    refuse_held()
    spec = _spec(plan, folder, seed, set or {}, sample or {}, limit, memory, arguments, motion, local_variables=locals)
    for name, number, least in (("runs", runs, 1), ("cores", cores, 0)):
        if checks.number(name, number) != int(number) or number < least:
            raise BadArgument(name, number, f"a whole number from {least}")
    if ray is not None:
        from pycram.sweeping.on_ray import sweep_on_ray  # noqa: PLC0415  needs an extra

        return sweep_on_ray(spec, runs, str(folder), ray, cores, progress)
    if "://" in str(folder):
        raise BadArgument("folder", str(folder), "a folder; a URL is for a Ray cluster (--ray)")
    if not hasattr(os, "fork"):
        raise SweepRefused("this system can't copy a process (os.fork)")
    with folders.locked(Path(spec.folder)):
        return _sweep(spec, runs, cores, progress)


def _spec(
    plan: str | Path,
    folder: str | Path,
    seed: int,
    listed: Mapping[str, Sequence[Any]],
    sampled: Mapping[str, str],
    limit: float,
    memory: int,
    arguments: Sequence[str],
    motion: str,
    *,
    local_variables: bool,
) -> Spec:
    file = Path(plan)
    if not file.is_file():
        raise BadArgument("plan", str(plan), "the file of a plan")
    if checks.number("limit", limit) <= 0 or limit > threading.TIMEOUT_MAX:
        raise BadArgument("limit", limit, "seconds, more than 0")
    if checks.number("memory", memory) < 0:
        raise BadArgument("memory", memory, "bytes, 0 for any number")
    if checks.number("seed", seed) != int(seed) or not 0 <= seed <= MAX_SEED:
        raise BadArgument("seed", seed, f"a whole number from 0 to {MAX_SEED}")
    variations = Variations(listed, sampled)
    try:
        for values in variations.every():
            plan_parameters.check(file, values)
    except SyntaxError as error:
        raise SweepRefused(f"{plan}: {error}") from error
    return Spec(
        str(file.absolute()),
        str(Path(folder).absolute()),
        int(seed),
        tuple(arguments),
        {name: list(values) for name, values in listed.items()},
        dict(sampled),
        motion,
        local_variables,
        float(limit),
        int(memory),
    )


def _sweep(spec: Spec, runs: int, cores: int, progress: Callable[[Sweep, RunOutcome | None], None]) -> Sweep:
    folder = Path(spec.folder)
    facts = facts_of(spec, runs)
    models = (folders.begin(folder, facts).get("models") or {}).get("file")
    there = {each.name for each in folder.iterdir()}
    missing = [number for number in range(runs) if spec.name(number) not in there]
    result = Sweep(spec.folder, runs, before=runs - len(missing))
    progress(result, None)
    if not missing:
        return result
    # forks would lack the threads of this process and start with its worlds
    kind = Worker if forking.others() or open_worlds() else Local
    try:
        with closing(kind(spec, cores, models if models in there else None)) as process:
            for numbers in (missing[:1], missing[1:]):
                with closing(process.run(numbers)) as outcomes:
                    for outcome in outcomes:
                        if not result.take(outcome):
                            return result
                        if result.has_not_begun():
                            _set_aside(result, outcome)
                            return result
                        progress(result, outcome)
                if process.models:
                    folders.write(folder, {**facts, "models": process.models})
    except KeyboardInterrupt:
        result.interrupted = True
    except WorkerLost as error:
        result.stopped = f"{error}; started again, the sweep makes the runs that are missing"
    return result


def _set_aside(result: Sweep, outcome: RunOutcome) -> None:
    """Rename the recording of a plan that can't start, so that the fixed plan can be swept into the same folder."""
    folder = Path(result.folder)
    kept = (folder / outcome.name).replace(folder / result.failures[0].name)
    (folder / folders.SWEEP).unlink(missing_ok=True)
    result.stopped += f"; pycram-replay why {shlex.quote(str(kept))}"
