"""Nothing changes a world's engine but what leaves a mutation record."""

from __future__ import annotations

import random
from collections import Counter, defaultdict
from contextlib import suppress
from functools import wraps
from typing import TYPE_CHECKING, Any

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import PycramError
from pycram.language import par, seq, try_all
from pycram.physics import engine
from pycram.process_module import ProcessModule
from pycram.world.world import open_worlds
from recorder.records import Mutation
from recorder.tracing import journal
from tests.conftest import MemorySink, furnish

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.world.saved_state import SavedState
    from recorder.records import Record

#: PyBullet's functions that change no world, beside those that get something; whatever else there is counts as a change.
HARMLESS = {"connect", "disconnect", "isConnected", "setPhysicsEngineParameter", "vhacd"}
LEFT, DRAWER = "l_gripper_tool_frame", "sink_area_left_upper_drawer_main_joint"


class Observer(MemorySink):
    """Stands for PyBullet and for a recording: what PyBullet is to change must be followed by its mutation."""

    def __init__(self) -> None:
        super().__init__()
        self.bullet = engine.bullet
        self.changes: Counter[str] = Counter()
        self.since: defaultdict[int, list[str]] = defaultdict(list)  # changes of a client that have no record yet
        self.escaped: list[tuple[str, list[str]]] = []  # by the record that came in place of a mutation

    def __getattr__(self, name: str) -> Any:
        function = getattr(self.bullet, name)
        if not callable(function) or name.startswith("get") or name in HARMLESS:
            return function

        @wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            self.changes[name] += 1
            self.since[kwargs["physicsClientId"]].append(name)
            return function(*args, **kwargs)

        return call

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        super().write(topic, record, payload)
        for world in open_worlds():
            if world.name == record.world:
                changes = self.since.pop(world.engine._client, [])
                if changes and not isinstance(record, Mutation):
                    self.escaped.append((topic, changes))

    def unrecorded(self) -> list[str]:
        """Changes that no record followed; those of clones, in which queries try things, are none of a world."""
        return [name for world in open_worlds() for name in self.since[world.engine._client]]


@pytest.fixture
def observer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Observer]:
    watching = Observer()
    monkeypatch.setattr(engine, "bullet", watching)
    log = journal.Journal([watching])
    journal.open_journal(log)
    yield watching
    journal.close_journal(log)


class Plan:
    """A random plan that changes, asks, fails, and asks for what is impossible."""

    def __init__(self, seed: int, world: BulletWorld) -> None:
        self.dice, self.world = random.Random(seed), world
        self.number = 0
        self.saved: list[SavedState] = []

    def body(self) -> Object:
        return self.dice.choice(self.world.objects)

    def thing(self) -> Object:
        free = [body for body in self.world.objects if not body.fixed]
        return self.dice.choice(free) if free else self.load()

    def load(self) -> Object:
        self.number += 1
        name = self.dice.choice(("cup", "milk", "plate"))
        return Object(f"{name} {self.number}", name, f"{name}.stl", [self.dice.uniform(1, 2), 1, 1.2])

    def pose(self) -> list[float]:
        return [self.dice.choice((float("nan"), 0.5, 1.0, 1.3)) for _ in range(3)]

    def handle(self, *_: object) -> None:
        if self.dice.random() < 0.3:
            self.act()

    def act(self) -> object:
        dice, world = self.dice, self.world
        return dice.choice(
            (
                self.load,
                lambda: self.body().set_position(self.pose()),
                lambda: self.body().set_position(self.pose()),
                lambda: self.thing().attach(self.thing()),
                lambda: self.body().detach(self.thing()),
                lambda: self.thing().remove() if dice.random() < 0.3 else None,
                lambda: self.body().set_color([dice.random() * 1.2, 0, 0, 1]),
                lambda: self.body().set_joint_position(dice.choice((DRAWER, "head_pan_joint")), dice.uniform(-1, 1)),
                lambda: setattr(self.body(), "color", [1, 0, 0, 1]),
                lambda: world.set_gravity([0, 0, dice.choice((-9.8, -1, float("inf")))]),
                lambda: world.simulate(dice.choice((-1, 0, 0.02, 0.1))),
                lambda: world.settle(0.1),
                lambda: world.reset() if dice.random() < 0.2 else None,
                lambda: self.saved.append(world.save()),
                lambda: world.restore(self.saved.pop()) if self.saved else None,
                lambda: btr.stable(self.thing()),
                lambda: btr.visible(self.thing(), "wide_stereo_optical_frame"),
                lambda: btr.reachable(self.thing(), world.robot, LEFT),
                lambda: btr.blocking(self.thing(), world.robot, LEFT),
                lambda: btr.contact(self.body(), self.thing()),
            )
        )()

    def motion(self) -> object:
        slots = self.dice.choice(
            (
                {"type": "looking", "target": self.pose()},
                {"type": "moving", "target": [self.dice.uniform(-1, 1), self.dice.uniform(-1, 1), 0]},
                {"type": "detecting", "object": self.dice.choice(("milk", "cup", "nothing"))},
                {"type": "pick-up", "object": self.thing(), "arm": self.dice.choice(("left", "right"))},
                {"type": "opening-gripper", "gripper": "left"},
                {"type": "move-arm-joints", "left-arm": "park"},
            )
        )
        return ProcessModule.perform(MotionDesignator(slots))

    def step(self) -> None:
        part = self.dice.choice((self.act, self.act, self.motion))
        block = self.dice.choice((None, par, seq, try_all))
        with suppress(PycramError, ExceptionGroup):
            if block is None:
                part()
            else:
                block(part, self.act)


def run(seed: int, world: BulletWorld, steps: int) -> None:
    plan = Plan(seed, world)
    events: list[Callable[[], Any]] = [world.get_attachment_event, world.get_manipulation_event]
    for get in events:
        event = get()
        event += plan.handle
    for _ in range(steps):
        plan.step()


@pytest.mark.slow
def test_no_engine_changes_outside_of_mutations(observer: Observer) -> None:
    for seed in range(2):
        with BulletWorld() as world:
            Object("floor", "environment", "plane.urdf")
            run(seed, world, 40)
            assert not observer.unrecorded()
    assert not observer.escaped
    assert len(observer.changes) > 8, observer.changes


@pytest.mark.slow
def test_no_engine_changes_outside_of_mutations_while_a_robot_acts(observer: Observer) -> None:
    with BulletWorld() as world:
        furnish(world)
        run(1, world, 40)
        assert not observer.unrecorded()
    assert not observer.escaped
    assert len(observer.changes) > 10, observer.changes


def test_a_change_around_the_transaction_is_noticed(observer: Observer) -> None:
    with BulletWorld() as world:
        cup = Object("cup", "cup", "cup.stl")
        world.engine.set_pose(cup.handle, ((0, 0, 1), (0, 0, 0, 1)))
        assert observer.unrecorded() == ["resetBasePositionAndOrientation"] * len(observer.unrecorded())
        assert observer.unrecorded()
        btr.contact(cup, cup)
        assert observer.escaped
