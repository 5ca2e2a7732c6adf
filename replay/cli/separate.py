"""``separate``: facts that separate the failed runs of a folder from the successful runs."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.errors import ReplayError
from replay.report.phrases import percent, plural
from replay.runs.separation import LEVEL, Claim, Separation, separate
from replay.runs.statistics import names_of, plan_of, statistics

if TYPE_CHECKING:
    from replay.runs.folder import Runs

_MAX_CLAIMS: Final = 5
_MAX_ALSO: Final = 5
HOW_FAR: Final = "this fact reflects the run's progress, so it may be a symptom of the failure"


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "With random data, fewer than 1 of 100 folders would yield a claim (Westfall, Young)."
    parser.add_argument("--plan", metavar="NAME", help="only runs of this plan (default: the plan with the most runs)")
    parser.add_argument("--cause", metavar="N", type=int, help="only failures with cause N in the output of stats")
    parser.add_argument("--all", action="store_true", help=f"print all claims (default: {_MAX_CLAIMS})")


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    plan, others = plan_of(runs, options.plan)
    for other, count in others:
        print_message(f"left out: {count} runs of another plan, {other}")
    names = names_of(runs, plan)
    found = separate(runs, names, _cause(runs, plan, options.cause))
    shown = found.claims if options.all else found.claims[:_MAX_CLAIMS]
    print_result(lambda: _data(found), _lines(runs, found, shown), as_json=options.json)


def _cause(runs: Runs, plan: str, number: int | None) -> str | None:
    if number is None:
        return None
    found = statistics(runs, plan).causes
    if not 1 <= number <= len(found):
        raise ReplayError(f"there is no cause {number}; the failures have {plural(len(found), 'cause')}")
    return found[number - 1].cause


def _lines(runs: Runs, found: Separation, shown: tuple[Claim, ...]) -> Iterator[str]:
    yield f"{found.failures} failures and {found.successes} successes; {plural(found.compared, 'fact')} compared"
    if not found.failures or not found.successes:
        yield "a comparison needs failures and successes"
    elif not found.claims:
        yield "no recorded fact separates failures from successes"
    for number, claim in enumerate(shown, 1):
        yield from ("", f"{number}. {sentence(claim, found)}")
        low, high = claim.fact.interval
        scores = (
            f"Ochiai {claim.ochiai:.2f}, Tarantula {claim.fact.tarantula:.2f}, "
            f"probability of a random result {max(claim.chance, 1e-99):.0e}"
        )
        effect = f"{percent(claim.fact.effect)} (95 %: {percent(low)} to {percent(high)})"
        yield f"   raises the failure rate by {effect}; {scores}"
        if claim.fact.how_far:
            yield f"   {HOW_FAR}"
        if claim.also:
            more = f" and {len(claim.also) - _MAX_ALSO} more" if len(claim.also) > _MAX_ALSO else ""
            yield f"   true of the same runs: {'; '.join(claim.also[:_MAX_ALSO])}{more}"
        if claim.success:
            a, b = (shlex.quote(str(runs.path / name)) for name in (claim.failure, claim.success))
            yield f"   pycram-replay diff {a} {b}"
    if len(shown) < len(found.claims):
        yield from ("", f"{plural(len(found.claims) - len(shown), 'more claim')}: --all")
    if found.claims and found.explained < found.failures:
        yield from ("", f"{plural(found.failures - found.explained, 'failure')} without any of these facts")


def sentence(claim: Claim, found: Separation) -> str:
    """Return a claim as text: "arm=right at pick-up(spoon): 31 of 33 failures, 4 of 467 successes"."""
    fact = claim.fact
    return f"{fact.text}: {fact.failed} of {found.failures} failures, {fact.succeeded} of {found.successes} successes"


def _data(found: Separation) -> dict[str, object]:
    return {
        "failures": found.failures,
        "successes": found.successes,
        "compared": found.compared,
        "explained": found.explained,
        "level": LEVEL,
        "claims": [_claim(claim, found) for claim in found.claims],
    }


def _claim(claim: Claim, found: Separation) -> dict[str, object]:
    fact = claim.fact
    counts = {key: value for key, value in dataclasses.asdict(fact).items() if key not in ("true", "known", "evidence")}
    return counts | {
        "sentence": sentence(claim, found),
        "also": list(claim.also),
        "ochiai": claim.ochiai,
        "tarantula": fact.tarantula,
        "effect": fact.effect,
        "interval": list(fact.interval),
        "chance": claim.chance,
        "failure_run": claim.failure,
        "success_run": claim.success,
    }
