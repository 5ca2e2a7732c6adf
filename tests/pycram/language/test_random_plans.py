"""Random plans: nested blocks, motions that need the same resources, failures, retries, timeouts, cancellation.

They end, leave no thread, and their log has the whole task tree.
"""

from __future__ import annotations

import faulthandler
import random
import threading
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import tasks
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import LookingFailed, PlanFailure, Unreachable
from pycram.fluent import Fluent
from pycram.language import State, failure_handling, finally_, par, pursue, seq, timeout, try_all, try_in_order
from pycram.language.block import Block
from pycram.language.failures import RunsEarly
from pycram.motions.resources import Resources
from pycram.process_module import ProcessModule
from pycram.scheduling.cancellation import wait
from pycram.scheduling.schedule import Condition
from tests.measures import seeded

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

KINDS = (par, par, pursue, try_all, seq, seq, try_in_order)
PARTS = ("base", "head", "left-arm", "right-arm", "left-gripper", "right-gripper")
BODIES = ("cup", "bowl", "plate")
UNREACHABLE = Unreachable("left", [1, 2, 3])


class Juggling(MotionDesignator):
    """A motion that says what it needs, or less than that, or nothing."""

    def resources(self) -> Resources | None:
        says = dict(self.description)["says"]
        return says if isinstance(says, Resources) else super().resources()


@dataclass(frozen=True)
class Running:
    """A running motion, and those that it is part of."""

    needs: Resources
    juggler: ProcessModule
    around: tuple[Running, ...]


