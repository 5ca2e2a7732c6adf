"""The origin of a run: arguments, directory, seeds, revisions of the code, and computer."""

from __future__ import annotations

import functools
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from recorder.records import Revision, Run, escaped
from recorder.records.values import LEFT_OUT, is_secret, without_secrets

_TIMEOUT: Final = 2.0  # timeout in s for an answer of git
_PACKAGES: Final = ("pycram", "recorder")  # the packages that run plans


def describe(
    run: Run,
    arguments: Sequence[str],
    program: Path | None,
    seed: int | None,
    order: str,
    parameters: Mapping[str, Any],
) -> None:
    """Add a run's inputs to the record of its start. ``order`` is "" if the seed determines the order of branches."""
    run.arguments.extend(without_secrets([escaped(str(text)) for text in arguments]))
    for name, value in parameters.items():
        text = json.dumps(LEFT_OUT if is_secret(name) else value, default=str)
        run.parameters.add(name=escaped(name), value_json=text)
    with suppress(OSError):  # the directory may have been removed
        run.directory = escaped(str(Path.cwd()))
    if seed is not None:
        run.seed = str(seed)
    run.order = order
    run.hash_seed = hash_seed()
    if program is not None and program.is_file():
        run.program = escaped(str(program.absolute()))
        run.plan.CopyFrom(_plan_revision(program.resolve()))
    run.pycram.CopyFrom(pycram_revision())
    run.host, run.cpu = escaped(platform.node()), _cpu()


def main_program() -> Path | None:
    """Return the program file of this process; None at a prompt."""
    file = getattr(sys.modules.get("__main__"), "__file__", None)
    return Path(file) if file else None


def look_up_revisions(plan: Path | None = None) -> None:
    """Look up the revisions of PyCRAM and of the plan, by default the program, before this process forks many runs."""
    pycram_revision()
    program = plan or main_program()
    if program is not None and program.is_file():
        _plan_revision(program.resolve())


def metadata(run: Run) -> dict[str, str]:
    """Return the metadata of a file for a run that begins now, for programs that can't read our records."""
    return {"plan": run.name, "plan_arguments": " ".join(run.arguments), "started_ns": str(time.time_ns())}


def hash_seed() -> str:
    """Return the seed of text hashes, a number or "random". These hashes determine the order of Python's sets."""
    seed = os.environ.get("PYTHONHASHSEED", "")
    if not sys.flags.hash_randomization:
        return "0"
    return seed if seed.isdecimal() and not sys.flags.ignore_environment else "random"


@functools.cache
def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, "") or platform.processor() or platform.machine()


@functools.lru_cache(maxsize=64)
def _plan_revision(program: Path) -> Revision:
    return _revision(program, sha256(program.read_bytes()).hexdigest())


@functools.cache
def pycram_revision() -> Revision:
    """Return the revision of the executor and the recorder, with a hash of their Python files."""
    root = Path(__file__).resolve().parent.parent
    digest = sha256()
    for package in _PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(f"{file.relative_to(root).as_posix()}\0".encode() + file.read_bytes())
    return _revision(Path(__file__).resolve(), digest.hexdigest())


def _revision(file: Path, digest: str) -> Revision:
    """Return a revision with the given hash and, if git tracks the file, with the commit of its repository."""
    states = _git(file, "status", "--porcelain=v2", "--branch", "--untracked-files=no")
    names = _git(file, "ls-files", "--error-unmatch", "--", file.name)
    if not names:  # a package may be inside a repository of another project
        return Revision(sha256=digest)
    head = [line.removeprefix("# branch.oid ") for line in states if line.startswith("# branch.oid ")]
    commit = head[0] if head and head[0] != "(initial)" else ""
    return Revision(commit=commit, modified=any(not line.startswith("#") for line in states), sha256=digest)


def _git(file: Path, *words: str) -> list[str]:
    """Return the lines of git's output in the folder of a file, without locks; [] after a failure."""
    command = ["git", "-C", str(file.parent), *words]
    try:
        done = subprocess.run(  # noqa: S603  the command contains no user input
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=os.environ | {"GIT_OPTIONAL_LOCKS": "0"},
            text=True,
            errors="replace",
            timeout=_TIMEOUT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return []
    return done.stdout.splitlines()
