"""What a plan imagines of a pick-up is what it then comes to, to the last bit."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from pycram.designator import MotionDesignator
from pycram.failures import PlanFailure
from pycram.process_module import ProcessModule
from pycram.projection import project
from recorder.records import STEPS_PER_SECOND
from tests.measures import seeded

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.bullet_world import BulletWorld


@seeded("pick-ups imagined, then done", range(200), 5)
def test_an_imagined_pick_up_ends_as_the_real_one(
    shared_scene: BulletWorld, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    saved = shared_scene.save()
    succeeded = 0
    for seed in seeds:
        dice = random.Random(seed)
        assert shared_scene.robot is not None
        shared_scene.robot.set_position([dice.uniform(0.55, 0.75), dice.uniform(0.5, 0.9), 0])
        body = shared_scene.get_object(dice.choice(("milk", "bowl", "cereal")))
        x, y, z = body.get_position()
        body.set_position([x + dice.uniform(-0.1, 0.1), y + dice.uniform(-0.1, 0.1), z])
        arm = dice.choice(("left", "right"))
        pick_up = MotionDesignator([("type", "pick-up"), ("object", body), ("arm", arm)])

        def take(pick_up: MotionDesignator = pick_up) -> float:
            shared_scene.simulate(0.1)
            ProcessModule.perform(pick_up)
            shared_scene.simulate(0.1)
            return random.random()

        began = shared_scene.sim_step
        outcome = project(take)
        assert (shared_scene.sim_step, body.carrier) == (began, None)
        raised = result = None
        try:
            result = take()
        except PlanFailure as failure:
            raised = failure
        assert (type(outcome.failure), str(outcome.failure)) == (type(raised), str(raised)), seed
        assert (outcome.result, outcome.duration) == (result, (shared_scene.sim_step - began) / STEPS_PER_SECOND), seed
        assert outcome.state is not None
        assert outcome.state.command == shared_scene.save().command, seed
        succeeded += outcome.succeeded
        shared_scene.restore(saved)
    record_property("succeeded", succeeded)
