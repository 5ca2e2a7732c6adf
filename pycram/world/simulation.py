"""Simulation of a world: steps of 1/240 s, with samples for the recording 30 times a simulated second."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.world import carried
from pycram.world.read_only import update
from pycram.world.snapshot import state_delta, take_snapshot
from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.physics.body import Snapshot
    from pycram.world.transaction import Transaction
    from pycram.world.world import BulletWorld

_SAMPLE_STEPS: Final = records.STEPS_PER_SECOND // 30
_SAMPLE_TOLERANCE: Final = 1e-5  # m, rad: smaller movements between two samples aren't visible
_MANIPULATION_TOLERANCE: Final = 1e-4  # rad or m by which a joint of the environment has to move to fire the event


def simulate(world: BulletWorld, steps: int, transaction: Transaction, until: Callable[[], bool] | None = None) -> bool:
    """Step a world's engine as part of a transaction.

    Ctrl-C or the world's exit end it early, between two samples; the record then has the steps that were done.

    Args:
        world: The world.
        steps: How many.
        transaction: The transaction.
        until: Called after each 1/30 s of simulated time, and at the end; ends it when true.

    Returns:
        Whether all steps were done, or those that were needed.
    """
    engine = world.engine
    joints = {body: engine.joints(body.handle)[0] for body in world.objects if body.is_environment}
    driven = list(world.trajectories.active.values())
    for followed in driven:
        followed.begin_stretch()
    done, ended = _step(world, steps, transaction, until)
    transaction.command.simulate.steps = done
    transaction.command.simulate.driven.extend(followed.driven() for followed in driven)
    transaction.mark_modified(*world.objects)
    transaction.callbacks.append(world.prepare_time_listeners)
    for body, before in joints.items():
        after = engine.joints(body.handle)[0]
        if any(not math.isclose(a, b, abs_tol=_MANIPULATION_TOLERANCE) for a, b in zip(before, after, strict=True)):
            transaction.fire(world.get_manipulation_event(), body)
    return ended or done == steps


def _step(
    world: BulletWorld, steps: int, transaction: Transaction, until: Callable[[], bool] | None
) -> tuple[int, bool]:
    """Return how many steps were done, and whether no more were needed."""
    recording = journal.recording()
    last = {body.name: take_snapshot(body) for body in world.objects} if recording else {}
    observer = world.transactions.observer
    done, ended = 0, False
    while done < steps and not (transaction.interrupts.noted or world.exiting):
        chunk = min(_SAMPLE_STEPS - world.sim_step % _SAMPLE_STEPS, steps - done)
        if world.trajectories.active:
            world.trajectories.step(chunk, transaction)
        else:
            world.engine.step(chunk)
        _note_drags(world, transaction)
        for body in world.objects:
            if body.fixed:  # solvers let what is attached to it in chains give way a little
                carried.move_attached(body, transaction)
        update(world, sim_step=world.sim_step + chunk)
        done += chunk
        if world.sim_step % _SAMPLE_STEPS == 0:
            world.waits.sample()
        ended = until is not None and until()
        if ended or done == steps:  # the effect itself has the last state
            break
        if observer is not None:
            observer.time_passed()
        if recording:
            sample = _sample(world, last)
            if sample.bodies:
                transaction.samples.append(sample)
    return done, ended


def _note_drags(world: BulletWorld, transaction: Transaction) -> None:
    """Record what somebody drags in the window meanwhile: no command did it."""
    drags = transaction.command.drags
    bodies = {body.handle: body.name for body in world.objects}
    for handle, link in world.engine.dragged(bodies):
        if not any((drag.body, drag.link) == (bodies[handle], link) for drag in drags):
            drags.append(records.Drag(body=bodies[handle], link=link, sim_step=world.sim_step))


def _sample(world: BulletWorld, last: dict[str, Snapshot]) -> records.Sample:
    """Record the objects that moved visibly since the last sample, and update their last snapshots."""
    sample = records.Sample(sim_step=world.sim_step)
    for body in world.objects:
        now = take_snapshot(body)
        delta = state_delta(body, now, last.get(body.name), _SAMPLE_TOLERANCE)
        if delta is not None:
            last[body.name] = now
            sample.bodies.append(delta)
    return sample
