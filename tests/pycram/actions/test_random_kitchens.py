"""Transports to the island in 200 random kitchens: with places that were given, and found, imagined first and not.

``kitchens.json`` has, for kitchens in which some way of ours has failed, what a search by brute force found there:
``ways`` are lists of motions, null where there is none. ``missed`` says why where we fail and a way is known.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
from replay.cli.main import main
from tests.measures import REPO, seeded
from tests.pycram.actions import brute_force
from tests.pycram.actions.transports import transport
from tests.random_kitchens import build, draw, rests, stands_on_island, touching

if TYPE_CHECKING:
    from pathlib import Path

    from tests.pycram.actions.transports import Mode

KITCHENS = range(200)
KNOWN = json.loads(brute_force.RESULTS.read_text(encoding="utf-8"))
WAYS = {int(seed): way for seed, way in KNOWN["ways"].items()}
FAILING = sorted(
    {seed for seed, way in WAYS.items() if way is None} | {int(seed) for seed in KNOWN["missed"]["unprojected"]}
)
FOUND = [seed for seed, way in WAYS.items() if way is not None]
INSIDE = 0.003  # m that nothing is deeper in something else

STATE = """
import sys
from tests.random_kitchens import build, draw
scene = build(draw(int(sys.argv[1])))
print([(body.name, body.get_position_and_orientation(), body.get_joint_positions()) for body in scene.world.objects])
"""


@seeded("random kitchens that are sound", KITCHENS, 5)
def test_a_random_kitchen_is_at_rest_and_nothing_is_in_anything(seeds: range) -> None:
    for seed in seeds:
        scene = build(draw(seed))
        with scene.world:
            assert scene.world.settle(timeout=0.5), seed
            assert rests(scene.kitchen, scene.thing, scene.drawing.thing), seed
            assert len(scene.others) >= len(scene.drawing.others) - 1, seed
            loose = [scene.thing, *scene.others, scene.robot]
            pairs = touching(scene.world, loose, scene.world.objects, 0.0)
            assert not [pair for pair in pairs if pair[2] < -INSIDE], seed
            assert stands_on_island(scene), "it is elsewhere"


@pytest.mark.slow
def test_a_seed_gives_the_same_kitchen_in_any_process() -> None:
    command = [sys.executable, "-W", "ignore", "-c", STATE, "19"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPO, timeout=120)
    scene = build(draw(19))
    with scene.world:
        states = [
            (body.name, body.get_position_and_orientation(), body.get_joint_positions()) for body in scene.world.objects
        ]
        assert ended.stdout.splitlines()[-1] == str(states)


def _carry(mode: Mode, seeds: range, record_property: pytest.RecordProperty) -> None:
    succeeded = impossible = missed = 0
    thinking = 0.0
    for seed in seeds:
        done = transport(seed, mode)
        thinking += done.thinking
        if done.succeeded:
            succeeded += 1
        elif mode == "fixed":
            continue
        elif seed not in WAYS:
            pytest.fail(f"{done}: search for a way: python -m tests.pycram.actions.brute_force {seed}")
        elif WAYS[seed] is None:
            impossible += 1
        else:
            missed += 1
            assert str(seed) in KNOWN["missed"][mode], done
    record_property("on the island", succeeded)
    record_property("without any way", impossible)
    record_property("missed", missed)
    record_property("s of thinking", round(thinking, 2))


@seeded("transports in random kitchens, with fixed poses", KITCHENS, 5, always=0)
def test_transports_with_fixed_poses(seeds: range, record_property: pytest.RecordProperty) -> None:
    _carry("fixed", seeds, record_property)


@seeded("transports in random kitchens", KITCHENS, 2)
def test_transports(seeds: range, record_property: pytest.RecordProperty) -> None:
    _carry("unprojected", seeds, record_property)


@seeded("transports in random kitchens, imagined first", KITCHENS, 2, always=0)
def test_transports_that_are_imagined_first(seeds: range, record_property: pytest.RecordProperty) -> None:
    _carry("projected", seeds, record_property)


@pytest.mark.parametrize("mode", ["unprojected", "projected"])
def test_nine_of_ten_transports_that_are_possible_succeed(mode: Mode) -> None:
    missed = {int(seed) for seed in KNOWN["missed"][mode]}
    assert missed <= set(FOUND), "only what is possible can be missed"
    possible = len(KITCHENS) - sum(way is None for way in WAYS.values())
    assert len(missed) <= 0.1 * possible


def _first_and_long(seeds: list[int]) -> list[object]:
    return [*seeds[:1], *(pytest.param(seed, marks=pytest.mark.long) for seed in seeds[1:])]


@pytest.mark.slow
@pytest.mark.parametrize("seed", _first_and_long(FAILING))
def test_a_failed_transport_is_explained_by_the_choice_that_could_not_be_made(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log):
        assert not transport(seed, "unprojected").succeeded
    assert main(["why", str(log)]) == 0
    lines = capsys.readouterr().out.splitlines()
    tried = lines[lines.index("Attempts of transporting(object=thing, target=island) action") + 1 :]
    tried = [line.strip() for line in tried[: tried.index("")]]
    assert tried[-1].startswith(("there was no further choice: ", "the budget"))
    reasons = tried[1:-1:2]
    assert reasons
    assert all(re.match(r"of \d+ places .*\d|\w+: .+|the same", reason) for reason in reasons), reasons


@pytest.mark.slow
@pytest.mark.parametrize("seed", _first_and_long(FOUND))
def test_known_paths_are_free(seed: int) -> None:
    scene = build(draw(seed))
    with scene.world:
        for motion in WAYS[seed]:
            brute_force.perform(scene, motion)
        assert not stands_on_island(scene)


@pytest.mark.slow
def test_a_transport_goes_on_where_all_places_for_a_handle_were_tried() -> None:
    assert transport(18, "unprojected").succeeded


@pytest.mark.slow
@pytest.mark.parametrize("seed", [155, 90])
def test_a_drawer_in_the_way_is_closed_and_a_door_opened_wider(seed: int) -> None:
    done = transport(seed, "unprojected")
    assert done.succeeded, done


@pytest.mark.costly
@pytest.mark.slow
def test_what_trembles_elsewhere_is_no_failure_of_a_transport() -> None:
    done = transport(106, "unprojected")
    assert done.succeeded, done.problem
    assert not done.failure
