"""Exercises of the tutorial: run the reader's plans, and check their recordings by properties.

``exercises.toml`` has the properties of each exercise, and the message to the reader if a property is violated.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any, Final

from pycram.running import FAILED, SUCCEEDED, WRONG_USAGE

_EXERCISES: Final = Path(__file__).with_name("exercises.toml")


def exercises() -> dict[str, dict[str, Any]]:
    """Return the exercises by their names, such as ``3_1``."""
    return tomllib.loads(_EXERCISES.read_text(encoding="utf-8"))


def check(chapter: int) -> int:
    """Check the exercises of a chapter in the working directory, print the results, and return the exit code."""
    mistakes = {
        name: _mistake(Path(f"exercise_{name}.py"), each)
        for name, each in exercises().items()
        if name.startswith(f"{chapter}_")
    }
    for name, mistake in mistakes.items():
        print(f"exercise_{name}.py: {mistake or 'right'}")
    return FAILED if any(mistakes.values()) else SUCCEEDED


def _mistake(plan: Path, exercise: dict[str, Any]) -> str:
    """Return the error in a plan, and a command that shows the error; "" without an error."""
    if not plan.is_file():
        return f"there is no such file in {Path.cwd()}"
    log, properties = plan.with_suffix(".mcap"), exercise["properties"]
    for options in exercise.get("runs", ["--seed 1"]):
        given = [*shlex.split(options), "--overwrite", "--log", str(log), str(plan)]
        ran = f"pycram run {shlex.join(given)}"
        ended = _run("pycram", "run", *given)
        if ended.returncode:
            why = "" if ended.returncode == WRONG_USAGE else f"\n  pycram-replay why {log}"
            return f"wrong: {_failure(ended.stderr)}\n  {ran}{why}"
        checked = _run("replay", "check", str(log), *properties, "--json")
        if not checked.stdout:  # a property names an object that the plan doesn't load
            return f"wrong: {_failure(checked.stderr)}\n  {ran}"
        for result in json.loads(checked.stdout):
            if not result["holds"] or result["note"]:
                text = result["property"]
                return f"wrong: {properties[text]}\n  {ran}\n  pycram-replay check {log} {shlex.quote(text)}"
    return ""


def _failure(text: str) -> str:
    """Return the line of a command's stderr that names the failure."""
    lines = [line for line in text.partition("pycram: recorded to")[0].splitlines() if line.strip()]
    return (lines or ["it doesn't run"])[-1].removeprefix("pycram: ").removeprefix("pycram-replay: ")


def _run(module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command line of PyCRAM; this package must not import replay."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  PyCRAM's own
