"""What separates failures from successes: seeded causes are found, and where there is none nothing is claimed."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.reasoning.choosing import choosing
from recorder import record
from replay.cli.main import main
from replay.runs.intervals import difference, fisher, holm, wilson
from replay.runs.runs import Runs
from replay.runs.separation import separate
from tests.measures import seeded
from tests.replay.runs.conftest import COUNT
from tests.replay.runs.seeded import Cause, sweep

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

RUNS = 48  # of a sweep of the measure


def rank(cause: Cause, folder: Path) -> int | None:
    """Which claim, from 1, is that of the cause; None if none is."""
    with Runs(folder) as runs:
        found = separate(runs)
    said = [(claim.fact.text, claim.fact.site, *claim.also) for claim in found.claims]
    return next(
        (at for at, texts in enumerate(said, 1) if any(each in t for t in texts for each in cause.expected)), None
    )


@seeded("separate: seeded causes", range(40), 1)
def test_the_seeded_cause_comes_first(
    seeds: range, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    for seed in seeds:
        cause = Cause.drawn(seed)
        folder = tmp_path / str(seed)
        folder.mkdir()
        sweep(folder, cause, range((seed + 100) * 1000, (seed + 100) * 1000 + RUNS))
        place = rank(cause, folder)
        record_property("first", int(place == 1))
        record_property("among the first three", int(place is not None and place <= 3))
        assert place is not None, cause


@seeded("separate: no cause", range(-20, 0), 20, always=0)
def test_without_a_cause_there_is_no_claim(
    seeds: range, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    silent = 0
    for seed in seeds:
        folder = tmp_path / str(seed)
        folder.mkdir()
        sweep(folder, Cause("none"), range((seed + 100) * 1000, (seed + 100) * 1000 + RUNS))
        with Runs(folder) as runs:
            silent += not separate(runs).claims
    record_property("without a claim", silent)
    assert silent >= 19


@pytest.mark.slow
def test_a_claim_in_words_with_two_runs_to_compare(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["separate", str(runs), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    claim = found["claims"][0]
    failed, succeeded = claim["failed"], claim["succeeded"]
    assert found["failures"] + found["successes"] == COUNT
    words = f"{failed} of {found['failures']} failures, {succeeded} of {found['successes']} successes"
    assert claim["sentence"] == f"arm=right at pick-up(spoon): {words}"
    assert claim["ochiai"] == pytest.approx(failed / math.sqrt(found["failures"] * (failed + succeeded)))
    low, high = claim["interval"]
    assert 0 < low < claim["effect"] <= high
    assert main(["diff", str(runs / claim["failure_run"]), str(runs / claim["success_run"])]) == 1
    assert main(["separate", str(runs)]) == 0
    assert f"1. arm=right at pick-up(spoon): {words}" in capsys.readouterr().out


@pytest.mark.slow
def test_the_query_that_raised_the_failure_is_no_claim(tmp_path: Path) -> None:
    for number in range(24):
        fails = number % 2 == 0
        with (
            suppress(PlanFailure),
            record(tmp_path / f"{number:02}.mcap", name="asks", parameters={"wide": fails}),
            BulletWorld() as world,
        ):
            thing = Object("milk", "milk", "milk.stl")
            with choosing("grasp", world, object=thing) as choice:
                if fails:
                    raise PlanFailure("no grasp fits")
                choice.take("front")
    with Runs(tmp_path) as runs:
        found = separate(runs)
    assert found.failures == 12
    assert [claim.fact.text for claim in found.claims] == ["wide=true"]
    assert not any("raises" in other for claim in found.claims for other in claim.also)


def test_intervals_and_chances() -> None:
    assert wilson(8, 10) == pytest.approx((0.4901625, 0.9433178), abs=1e-6)  # as R's prop.test without correction
    assert wilson(0, 0) == (0, 1)
    assert wilson(0, 20)[0] == 0
    assert difference(56, 70, 48, 80) == pytest.approx((0.0524, 0.3339), abs=1e-4)  # Newcombe 1998, table II, (a) 10
    assert fisher(3, 4, 1, 4) == pytest.approx(17 / 70)  # the lady who tastes tea
    assert fisher(0, 5, 5, 5) == pytest.approx(1)
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
