"""Plans that fail, six for each of ten kinds of cause and others beside these, and what `why` says of them.

``causes.toml`` was written before `why` was asked, for the sixty by somebody who knew the plans and not its code: the
cause of each, what has to be in an explanation that names it, and what would blame something else. ``@name`` in there
is the line of the plan that ends with the comment ``# @name``.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from pycram.bullet_world import BulletWorld
from pycram.running import RunSpec, run
from replay.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Iterator

HERE = Path(__file__).parent
PLANS = HERE / "plans"
SHARED = PLANS / "household.py"
CAUSES = tomllib.loads((HERE / "causes.toml").read_text(encoding="utf-8"))
KINDS = dict.fromkeys("abcdefghij", 6) | {"k": 4, "l": 3, "m": 3, "n": 17}
#: The first of each kind is part of ``make test``.
PARAMETERS = [
    pytest.param(name, marks=[] if name == min(each for each in CAUSES if each[0] == name[0]) else [pytest.mark.long])
    for name in sorted(CAUSES)
]


def record(plan: Path) -> Path:
    """Runs a plan as the command line does, in this process, and returns its recording."""
    log = plan.with_suffix(".mcap")
    with warnings.catch_warnings():
        warnings.simplefilter("default")  # a warning is no error for who runs a plan
        try:
            run(RunSpec(plan), log)
        finally:
            sys.modules.pop(SHARED.stem, None)
            while BulletWorld.current_bullet_world is not None:
                BulletWorld.current_bullet_world.exit()
    return log


def interrupt(plan: Path, sent: str, printed: str, busy: bool) -> Path:
    """Runs a plan in a process of its own, and sends it a signal in the midst of what it does after it has printed."""
    log = plan.with_suffix(".mcap")
    command = [sys.executable, "-m", "pycram", "run", plan.name, "--log", log.name]
    with subprocess.Popen(
        command, cwd=plan.parent, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as made:
        assert made.stdout is not None
        try:
            said = iter(made.stdout)
            assert any(printed in line for line in said), "the plan has ended before"
            wait_until_in_midst(psutil.Process(made.pid), busy)
            made.send_signal(getattr(signal, sent))
            rest = "".join(said)
            made.wait(60)
        finally:
            made.kill()
    assert made.returncode != 0, rest
    return log


def wait_until_in_midst(process: psutil.Process, busy: bool) -> None:
    """Waits until a process has computed for 0.2 s, or has slept for 0.3 s and done nothing else."""
    computed, slept_since = process.cpu_times().user, time.monotonic()
    while process.cpu_times().user < computed + 0.2 if busy else time.monotonic() < slept_since + 0.3:
        if process.status() != psutil.STATUS_SLEEPING:
            slept_since = time.monotonic()


def explanation(text: str, plan: Path) -> str:
    """Returns what is said in an explanation: without the source that it quotes and the commands that it suggests."""
    quoted = {line.strip() for file in (plan, plan.with_name(SHARED.name)) for line in file.read_text().splitlines()}
    said = "\n".join(line for line in text.splitlines() if line.strip() not in quoted and "pycram-replay " not in line)
    return said.replace(f"{plan.parent}/", "")  # the folder of a test is named after it


def pattern(regex: str, plan: Path) -> str:
    """Puts the plan's lines in for their markers."""
    lines = plan.read_text().splitlines()
    marked = {found[1]: number for number, line in enumerate(lines, 1) if (found := re.search(r"# @(\w+)", line))}
    return re.sub(r"@(\w+)", lambda found: rf"(?:plan\.py:|\bline ){marked[found[1]]}\b", regex)


def found(regexes: list[str], text: str, plan: Path) -> Iterator[str]:
    return (regex for regex in regexes if re.search(pattern(regex, plan), text, re.IGNORECASE | re.MULTILINE))


def test_there_are_as_many_plans_of_each_kind_as_said() -> None:
    assert sorted(CAUSES) == sorted(plan.stem for plan in PLANS.glob("?_*.py"))
    assert {kind: sum(name[0] == kind for name in CAUSES) for kind in KINDS} == KINDS


@pytest.mark.slow
@pytest.mark.measure("causes that why names")
@pytest.mark.parametrize("name", PARAMETERS)
def test_why_names_the_cause(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = CAUSES[name]
    plan = tmp_path / "plan.py"  # so that its name tells nothing
    shutil.copy(PLANS / f"{name}.py", plan)
    shutil.copy(SHARED, tmp_path)
    signalled = "signal" in truth
    log = interrupt(plan, truth["signal"], truth["printed"], truth["busy"]) if signalled else record(plan)
    capsys.readouterr()
    main(["why", str(log)])
    whole = capsys.readouterr().out
    text = explanation(whole, plan)
    named = set(found(truth["names"], text, plan))
    missing = [regex for regex in truth["names"] if regex not in named]
    assert not missing, f"{name}: {truth['cause']}\nnot named: {missing}\n\n{whole}"
    misleading = list(found(truth["wrong"], text, plan))
    assert not misleading, f"{name}: {truth['cause']}\nmisleading: {misleading}\n\n{whole}"