class Monitor:
    """The running motions; asserts that none runs beside one that needs what it moves, or in the same module."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.running: list[Running] = []
        self.around: ContextVar[tuple[Running, ...]] = ContextVar("around", default=())

    @contextmanager
    def running_with(self, needs: Resources, juggler: ProcessModule) -> Iterator[None]:
        motion = Running(needs, juggler, self.around.get())
        with self.lock:
            for running in self.running:
                if running not in motion.around:
                    assert not needs.conflicts(running.needs)
                    assert juggler is not running.juggler or motion.around != running.around
            self.running.append(motion)
        token = self.around.set((*motion.around, motion))
        try:
            yield
        finally:
            self.around.reset(token)
            with self.lock:
                self.running.remove(motion)


class Juggler(ProcessModule):
    """Moves an object, and may be made of other motions."""

    def __init__(self, monitor: Monitor) -> None:
        super().__init__()
        self.monitor = monitor

    def resources(self, designator: Juggling) -> Resources:
        return designator.reference()["needs"]

    def _execute(self, designator: Juggling) -> object:
        solution = designator.reference()
        with self.monitor.running_with(solution["needs"], self):
            for action in solution["parts"]:
                action()
        return solution["body"]


def resolve(designator: Juggling) -> Iterator[dict[str, object]]:
    """A resolver that may perform motions."""
    slots = dict(designator.description)
    for action in slots["first"]:
        action()
    yield slots


class Plan:
    """A random plan."""

    def __init__(self, seed: int, world: BulletWorld, jugglers: list[Juggler]) -> None:
        self.dice = random.Random(seed)
        self.world = world
        self.jugglers = jugglers
        self.nobody = Condition()
        self.signal = Fluent(0)

    def make(self, depth: int, moves: tuple[str, ...] = PARTS) -> Callable[[], object]:  # noqa: PLR0911  one for each sort
        """Make a part of the plan; all dice are cast here, before anything runs."""
        dice = self.dice
        what = dice.random()
        if depth <= 0 or what < 0.10:
            return self.move()
        if what < 0.17:
            return self.fail(dice.choice((UNREACHABLE, LookingFailed([1, 2, 3], 0.1))))
        if what < 0.19:
            return lambda: wait(self.nobody, lambda: False, 0.002)
        if what < 0.20:
            return lambda: self.signal.set_value(self.signal.get_value() + 1)
        if what < 0.21:
            return lambda: (self.signal > dice.random() * 9).wait_for(0.002)
        if what < 0.48:
            return self.motion(depth, moves)
        if what < 0.54:
            part, retries = self.make(depth - 1, moves), dice.randrange(3)
            return lambda: failure_handling(retries).run(part)
        if what < 0.59:
            part, limit = self.make(depth - 1, moves), dice.choice((0, 0.001, 60))
            return lambda: self.within(timeout(limit), part)
        if what < 0.64:
            part, cleaning = (
                self.make(depth - 1, moves),
                dice.choice((self.move(), self.move(), self.fail(UNREACHABLE))),
            )
            return lambda: self.within(finally_(cleaning), part)
        return self.block(depth, moves)

    def within(self, context: object, part: Callable[[], object]) -> None:
        with context:
            part()

    def fail(self, failure: PlanFailure) -> Callable[[], object]:
        def fail() -> None:
            raise type(failure)(*([failure.arm] if hasattr(failure, "arm") else []), failure.target, 0.1)

        return fail

    def move(self) -> Callable[[], object]:
        body, place = self.dice.choice(BODIES), [self.dice.uniform(-9, 9) for _ in range(3)]
        return lambda: self.world.get_object(body).set_position(place)

    def motion(self, depth: int, allowed: tuple[str, ...]) -> Callable[[], object]:
        """Make a motion; its parts need no more than it has."""
        dice = self.dice
        wanted = tuple(part for part in allowed if dice.random() < 0.4)
        moves = tuple(part for part in wanted if dice.random() < 0.7)
        rest = tuple(part for part in wanted if part not in moves)
        parts = [self.move()]
        if dice.random() < 0.4:
            parts.append(lambda: wait(self.nobody, lambda: False, 0.002))  # others have time to get in its way
        if depth > 1 and dice.random() < 0.4:
            parts.append(self.block(depth - 2, moves))
        if dice.random() < 0.2:
            parts.append(self.fail(UNREACHABLE))
        needs = Resources(frozenset(moves), frozenset(rest))
        less = Resources(frozenset(part for part in moves if dice.random() < 0.5))
        says = dice.choice((needs, needs, less, None)) if allowed == PARTS or moves else needs
        juggler = dice.choice(self.jugglers)
        slots = {"type": "juggle", "needs": needs, "says": says, "parts": parts, "body": dice.choice(BODIES)}
        slots |= {
            "juggler": juggler,
            "first": [self.motion(0, tuple(less.moves))] if dice.random() < 0.1 * depth else [],
        }

        def perform(given: object = None) -> object:
            return ProcessModule.perform(Juggling([*slots.items(), ("given", given)]))

        return perform

    def block(self, depth: int, allowed: tuple[str, ...]) -> Callable[[], object]:
        """Make a block with actions of all sorts in its body."""
        dice = self.dice
        kind = dice.choice(KINDS)
        parts = [self.make(depth - 1, allowed) for _ in range(dice.choice((0, 1, 2, 3, 3, 4)))]
        forms = [dice.randrange(3) for _ in parts]
        collected: list[BaseException] | None = [] if dice.random() < 0.3 else None
        if dice.random() < 0.15:
            return lambda: kind(*parts) if parts else None

        def run() -> object:
            with kind(collected) if collected is not None else kind as s:
                futures, given = [], None
                for part, form in zip(parts, forms, strict=True):
                    if form == 0:
                        futures.append(s(part))
                    elif form == 1:
                        # a motion or a block in the body, or plain Python; a motion may wait for the one before
                        try:
                            given = part(given) if part.__name__ == "perform" else part()
                        except RunsEarly:  # a change that stands behind actions of a body that is read
                            futures.append(s(part))
                    else:
                        with seq as t:
                            t(part)
                if futures and forms[0] == 1:
                    futures[0].result()  # looks at a result in the body
            assert isinstance(s, Block)
            return None

        return run


def run(plans: int, first: int, file: Path) -> None:
    """Run plans in a world, recorded, and compare task tree and log."""
    faulthandler.dump_traceback_later(200, exit=True)  # the watchdog
    outcomes = {"succeeded": 0, "failed": 0}
    with recorder.record(file), BulletWorld() as world:
        for body in BODIES:
            Object(body, body, f"{body}.stl", [0, 0, 5])
        monitor = Monitor()
        jugglers = [Juggler(monitor) for _ in range(3)]
        chooser = ProcessModule.resolvers.added(lambda designator: dict(designator.description).get("juggler"))
        threads = threading.active_count()
        with chooser, Juggling.resolvers.added(resolve):
            for seed in range(first, first + plans):
                plan = Plan(seed, world, jugglers)
                blocks = [plan.block(4, PARTS) for _ in range(2)]
                try:
                    par(*blocks)
                except PlanFailure:
                    outcomes["failed"] += 1
                else:
                    outcomes["succeeded"] += 1
                assert threading.active_count() == threads, seed
                assert tasks.current() is None
        tree = tasks.tree()
        assert all(node.finished is not None for node in tree.nodes.values())
        poses = {body.name: body.get_position_and_orientation() for body in world.objects}
    with replay.open(file) as log:
        recorded = log.tree()
        assert recorded == tree
        assert len(recorded) == len(tree) > plans
        last = [step for step, record in enumerate(log) if type(record).__name__ == "Mutation"][-2]
        state = log.state_at(last).worlds[world.name]
        for name, (position, orientation) in poses.items():
            assert list(state.bodies[name].position) == position
            assert list(state.bodies[name].orientation) == orientation
    assert outcomes["failed"] > plans / 20
    assert outcomes["succeeded"] > plans / 20
    statuses = {node.status for node in tree.nodes.values()}
    assert statuses == {State.SUCCEEDED, State.FAILED, State.CANCELLED}
    for node in tree.nodes.values():
        for child in node.children:
            assert child.parent is node
            assert child.end.wall_ns <= node.end.wall_ns
            assert child.created.wall_ns >= node.created.wall_ns


@pytest.fixture(autouse=True)
def _watched() -> Iterator[None]:
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.mark.slow
def test_random_plans(tmp_path: Path) -> None:
    run(30, 0, tmp_path / "plans.mcap")


@seeded("random plans of the plan language", range(1000, 2000), 50)
def test_a_thousand_random_plans(tmp_path: Path, seeds: range) -> None:
    run(len(seeds), seeds[0], tmp_path / "plans.mcap")
