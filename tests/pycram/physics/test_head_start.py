"""A head start gives the answers that the engine would have given, to the last bit, and saves its steps."""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, Any

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.physics import engine, head_start
from pycram.physics.head_start import HeadStart

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.physics.engine import Engine

STEPS = 60
Answers = list[Any]


class Steps:
    """Counts the steps that PyBullet itself makes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done = 0
        step = engine.bullet.stepSimulation

        @wraps(step)
        def counted(**keywords: int) -> object:
            self.done += 1
            return step(**keywords)

        monkeypatch.setattr(engine.bullet, "stepSimulation", counted)

    def of(self, run: Iterator[object]) -> tuple[Answers, int]:
        before = self.done
        return list(run), self.done - before


def plan(x: float, height: float = 0.3, *, sideways: float = 0.0, second_world: bool = False) -> Iterator[object]:
    """Two things fall on each other, then one of them is put somewhere else; yields what is where."""
    with BulletWorld() as world:
        world.set_gravity([sideways, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        milk = Object("milk", "milk", "milk.stl", [0, 0, height])
        bowl = Object("bowl", "bowl", "bowl.stl", [0.03, 0.02, 0.6])
        world.simulate_steps(STEPS)
        yield state(world.engine, milk, bowl)
        milk.set_position([x, 0, 0.4])
        world.simulate_steps(STEPS)
        yield state(world.engine, milk, bowl)
        if second_world:
            yield from plan(x)


def state(of: Engine, *bodies: Object) -> object:
    return [(of.center_pose(body.handle), of.velocity(body.handle)) for body in bodies]


def noted(run: Iterator[object]) -> str:
    with head_start.noted() as notes:
        list(run)
    return notes.text()


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    return Steps(monkeypatch)


@pytest.fixture
def start() -> HeadStart:
    return HeadStart(noted(plan(0.1)), noted(plan(0.2)))


def test_it_goes_on_where_runs_differ(steps: Steps, start: HeadStart) -> None:
    alone, _ = steps.of(plan(0.3))
    with start.taken():
        assert steps.of(plan(0.3)) == (alone, STEPS)


def test_what_differs_before_begins_anew(steps: Steps, start: HeadStart) -> None:
    alone, all_steps = steps.of(plan(0.3, height=0.35))
    with start.taken():
        assert steps.of(plan(0.3, height=0.35)) == (alone, all_steps)


def test_what_differs_in_the_middle_gets_what_came_before_again(steps: Steps, start: HeadStart) -> None:
    def shorter() -> Iterator[object]:
        with BulletWorld() as world:
            world.set_gravity([0, 0, -9.8])
            Object("floor", "environment", "plane.urdf")
            milk = Object("milk", "milk", "milk.stl", [0, 0, 0.3])
            bowl = Object("bowl", "bowl", "bowl.stl", [0.03, 0.02, 0.6])
            world.simulate_steps(STEPS // 2)
            milk.set_position([0, 0, 0.4])
            bowl.remove()
            world.simulate_steps(STEPS)
            yield state(world.engine, milk)

    alone, all_steps = steps.of(shorter())
    with start.taken():
        assert steps.of(shorter()) == (alone, all_steps)


def test_worlds_that_no_run_had_begin_without_it(steps: Steps, start: HeadStart) -> None:
    alone, all_steps = steps.of(plan(0.3, second_world=True))
    with start.taken():
        assert steps.of(plan(0.3, second_world=True)) == (alone, all_steps - STEPS)


def test_a_bit_is_a_difference(steps: Steps, start: HeadStart) -> None:
    with start.taken():
        _, made = steps.of(plan(0.3, sideways=-0.0))
    assert made == 2 * STEPS


def test_its_end_ends_its_clients(start: HeadStart) -> None:
    def next_client() -> int:
        client: int = engine.bullet.connect(engine.bullet.DIRECT)
        engine.bullet.disconnect(physicsClientId=client)
        return client

    before = next_client()
    start.close()
    assert next_client() < before


def test_what_does_not_repeat_is_not_used(steps: Steps, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = noted(plan(0.1)), noted(plan(0.2))
    with monkeypatch.context() as other_machine:
        load = engine.bullet.loadURDF
        other_machine.setattr(engine.bullet, "loadURDF", wraps(load)(lambda *a, **k: load(*a, **k) + 1))
        start = HeadStart(*runs)
    alone, all_steps = steps.of(plan(0.3))
    with start.taken():
        assert steps.of(plan(0.3)) == (alone, all_steps)
