"""Verbs that search for a way to success: ``fix`` finds an edit of the plan, ``last-chance`` the last possible step."""

from __future__ import annotations

import argparse
import difflib
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE
from replay.cli.minimise import add_trials
from replay.cli.retrace import AGAIN
from replay.errors import ReplayError
from replay.recording import Recording
from replay.report import phrases
from replay.report.report import write

if TYPE_CHECKING:
    from replay.fix.last_chance import LastChance
    from replay.fix.search import SearchResult
    from replay.fix.trials import Trials

_FIRST: Final = 4  # number of other choices that are forced before edits are tried
_MAX_OTHERS: Final = 3  # maximum number of candidates, or choices that don't help, that are listed


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: a repair was found. 1: none was found. To copy a damaged file, see repair."
    parser.add_argument("--holds", metavar="PROPERTY", action="append", default=[], help="require this property")
    parser.add_argument("--apply", action="store_true", help="write the best repair into the plan; PLAN.orig is kept")
    parser.add_argument("--keep", metavar="DIR", default=".", help="folder for the recordings of repairs (default: .)")
    add_trials(parser, budget=80)


def run(log: Recording, options: argparse.Namespace) -> int:
    from replay.fix.last_chance import LastChance, last_by_fork, other_choice  # noqa: PLC0415  needs the executor
    from replay.fix.search import SearchResult, search  # noqa: PLC0415  as above
    from replay.fix.trials import Trials  # noqa: PLC0415  as above

    folder = existing_folder(options.keep)
    found, chance = SearchResult(""), LastChance()
    with Trials(log, allow_effects=options.allow_effects) as trials:
        print_message(f"{trials.program.name} runs again, up to {options.budget} times; {AGAIN}")
        by_fork = last_by_fork(log) >= 0
        try:
            few = options.budget if by_fork else min(_FIRST, options.budget // 4)
            chance = other_choice(trials, log, folder, options.holds, few)
            if by_fork:
                print_message("a fork changed the world in this run, so only other choices are tried, and no edits")
            else:
                search(trials, log, folder, found, holds=options.holds, budget=options.budget - chance.runs)
            found.runs += chance.runs
        except KeyboardInterrupt:
            print_message("interrupted; these are the results until then")
        if options.apply and found.repairs:
            _apply(trials, found)
        data = {"choice": chance.choice, "step": chance.step}
        lines = _lines(log, trials, chance, found)
        print_result(lambda: _data(trials, found) | data, lines, as_json=options.json)
    return FINE if found.repairs or chance.choice else FAILED


def existing_folder(name: str) -> Path:
    """Return the path of a folder; raise ReplayError if it doesn't exist."""
    folder = Path(name)
    if not folder.is_dir():
        raise ReplayError(f"{folder}: no such folder; make it first")
    return folder


def _apply(trials: Trials, found: SearchResult) -> None:
    plan = trials.program
    if not _is_as_recorded(trials):
        raise ReplayError(f"{plan} differs from the recorded source, so nothing was written")
    kept = plan.with_name(f"{plan.name}.orig")
    shutil.copy2(plan, kept)
    write(str(plan), found.repairs[0].edit.text.encode())
    print_message(f"{plan} is repaired; the old plan is {kept}")


def _is_as_recorded(trials: Trials) -> bool:
    """Return whether the plan's file still has the recorded source."""
    return trials.program.is_file() and trials.program.read_text(encoding="utf-8") == trials.text


def _data(trials: Trials, found: SearchResult) -> dict[str, object]:
    names = ("seeds", "elsewhere", "mark")
    repairs = [
        {"line": each.edit.line, "edit": each.edit.what, "diff": "\n".join(difference(trials, each.edit.text))}
        | {
            "evidence": each.edit.evidence(trials.text),
            "recording": str(each.recording),
            **{name: getattr(each, name) for name in names},
        }
        for each in found.repairs
    ]
    return {"asked": found.asked, "repairs": repairs, "tried": found.tried, "runs": found.runs, "others": found.others}


def _lines(log: Recording, trials: Trials, chance: LastChance, found: SearchResult) -> Iterator[str]:
    from replay.fix.search import ONLY_RUNS  # noqa: PLC0415  needs the executor

    if chance.choice:
        yield f"the plan also succeeds with another choice, {chance.choice}:"
        recorded = "" if _is_as_recorded(trials) else " --recorded-source"
        yield f"  pycram-replay fork {log.path} --at {chance.step} --answer {shlex.quote(chance.choice)}{recorded}"
        yield f"  its run: {chance.recording}"
    if not found.asked:  # no edits were tried
        if not chance.choice:
            yield f"no repair found; tried {phrases.plural(len(chance.others), 'other choice')}"
            yield from (f"  {each}" for each in chance.others[:_MAX_OTHERS])
        return
    count = f"{phrases.plural(found.tried, 'candidate')} in {phrases.plural(found.runs, 'run')}"
    if not found.repairs:
        more = "fix knows no other edit of this plan" if found.exhausted else "with a larger --budget, fix tries more"
        yield f"no repair found; tried {count}; {more}"
        yield f"asked: {found.asked}"
        for what, failure in [*found.others.items()][:_MAX_OTHERS]:
            yield f"  {what}: {phrases.one_line(failure)}"
        return
    for number, each in enumerate(found.repairs):
        yield from ([""] if number else [])
        evidence = "" if each.mark else each.edit.evidence(trials.text)
        words = each.mark or evidence or ONLY_RUNS
        yield f"{'possible ' * (not evidence)}repair: {each.edit.what} ({words})"
        yield from difference(trials, each.edit.text)
        yield f"  its run: {each.recording}"
        seeds, places = each.checks
        if seeds or places:
            yield f"  it also succeeds under {each.seeds} of {seeds} other seeds,"
            yield f"  and in {each.elsewhere} of {places} runs with loose objects 1 cm elsewhere"
        else:
            yield "  it wasn't run with other seeds, or with loose objects elsewhere"
    yield ""
    yield f"asked: {found.asked}; tried {count}"


def difference(trials: Trials, text: str) -> Iterator[str]:
    """Yield the differences between a plan and its edited version, as a unified diff."""
    name = trials.program.name
    before, after = trials.text.splitlines(), text.splitlines()
    return difflib.unified_diff(before, after, f"a/{name}", f"b/{name}", lineterm="", n=2)


def add_last_chance(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: a last chance was found. 1: none was found. To repair the plan, see fix."
    parser.add_argument("--holds", metavar="PROPERTY", action="append", default=[], help="require this property")
    parser.add_argument("--keep", metavar="DIR", default=".", help="folder for the successful recording (default: .)")
    add_trials(parser, budget=80)


def run_last_chance(log: Recording, options: argparse.Namespace) -> int:
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
        print_result(lambda: _chance_data(trials, found), _chance_lines(trials, log, found), as_json=options.json)
    return FINE if found.step is not None else FAILED


def _chance_data(trials: Trials, found: LastChance) -> dict[str, object]:
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


def _chance_lines(trials: Trials, log: Recording, found: LastChance) -> Iterator[str]:
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
