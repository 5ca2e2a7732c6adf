"""Random plans: what was recorded is what was, in states and in worlds, and every one is verified bit for bit."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder.records import Run
from replay.restore.verify import verify
from tests.measures import seeded
from tests.replay.approximately import assert_approximately
from tests.replay.plans import RandomPlan, Witness, everything

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("nothing_left")


def check_random_plan(seed: int, folder: Path) -> None:
    file = folder / f"{seed}.mcap"
    witness = Witness()
    with recorder.record(file) as recording:
        recording.journal.add_sink(witness)
        RandomPlan(seed, witness).run()
    with replay.open(file) as log:
        for step, seen in witness.seen.items():
            state = log.state_at(step)
            for name, live in seen.items():
                assert_approximately(facts_of(state.worlds[name]), live, f"plan {seed}, step {step}")
        dice = random.Random(seed)
        for step in dice.sample(sorted(step for step, seen in witness.seen.items() if seen), 2):
            for name, live in witness.seen[step].items():
                with log.world_at(step, name, exact=dice.random() < 0.5) as world:
                    assert_approximately(everything(world), live, f"plan {seed}, world_at({step})")
        verdict = verify(log)
        assert verdict.exact, f"plan {seed}: {verdict}"
        end = next(log.backwards())
        assert isinstance(end, Run)


def facts_of(world: replay.World) -> dict[str, object]:
    """A state in the form of what a live world is asked for."""
    facts: dict[str, object] = {}
    for body in world.bodies.values():
        numbers = [*body.position, *body.orientation, *body.velocity, *body.joints.values()]
        facts[body.name] = {
            "type": body.type,
            "numbers": [*numbers, *body.joint_velocities.values()],
            "color": body.color or None,
        }
    for (carrier, body), held in world.attachments.items():
        facts[f"{carrier} holds {body}"] = {
            "links": (held.carrier_link, held.body_link),
            "numbers": [*held.position, *held.orientation],
        }
    return facts | {"gravity": world.gravity, "sim_step": world.sim_step, "robot": world.robot or None}


@pytest.mark.slow
def test_random_plans_are_verified(tmp_path: Path) -> None:
    for seed in range(2):
        check_random_plan(seed, tmp_path)


@seeded("random plans, verified", range(2, 200), 4)
def test_many_random_plans_are_verified(tmp_path: Path, seeds: range) -> None:
    for seed in seeds:
        check_random_plan(seed, tmp_path)
