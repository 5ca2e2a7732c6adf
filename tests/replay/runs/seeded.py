"""Sweeps of a small plan with one seeded cause of failures each: a table is set, quickly, by a robot without arms.

Each run is a real one: the plan runs in PyCRAM and is recorded. What it draws - arms, places, grasps, where things
stand, the order of its branches - has nothing to do with its failures but for the one cause.
"""

from __future__ import annotations

import random
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import recorder
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import par
from pycram.process_module import ProcessModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.rejections import Unfit
from pycram.scheduling.schedule import seed_order

if TYPE_CHECKING:
    from collections.abc import Iterator

CABINET = Path(__file__).parents[1] / "golden" / "cabinet.urdf"
KINDS = ("threshold", "arm", "place", "object", "race", "grasp")
THINGS = ("milk", "bowl", "spoon")
ARMS = ("left", "right")
PLACES = {"island": [2.0, 0.0, 1.0], "table": [2.0, 1.0, 1.0], "shelf": [2.0, 2.0, 1.5]}
GRASPS = ("front", "left", "top")


class Dropped(PlanFailure):
    """The robot lost what it carried."""


class NotReady(PlanFailure):
    """Something that was needed wasn't there yet."""


@dataclass
class Cause:
    """What makes runs of a sweep fail.

    Attributes:
        kind: one of :data:`KINDS`, or "none": they fail by chance.
        thing: which object it is about.
        value: of the arm, place or grasp, or the threshold.
        expected: texts of which one is part of what a claim has to say.
        strength: how often runs fail that have it.
    """

    kind: str
    thing: str = ""
    value: Any = None
    expected: tuple[str, ...] = ()
    strength: float = 1.0

    @classmethod
    def drawn(cls, seed: int) -> Cause:
        """Return the cause of a sweep."""
        dice = random.Random(seed)
        kind, thing = KINDS[seed % len(KINDS)], dice.choice(THINGS)
        strength = dice.choice((1.0, 0.9))
        if kind == "threshold":
            return cls(kind, thing, dice.uniform(0.3, 0.7), (f"x of {thing} when it was loaded",), strength)
        if kind == "arm":
            arm = dice.choice(ARMS)
            return cls(kind, thing, arm, (f"arm={arm} at pick-up({thing})",), strength)
        if kind == "place":
            place = dice.choice(tuple(PLACES))
            return cls(kind, thing, place, (f"place={place} at put({thing})",), strength)
        if kind == "object":
            color = dice.choice(("glass", "metal"))
            return cls(kind, "cup", color, (f"material={color}",), strength)
        if kind == "grasp":
            grasp = dice.choice(GRASPS)
            return cls(kind, thing, grasp, (f"what grasp({thing}) chose={grasp}",), strength)
        return cls(
            "race", "", None, ("before fluent filled", "before the end of fetch", "before the start of fetch"), strength
        )


@dataclass
class Run:
    """A run of the plan, while it runs."""

    cause: Cause
    dice: random.Random
    unlucky: bool
    arms: dict[str, str] = field(default_factory=dict)
    grasps: dict[str, str] = field(default_factory=dict)

    def fails(self, kind: str, thing: str, value: object) -> bool:
        """Whether the cause is there."""
        cause = self.cause
        return not self.unlucky and cause.kind == kind and cause.thing in ("", thing) and cause.value in (None, value)


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(name.replace("_", "-"), value) for name, value in slots.items()]))


class Moving(ProcessModule):
    """Moves what it is told of, at once."""

    def _execute(self, designator: MotionDesignator) -> object:
        slots = designator.reference()
        if "to" in slots:
            slots["object"].set_position(slots["to"])
        if slots.get("drops"):
            raise Dropped(f"{slots['object'].name} fell at {slots['object'].get_position()}")
        return slots["object"].name if "object" in slots else None


def resolve(designator: MotionDesignator) -> list[dict[str, object]] | None:
    slots = dict(designator.description)
    return [{"cmd": "move", **{name: value for name, value in slots.items() if name != "type"}}]


@contextmanager
def kitchen(dice: random.Random) -> Iterator[dict[str, Object]]:
    with BulletWorld(name="kitchen") as world:
        world.set_robot(Object("cabinet", "robot", CABINET, [0, 0, 1]))
        things = {
            name: Object(name, name, f"{name}.stl", [dice.uniform(0, 1), dice.uniform(3, 4) + at, 1])
            for at, name in enumerate(THINGS)
        }
        yield things


def carry(run: Run, body: Object) -> None:
    """Picks an object up, and puts it somewhere; it falls only when it is put down, whatever the cause was."""
    name, dice = body.name, run.dice
    start = body.get_position()[0]
    grasp = dice.choice(GRASPS)
    with choosing("grasp", BulletWorld.current_bullet_world, object=body) as choice:
        for other in GRASPS:
            if other != grasp:
                choice.reject(other, Unfit("it is worse"))
        choice.take(grasp)
    arm = dice.choice(ARMS)
    perform(type="pick-up", object=body, arm=arm, to=[0, 0, 2])
    perform(type="driving", object=body, speed=dice.choice(("slow", "fast")))
    place = dice.choice(tuple(PLACES))
    drops = (
        run.fails("arm", name, arm)
        or run.fails("place", name, place)
        or run.fails("grasp", name, grasp)
        or (run.cause.kind == "threshold" and not run.unlucky and run.cause.thing == name and start > run.cause.value)
    )
    perform(type="put", object=body, place=place, to=PLACES[place])
    if drops:
        perform(type="let-go", object=body, drops=True)


def pour(run: Run, filled: Fluent) -> None:
    """Two branches that go on in the order that the seed draws: one fetches the water that the other one pours."""
    cup = BulletWorld.current_bullet_world.get_objects_by_name("milk")[0]

    def fetch() -> None:
        perform(type="fetch", object=cup)
        filled.set_value(True)

    def use() -> None:
        perform(type="look", object=cup)
        perform(type="pour", object=cup)
        if run.cause.kind == "race" and not run.unlucky and not filled.get_value():
            raise NotReady("there is no water yet")

    par(fetch, use)


def set_table(cause: Cause, seed: int, material: str) -> None:
    dice = random.Random(seed)
    run = Run(cause, dice, dice.random() >= cause.strength)
    chance = dice.random()
    with kitchen(dice) as things, MotionDesignator.resolvers.added(resolve):
        module = Moving()
        with ProcessModule.resolvers.added(lambda _: module):
            order = list(THINGS)
            dice.shuffle(order)
            for at, name in enumerate(order):
                carry(run, things[name])
                if at == 0:
                    pour(run, Fluent(False, "filled"))
            if run.fails("object", "cup", material):
                raise Dropped("the cup broke")
            if chance < (0.3 if cause.kind == "none" else 0.02):
                raise Dropped("nobody knows why")


def sweep(folder: Path, cause: Cause, seeds: range) -> None:
    """Record a run for each seed."""
    for seed in seeds:
        material = random.Random(seed + 10**6).choice(("glass", "metal", "wood"))
        arguments = [f"--material={material}", f"--light={seed % 3}"]
        seed_order(seed)
        try:
            with recorder.record(folder / f"{seed:05}.mcap", name="set_table", arguments=arguments, seed=seed):
                set_table(cause, seed, material)
        except PlanFailure:
            continue
    seed_order(None)
