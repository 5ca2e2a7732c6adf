"""Exploring: races are found, and told by what decides; plans without one are said to have none."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from functools import partial
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.exploration import DEADLOCK, DIED, FAILED, SUCCEEDED, TIME_LIMIT, NotExplorable, explore
from pycram.failures import BadArgument
from pycram.fluent import Fluent
from pycram.language import par
from pycram.scheduling.cancellation import checkpoint
from recorder import provenance
from recorder.errors import RecordingError
from recorder.records import Run
from replay.retrace.retrace import retrace
from tests.measures import REPO, seeded
from tests.pycram.exploration import races

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@seeded("races found by exploring", range(len(races.RACES)), 1)
def test_a_race_is_found_and_told_by_what_decides(seeds: range, record_property: Callable[[str, object], None]) -> None:
    needed = 0
    for seed in seeds:
        for runs in (16, 50, 200):
            result = explore(races.RACES[seed], runs, seed=seed)
            if not result.alike:
                break
        needed += result.runs
        assert not result.alike, races.RACES[seed].__name__
        assert result.deterministic
        assert result.found[0].order == "added"
        for found in result.found[1:8]:
            assert 1 <= len(found.made) <= 6
            assert {each.first.file for each in found.made} == {races.__file__}
    record_property("runs", needed)
    record_property("races found", len(seeds))


def colored(count: int) -> None:
    with BulletWorld() as world, par as s:
        for cup in races.cups(world, count):
            s(cup.set_color, races.RED)


@pytest.mark.costly
def test_a_plan_without_a_race_is_said_to_have_none(tmp_path: Path) -> None:
    result = explore(partial(colored, 3), 12, folder=tmp_path)
    assert result.alike
    assert result.runs == 12
    assert result.orders > 6
    assert [found.ending.kind for found in result.found] == [SUCCEEDED]
    assert list(tmp_path.iterdir()) == [result.found[0].recording]  # one of each ending, also of the only one
    assert explore(partial(colored, 1), 12).orders == 1


@pytest.mark.costly
def test_what_decides_is_the_line_that_ran_too_early(tmp_path: Path) -> None:
    result = explore(races.a_count_loses_one, 16, seed=1, folder=tmp_path)
    good, bad = result.found
    assert good.ending.kind == SUCCEEDED
    assert (bad.ending.kind, bad.ending.failure) == (FAILED, "AssertionError")
    (made,) = bad.made
    with open(races.__file__, encoding="utf-8") as file:  # noqa: PTH123  as it is
        lines = file.read().splitlines()
    assert lines[made.second.line - 1].strip() == "cup.set_color(RED)"  # the other one has read the count already
    assert lines[made.first.line - 1].strip() == "s(paint, cup)"  # and this one hasn't begun
    assert (made.first.branch, made.second.branch) == ("par-2 paint", "par-1 paint")
    assert sorted(tmp_path.iterdir()) == [good.recording, bad.recording]
    for found in (good, bad):
        with replay.open(found.recording) as log:
            began, ended = log[0], log[-1]
            assert isinstance(began, Run)
            assert isinstance(ended, Run)
            assert began.order == found.order
            assert began.seed == "1"
            assert ended.succeeded == (found is good)


@pytest.mark.long
@pytest.mark.slow
def test_exploring_again_finds_the_same_and_another_seed_other_orders() -> None:
    def plan() -> None:
        seen: list[str] = []

        def look_at(thing: str) -> None:
            known = list(seen)
            checkpoint()
            seen[:] = [*known, thing]

        par(partial(look_at, "cup"), partial(look_at, "bowl"), partial(look_at, "milk"))
        assert len(seen) == 3

    first, second, other = (explore(plan, 8, seed=seed) for seed in (1, 1, 2))
    assert first == second
    assert not first.alike
    assert [found.count for found in other.found] != [found.count for found in first.found]


def test_the_code_s_revisions_are_looked_up_once_for_all_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git = tmp_path / "git"
    git.write_text(f"#!/bin/sh\necho $* >> {tmp_path / 'asked'}\n")
    git.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(sys.modules["__main__"], "__file__", __file__, raising=False)
    caches = provenance.pycram_revision, provenance._plan_revision
    try:
        for each in caches:
            each.cache_clear()
        assert explore(partial(par, checkpoint, checkpoint), 3).runs == 3
    finally:
        for each in caches:
            each.cache_clear()
    asked = (tmp_path / "asked").read_text().splitlines()
    assert len(asked) == len(set(asked)) == 4, "two questions about the plan, two about PyCRAM"


@pytest.mark.slow
def test_a_plan_that_ends_otherwise_in_the_same_order_is_not_deterministic(tmp_path: Path) -> None:
    def plan() -> None:
        par(checkpoint, checkpoint)
        (tmp_path / "done").touch(exist_ok=False)  # the first run ends well, no other one does

    result = explore(plan, 4)
    assert not result.deterministic
    assert not result.alike
    assert all(not found.made for found in result.found)


@pytest.mark.slow
def test_runs_differ_in_their_order_alone() -> None:
    def plan() -> None:
        par(checkpoint, checkpoint)
        assert random.random() < 0.5

    assert explore(plan, 6).alike


@pytest.mark.costly
def test_a_run_that_hangs_or_dies_is_an_ending() -> None:
    (deadlock,) = [each for each in explore(races.knife_and_fork, 16, seed=1).found if each.ending.kind == DEADLOCK]
    assert deadlock.ending.failure.count("races.py:") == 2
    (late,) = explore(partial(time.sleep, 1000), 1, limit=0.5).found
    assert (late.ending.kind, late.ending.failure) == (TIME_LIMIT, "the run was still running after 0.5 s")
    (dead,) = explore(os.abort, 1).found
    assert (dead.ending.kind, dead.ending.failure) == (DIED, "the process was ended by SIGABRT")


@pytest.mark.slow
def test_a_plan_that_interrupts_itself_has_failed() -> None:
    def plan() -> None:
        raise KeyboardInterrupt

    (found,) = explore(plan, 1).found
    assert (found.ending.kind, found.ending.failure) == (FAILED, "KeyboardInterrupt")


@pytest.mark.slow
def test_addresses_of_objects_and_lone_surrogates_are_no_differences() -> None:
    def plan(fails: bool) -> None:
        painted, ran = Fluent(None, "painted"), []
        par(partial(ran.append, 1), partial(ran.append, 2))
        kept = [object() for _ in range(1000 * ran[0])]
        painted.set_value(kept[-1])
        print("\ud800", file=sys.stderr)
        if fails:
            raise ValueError(str(kept[-1]))

    for fails, kind in ((False, SUCCEEDED), (True, FAILED)):
        result = explore(partial(plan, fails), 8)
        assert result.alike
        assert result.found[0].ending.kind == kind


def test_a_folder_that_isn_t_there_is_said_before(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="make the folder first"):
        explore(os.abort, 1, folder=tmp_path / "found")


def test_what_can_t_be_explored_is_said_before() -> None:
    for wrong in ({"runs": 0}, {"depth": 0}, {"limit": -1}, {"runs": 1.5}):
        with pytest.raises(BadArgument):
            explore(print, **wrong)
    with BulletWorld() as world:
        Object("cup", "cup", "cup.stl")
        world.set_realtime(True)
        with pytest.raises(NotExplorable, match="runs in real time"):
            explore(print)


@pytest.mark.costly
@pytest.mark.slow
def test_a_recording_of_a_found_order_is_retraced(tmp_path: Path) -> None:
    """Of both kinds of orders: as drawn, and as made small."""
    plan = tmp_path / "plan.py"
    plan.write_text(
        "from pycram.language import par\n"
        "from tests.pycram.exploration.races import BulletWorld, cups, put\n"
        "with BulletWorld(name='kitchen') as world:\n"
        "    things = cups(world, 3)\n"
        "    par(*[lambda thing=thing: [put(thing, x) for x in range(3)] for thing in things])\n"
    )
    recorded = []
    for order in ("added", "pct:3:3:12", "added:2-1@1,3-2@2"):
        log = tmp_path / f"{len(recorded)}.mcap"
        command = [sys.executable, "-m", "pycram", "run", plan, "--seed", "1", "--order", order, "--log", log]
        subprocess.run(
            command, check=True, capture_output=True, timeout=100, env=os.environ | {"PYTHONPATH": str(REPO)}
        )
        with replay.open(log) as recording:
            began = recording[0]
            assert isinstance(began, Run)
            assert began.order == order
            result = retrace(recording)
            assert result.identical, result.difference
            recorded.append([record.thread for record in recording])
    assert len({tuple(threads) for threads in recorded}) == 3
