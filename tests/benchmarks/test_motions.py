"""What motions cost where they are done at once, in steps of the whole scene: ``make bench`` prints the table.

A step of the scene is the engine's own work in the same world, timed in turn with each motion.
"""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.world.transaction import restore_snapshot, take_snapshot
from tests.benchmarks.timing import goal, ratio, seconds, settlings

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.bullet_world import Object

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demos"))

import set_the_table
from set_the_table import COUNTER, ISLAND, go, open_drawer

from pycram import perform
from pycram.motion_designators import looking, moving, opening_gripper, pick_up, place

pytestmark = pytest.mark.slow

BEFORE_THE_DRAWER = [0.492, 0.89, 0]  # from where the arm holds the handle at the first try
STEPS = 20  # that are timed together


def motions(kitchen: Object) -> dict[str, tuple[Callable[[], object], Callable[[], object], float]]:
    """Motions, what comes before them, and what they may cost."""
    world = kitchen.world
    cereal, bowl = (world.get_objects_by_type(kind)[0] for kind in ("cereal", "bowl"))

    def carry() -> None:
        perform(pick_up(object=bowl, arm="right"))
        go(ISLAND)

    def stay() -> None: ...

    return {
        "moving": (lambda: perform(moving(target=[-0.3, 1, 0], orientation=[0, 0, 1, 0])), stay, 3),
        "looking": (lambda: perform(looking(object=cereal)), stay, 2),
        "opening-gripper": (lambda: perform(opening_gripper(gripper="left")), stay, 2),
        "pick-up": (lambda: perform(pick_up(object=bowl, arm="right")), stay, 8),
        "place, without its settling": (
            lambda: perform(place(object=bowl, target=[-0.8, 1.2, 0.9], arm="right")),
            carry,
            7,
        ),
        "opening a drawer": (
            lambda: open_drawer(kitchen),
            lambda: world.robot.set_position_and_orientation(BEFORE_THE_DRAWER, [0, 0, 0, 1]),
            12,
        ),
        "opening a drawer, by the sixth way to hold on": (lambda: open_drawer(kitchen), stay, 60),
    }


def test_what_motions_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    with redirect_stdout(StringIO()):
        kitchen = set_the_table.build_scene()
        go(COUNTER)
    world = kitchen.world
    world.simulate(0.5)
    before = {body: take_snapshot(body) for body in world.objects}
    settled = settlings(monkeypatch)
    print()
    for name, (motion, prepare, most) in motions(kitchen).items():

        def once(motion: Callable[[], object] = motion, prepare: Callable[[], object] = prepare) -> float:
            world.robot.detach_all()
            for body, state in before.items():
                restore_snapshot(body, state)
            prepare()
            settled.clear()
            took = seconds(motion)
            return took - sum(while_settling for while_settling, _ in settled)

        once()
        cost = ratio(once, lambda: seconds(lambda: world.engine.step(STEPS)) / STEPS, rounds=11)
        goal(f"{name}, in steps", cost, most)
    world.exit()
