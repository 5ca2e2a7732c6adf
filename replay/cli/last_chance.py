"""``last-chance``: find the last step from which a failed plan could still have succeeded."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.cli.fix import difference, existing_folder
from replay.cli.main import FAILED, FINE
from replay.cli.minimise import add_trials
from replay.cli.retrace import AGAIN
from replay.recording import Recording
from replay.report import phrases

if TYPE_CHECKING:
    from replay.fix.last_chance import LastChance
    from replay.fix.trials import Trials

_MAX_OTHERS: Final = 3  # maximum number of choices that don't help and are listed


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: a last chance was found. 1: none was found. To repair the plan, see fix."
    parser.add_argument("--holds", metavar="PROPERTY", action="append", default=[], help="require this property")
    parser.add_argument("--keep", metavar="DIR", default=".", help="folder for the successful recording (default: .)")
    add_trials(parser, budget=80)


def run(log: Recording, options: argparse.Namespace) -> int:
    from replay.fix.last_chance import LastChance, last_chance  # noqa: PLC0415  needs the executor
    from replay.fix.trials import Trials  # noqa: PLC0415  as above

    folder = existing_folder(options.keep)
    found = LastChance()
    with Trials(log, allow_effects=options.allow_effects) as trials:
        print_message(f"{trials.program.name} runs again, up to about {options.budget} times; {AGAIN}")
        try:
            last_chance(trials, log, folder, found, holds=options.holds, budget=options.budget)
        except KeyboardInterrupt:
            print_message("interrupted; these are the results until then")
        print_result(lambda: _data(trials, found), _lines(trials, log, found), as_json=options.json)
    return FINE if found.step is not None else FAILED


def _data(trials: Trials, found: LastChance) -> dict[str, object]:
    return {
        "step": found.step,
        "closed_by": found.closed,
        "line": str(found.line) if found.line is not None else None,
        "choice": found.choice,
        "repair": "\n".join(difference(trials, found.repair.edit.text)) if found.repair is not None else "",
        "recording": str(found.recording) if found.recording is not None else None,
        "runs": found.runs,
        "exceptions": found.exceptions,
        "others": found.others,
    }


def _lines(trials: Trials, log: Recording, found: LastChance) -> Iterator[str]:
    if found.step is not None:
        yield f"last chance: step {found.step} of {len(log)}"
        if found.choice:
            yield f"  from there, the plan succeeds with {found.choice}"
        elif found.repair is not None:
            yield f"  from there, the plan succeeds with an edit: {found.repair.edit.what}"
            yield from (f"  {line}" for line in difference(trials, found.repair.edit.text))
        yield f"  its run: {found.recording}"
    else:
        yield "no last chance found: no choice on record and no repair leads to success"
    if found.closed is not None:
        where = f", at {found.line}: {found.line.text}" if found.line is not None else ""
        yield f"closed by step {found.closed}{where}"
    for step in found.exceptions:
        yield f"the plan also fails with the objects as they were before step {step}"
    yield from (f"  no help: {phrases.one_line(each)}" for each in found.others[:_MAX_OTHERS])
    yield f"{phrases.plural(found.runs, 'run')}"
