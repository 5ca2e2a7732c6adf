"""A second plan with one seeded cause of failures a sweep, in other guises than :mod:`tests.replay.runs.seeded`'s.

Things are brought from shelves. Here, too, runs are real ones, and what they draw has nothing to do with their failures
but for the one cause. Each kind of cause has three guises: a threshold is one of a parameter, of a fluent, or a band; an
arm is chosen by a query, by a parameter, or is none; and so on. Some sweeps fail at once where the cause is met, others
at the end, whatever it was. Motions slip, and are tried again, in all of them.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import recorder
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.event import Event
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import failure_handling, par
from pycram.process_module import ProcessModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.rejections import Unfit
from pycram.scheduling.schedule import seed_order
from tests.replay.runs.seeded import ARMS, CABINET, KINDS, Cause, Moving, perform, resolve

if TYPE_CHECKING:
    from pathlib import Path

GUISES = 3  # of each kind of cause
ALL = ("box", "jar", "vase", "lamp", "book")
CARRIED = 4  # of them, in a run
MESHES = dict(zip(ALL, ("milk", "cup", "bowl", "spoon", "milk"), strict=True))
SHELVES = {"low": [2.0, 0.0, 0.5], "middle": [2.2, 0.5, 1.0], "high": [2.5, 1.0, 1.5]}
GRIPS = ("rim", "side", "handle")


class Slipped(PlanFailure):
    """A gripper closed on nothing."""


class Broken(PlanFailure):
    """The errand came to a bad end."""


def drawn(seed: int) -> Cause:
    """Return the cause of a sweep; its kind is of :data:`KINDS` with a guise, as "arm 1"."""
    dice = random.Random(f"errands {seed}")
    kind, guise = KINDS[seed % len(KINDS)], seed // len(KINDS) % GUISES
    thing, strength = dice.choice(ALL), dice.choice((1.0, 0.9, 0.8))
    arm, shelf, grip = dice.choice(ARMS), dice.choice(tuple(SHELVES)), dice.choice(GRIPS)
    part = dice.uniform(0.1, 0.5)
    guises: dict[str, tuple[tuple[Any, tuple[str, ...]], ...]] = {
        "threshold": (
            (dice.uniform(0.4, 0.7), ("load",)),
            (dice.uniform(0.3, 0.6), ("fluent battery",)),
            ((part, part + 0.4), (f"y of {thing} when it was loaded",)),
        ),
        "arm": (
            (arm, (f"what arm({thing}) chose={arm}", f"arm={arm} at lift({thing})")),
            (arm, (f"arm={arm}",)),
            (True, (f"both-hands=true at lift({thing})",)),
        ),
        "place": (
            (shelf, (f"of to at stow({thing})", f"what shelf({thing}) chose={shelf}")),
            (shelf, (f"what shelf({thing}) chose={shelf}",)),
            (shelf, (f"goal={shelf} at drive",)),
        ),
        "object": ((thing, (f"({thing})",)), ("red", ("color=red",)), ("lid", ("lid",))),
        "race": (
            (None, ("before fluent opened", "before the end of open", "before the start of open")),
            (None, ("before event rang", "before the end of ring", "before the start of ring")),
            (None, ("before move body door", "before the end of push", "before the start of push")),
        ),
        "grasp": (
            (grip, (f"grip={grip} at lift({thing})",)),
            (dice.uniform(0.5, 1.0), (f"angle at lift({thing})", "< angle < ")),
            (grip, (f"grip={grip} at turn({thing})", f"grip={grip} at the last turn({thing})")),
        ),
    }
    value, expected = guises[kind][guise]
    return Cause(f"{kind} {guise}", thing, value, expected, strength)


@dataclass
class Errand:
    """A run of the plan, while it runs."""

    cause: Cause
    dice: random.Random
    given: dict[str, Any]
    lucky: bool
    at_once: bool
    doomed: bool = False

    def meets(self, guise: str, thing: str, value: Any) -> None:
        """Fail, at once or later, if what the run has of a guise is the cause.

        Raises:
            Broken: It is, and the run fails at once.
        """
        cause = self.cause
        if self.lucky or cause.kind != guise or thing not in ("", cause.thing):
            return
        wanted = cause.value
        if isinstance(wanted, tuple):
            met = wanted[0] < value < wanted[1]
        else:
            met = value > wanted if isinstance(wanted, float) else wanted in (None, value)
        self.doomed = self.doomed or met
        if met and self.at_once:
            raise Broken(f"it didn't work out at {value}")


def chosen(query: str, body: Object, among: tuple[str, ...], dice: random.Random) -> str:
    """Choose by the dice, on record."""
    best = dice.choice(among)
    with choosing(query, BulletWorld.current_bullet_world, object=body) as choice:
        for other in among:
            if other != best:
                choice.reject(other, Unfit("it is worse"))
        choice.take(best)
    return best


def bring(errand: Errand, body: Object) -> None:
    """Bring a thing."""
    name, dice = body.name, errand.dice
    y = body.get_position()[1]
    shelf = dice.choice(tuple(SHELVES))
    perform(type="drive", goal=shelf, speed=dice.uniform(0.2, 1))
    errand.meets("place 2", "", shelf)
    arm = chosen("arm", body, ARMS, dice)
    grip, angle, both = dice.choice(GRIPS), dice.uniform(0, 1.5), dice.random() < 0.4
    for attempt in failure_handling(3):
        with attempt:
            perform(type="look", object=body, zoom=dice.choice((1, 2)))
            if dice.random() < 0.15:
                raise Slipped(f"{name} isn't where it was at {dice.random()}")
    perform(type="lift", object=body, arm=arm, grip=grip, angle=angle, both_hands=both, to=[0, 0, 2])
    turned = dice.choice(GRIPS)
    perform(type="turn", object=body, grip=dice.choice(GRIPS))
    perform(type="turn", object=body, grip=turned)  # what counts is how it was held at last
    where = chosen("shelf", body, tuple(SHELVES), dice)
    perform(type="stow", object=body, to=SHELVES[where])
    errand.meets("threshold 2", name, y - int(y))
    errand.meets("arm 0", name, arm)
    errand.meets("arm 2", name, both)
    errand.meets("place 0", name, where)
    errand.meets("place 1", name, where)
    errand.meets("object 0", name, name)
    errand.meets("grasp 0", name, grip)
    errand.meets("grasp 1", name, angle)
    errand.meets("grasp 2", name, turned)


def together(errand: Errand, door: Object) -> None:
    """Three branches go on in the order that the seed draws; one may come too early for the others."""
    opened, rang = Fluent(False, "opened"), Event("rang")
    done: set[str] = set()

    def opens() -> None:
        perform(type="unlock", object=door)
        perform(type="open", object=door)
        opened.set_value(True)
        done.add("opened")

    def rings() -> None:
        perform(type="greet")
        perform(type="ring")
        rang()
        done.add("rang")
        perform(type="push", object=door, to=[3, 3, 3])
        done.add("pushed")

    def passes() -> None:
        perform(type="wait", color=errand.given["color"])
        perform(type="pass", object=door)
        for guise, what in (("race 0", "opened"), ("race 1", "rang"), ("race 2", "pushed")):
            if what not in done:
                errand.meets(guise, "", None)

    par(opens, rings, passes)


def run_errands(cause: Cause, seed: int, given: dict[str, Any], *, at_once: bool) -> None:
    dice = random.Random(f"errand {seed}")
    errand = Errand(cause, dice, given, dice.random() >= cause.strength, at_once)
    bad_luck = dice.random() < (0.3 if cause.kind == "none" else 0.03)
    with BulletWorld(name="house") as world, MotionDesignator.resolvers.added(resolve):
        module = Moving()
        with ProcessModule.resolvers.added(lambda _: module):
            world.set_robot(Object("cabinet", "robot", CABINET, [0, 0, 1]))
            things = [
                Object(name, name, f"{MESHES[name]}.stl", [dice.uniform(0, 1), 4 + at + dice.uniform(0, 1), 1])
                for at, name in enumerate(dice.sample(ALL, CARRIED))
            ]
            if has_lid := dice.random() < 0.4:
                Object("lid", "lid", "bowl.stl", [5, 5, 1])
            battery, level = Fluent(1.0, "battery"), dice.uniform(0.1, 0.9)
            door = Object("door", "door", "cup.stl", [4, 4, 4])
            ends = dice.randrange(2 * CARRIED)
            for at, body in enumerate(things):
                if at == 1:
                    battery.set_value(level)
                    errand.meets("threshold 1", "", level)
                    together(errand, door)
                    errand.meets("threshold 0", "", given["load"])
                    errand.meets("arm 1", "", given["arm"])
                    errand.meets("object 1", "", given["color"])
                    errand.meets("object 2", "", "lid" if has_lid else "")
                if bad_luck and ends == at:
                    raise Broken("nobody knows why")
                bring(errand, body)
            perform(type="drive-home", color=given["color"])
            if errand.doomed or bad_luck:
                raise Broken(f"it didn't work out at {dice.random()}")


def sweep(folder: Path, cause: Cause, seeds: range) -> None:
    """Record a run for each seed."""
    at_once = random.Random(f"at once {seeds[0]}").random() < 0.5
    for seed in seeds:
        dice = random.Random(f"given {seed}")
        given = {
            "load": dice.uniform(0, 1),
            "arm": dice.choice(ARMS),
            "color": dice.choice(("red", "green", "blue")),
            "light": seed % 3,
        }
        seed_order(seed)
        try:
            with recorder.record(folder / f"{seed}.mcap", name="errands", parameters=given, seed=seed):
                run_errands(cause, seed, given, at_once=at_once)
        except PlanFailure:
            continue
    seed_order(None)
