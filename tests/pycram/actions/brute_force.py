"""Any way to carry a thing to the island, by brute force: each base pose, arm and place is tried, and what it needs first.

It knows nothing of places and actions: it draws a base pose, does the motion, and where that is refused draws the next
one. What it finds is a list of motions, which can be done again.

``python -m tests.pycram.actions.brute_force 6 8`` searches in kitchens 6 and 8, and writes it down in ``kitchens.json``.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.designator import MotionDesignator
from pycram.failures import PlanFailure
from pycram.process_module import ProcessModule
from recorder import geometry
from tests.random_kitchens import SPOTS, build, draw, size, stands_on_island

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.bullet_world import Object
    from tests.random_kitchens import Scene

    #: Slots of a motion, with objects by their names.
    Motion = dict[str, Any]

RESULTS: Final = Path(__file__).with_name("kitchens.json")
SECONDS: Final = 60.0  # of the processor
MOTIONS: Final = 20_000
_SHARE: Final = 0.25  # of the budget, after which something is done first
_PLACINGS: Final = 25  # for each way to hold it
_NEAR: Final = 0.35  # m from the thing to what may block it
_TOP: Final = SPOTS["island"]


class _Spent(Exception):
    """The budget is."""


@dataclass
class Search:
    """A search for a way.

    Attributes:
        scene: to find one in.
        seconds: of the processor that it may take.
        motions: that it may try.
        tried: so far.
        way: motions that have led to where the world is.
    """

    scene: Scene
    seconds: float = SECONDS
    motions: int = MOTIONS
    tried: int = 0
    way: list[Motion] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.began = time.process_time()
        self.rng = np.random.default_rng([60, self.scene.drawing.seed])

    def run(self) -> list[Motion] | None:
        """Return a way, None if none was found within the budget."""
        start = self.scene.world.save()
        for number, first in enumerate(self._firsts()):
            self.scene.world.restore(start)
            self.way = []
            self.limit = min(1.0, _SHARE * (number + 1)) if number < 6 else 1.0
            try:
                self._park()
                if all(step() for step in first) and self._carry(self.scene.thing, check=True):
                    return self.way
            except _Spent:
                if self._used() >= 1.0:
                    return None
        return None

    def _used(self) -> float:
        return max((time.process_time() - self.began) / self.seconds, self.tried / self.motions)

    def _firsts(self) -> Iterator[list[Any]]:
        """Yield what may have to be done first, again and again: with each round, more of the budget is used."""
        scene, spot = self.scene, self.scene.spot
        shut = spot.joint and scene.kitchen.get_joint_position(spot.joint) < 0.8 * spot.open
        opening = [lambda: self._access(spot.joint, spot.open)] if shut else []
        at = scene.thing.get_position()
        near = sorted((math.dist(at, body.get_position()), body.name, body) for body in scene.others)
        blocking = [body for away, _, body in near if away < _NEAR]
        ajar = [joint for joint in scene.drawing.joints if joint != spot.joint]
        yield opening
        for body in blocking:
            yield [*opening, lambda body=body: self._carry(body)]
        for joint in ajar:
            yield [lambda joint=joint: self._access(joint, 0.0), *opening]
        for body in blocking[1:]:
            yield [*opening, *[lambda b=b: self._carry(b) for b in (blocking[0], body)]]
        while True:
            yield opening

    def _perform(self, **motion: Any) -> bool:
        """Do a motion; whether it succeeded."""
        if self._used() >= self.limit:
            raise _Spent
        self.tried += 1
        try:
            perform(self.scene, motion)
        except PlanFailure:
            return False
        self.way.append(motion)
        return True

    def _park(self) -> None:
        """Fold the arms, as far as that is possible."""
        arms = [f"{arm}-arm" for arm in self.scene.robot.description.arms]
        if not self._perform(type="move-arm-joints", **dict.fromkeys(arms, "park")):
            for arm in arms:
                self._perform(type="move-arm-joints", **{arm: "park"})

    def _stand(self, about: Sequence[float], nearest: float = 0.4, farthest: float = 1.1) -> bool:
        """Draw a base pose about a point, facing it more or less; whether the robot gets there."""
        way, away = self.rng.uniform(-math.pi, math.pi), self.rng.uniform(nearest, farthest)
        x, y = about[0] + away * math.cos(way), about[1] + away * math.sin(way)
        yaw = way + math.pi + self.rng.uniform(-0.9, 0.9)
        turn = [round(value, 6) for value in geometry.from_rpy(0, 0, yaw)]
        return self._perform(type="moving", target=[round(x, 3), round(y, 3), 0.0], orientation=turn)

    def _access(self, joint: str, distance: float) -> bool:
        """Open or close something, from anywhere."""
        kitchen = self.scene.kitchen
        handle = joint.removesuffix("_main_joint").removesuffix("_joint") + "_handle"
        begun, known = self.scene.world.save(), len(self.way)
        while True:
            self.scene.world.restore(begun)
            del self.way[known:]
            if not self._stand(kitchen.get_link_position(handle)):
                continue
            for arm in self._arms():
                what = {"drawer-joint": joint, "drawer-handle": handle, "part-of": kitchen.name}
                if self._perform(type="accessing", **what, arm=arm, distance=distance):
                    self._park()
                    return True

    def _carry(self, body: Object, check: bool = False) -> bool:
        """Take something and put it on the island."""
        begun, known = self.scene.world.save(), len(self.way)
        while True:
            self.scene.world.restore(begun)
            del self.way[known:]
            if not self._stand(body.get_position()):
                continue
            for arm in self._arms():
                if self._perform(type="pick-up", object=body.name, arm=arm) and self._deliver(body, arm, check):
                    return True

    def _deliver(self, body: Object, arm: str, check: bool) -> bool:
        self._park()
        held, known = self.scene.world.save(), len(self.way)
        for _ in range(_PLACINGS):
            target = self._target(body)
            if not self._stand(target) or not self._perform(type="place", object=body.name, target=target, arm=arm):
                pass
            else:
                self._park()
                if not check or not stands_on_island(self.scene):
                    return True
            self.scene.world.restore(held)
            del self.way[known:]
        return False

    def _target(self, body: Object) -> list[float]:
        x, y, z = self.scene.kitchen.get_link_position(_TOP.link)
        x += self.rng.uniform(_TOP.x[0] + 0.06, _TOP.x[1] - 0.06)
        y += self.rng.uniform(_TOP.y[0] + 0.06, _TOP.y[1] - 0.06)
        return [round(x, 3), round(y, 3), round(z + _TOP.z + size(body.type)[2] / 2 + 0.003, 4)]

    def _arms(self) -> list[str]:
        arms = list(self.scene.robot.description.arms)
        self.rng.shuffle(arms)
        return arms


def perform(scene: Scene, motion: Motion) -> None:
    """Do a motion of a way."""
    named = {slot: motion[slot] for slot in ("object", "part-of") if slot in motion}
    slots = motion | {slot: scene.world.get_object(name) for slot, name in named.items()}
    ProcessModule.perform(MotionDesignator(list(slots.items())))


def main() -> None:
    """Search in the kitchens whose seeds are given, and write down what comes of it."""
    for seed in map(int, sys.argv[1:]):
        scene = build(draw(seed))
        with scene.world:
            way = Search(scene).run()
        known = json.loads(RESULTS.read_text(encoding="utf-8"))
        known["ways"][str(seed)] = way
        known["ways"] = dict(sorted(known["ways"].items(), key=lambda item: int(item[0])))
        lines = ",\n".join(f'  "{number}": {json.dumps(found)}' for number, found in known["ways"].items())
        missed = json.dumps(known["missed"], indent=2).replace("\n", "\n ")
        RESULTS.write_text(f'{{\n "ways": {{\n{lines}\n }},\n "missed": {missed}\n}}\n', encoding="utf-8")
        print(f"kitchen {seed}: {'no way' if way is None else f'a way of {len(way)} motions'}", flush=True)


if __name__ == "__main__":
    main()
