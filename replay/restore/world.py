"""Live worlds as they were after any step, from the recording alone.

There are two methods. From the *state*: bodies are loaded from the recorded models and put where they were. Poses,
joints, velocities, attachments, gravity, colours and the robot are exact at once; the solver's contacts and the targets
of sagging motors are not known, so the future is a likely one. By *re-execution* (``exact``): every change is made
again from the start, so the future is the original's too, bit for bit.

A world is unrecorded while it is rebuilt. One for a user is announced afterwards to recordings that run, with its whole
state; one for a question never appears in any.
"""

from __future__ import annotations

import itertools
import math
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pycram.foundation.failures import DisplayError, PycramError
from pycram.physics.body import Snapshot
from pycram.world import attachment, driving
from pycram.world.current import open_worlds
from pycram.world.read_only import update
from pycram.world.snapshot import restore_snapshot
from pycram.world.world import BulletWorld, Object
from recorder import records
from recorder.tracing import journal
from replay.errors import Damaged
from replay.restore.recorded_world import description_of, model_of, world_state
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import LoadBody
    from replay.file.record_reader import RecordReader
    from replay.state.state import Belief, Body, Sampled, World

__all__ = ["load_body", "open_world", "reading", "rebuild", "unrecorded", "world_at"]


def world_at(
    log: RecordReader,
    step: int,
    world: str | None = None,
    *,
    exact: bool = False,
    mode: str = "DIRECT",
    moment: float | None = None,
) -> BulletWorld:
    """Return a world as it was after a step, called ``NAME@STEP``; it becomes the current one, and time stands still.

    By default it is the one that was opened last. With ``exact`` every change is executed again, so that its future is
    the original's too. A moment, in s of simulated time, that lies within the next record is known by its samples, or
    with ``exact`` simulated up to its last step of 1/240 s.

    Raises:
        NotRestored: none was open then, or it can't be had exactly.
        Damaged: records or files are lost, or make no sense.
        DisplayError: no window can open.
    """
    state = world_state(log, step, world, moment)
    within = state_at(log, step, moment).sampled
    with journal.unrecorded(), _reporting_damage(log, step):
        if exact:
            from replay.restore.reexecute import executed_again  # noqa: PLC0415  it opens and loads worlds by this module

            restored = executed_again(log, step, state.name, mode)
            restored.beliefs.rebuild(map(_recorded, state.beliefs.values()))
            if within is not None and within.world == state.name:
                restored.simulate_steps(math.floor(within.asked * records.STEPS_PER_SECOND) - restored.sim_step)
        else:
            restored = rebuild(log, state, _suffix(step, within), mode)
    try:
        journal.announce(restored)
        BulletWorld.current_bullet_world = restored
    except BaseException:
        restored.exit()
        raise
    return restored


def _suffix(step: int, within: Sampled | None) -> str:
    return str(step) if within is None else f"{within.asked:g}s"


@contextmanager
def unrecorded(
    log: RecordReader, step: int, world: str | None = None, moment: float | None = None
) -> Iterator[BulletWorld]:
    """Yield a world as it was, for a question: never the current one, in no recording, closed after the block.

    The arguments and errors are those of :func:`world_at`.
    """
    state = world_state(log, step, world, moment)
    with journal.unrecorded():
        with _reporting_damage(log, step):
            restored = rebuild(log, state, _suffix(step, state_at(log, step, moment).sampled))
        with restored:
            yield restored


@contextmanager
def _reporting_damage(log: RecordReader, step: int) -> Iterator[None]:
    """Raise what the executor refuses as damage of the recording; only a window that can't open is no fault of it."""
    try:
        yield
    except DisplayError:
        raise
    except (PycramError, ValueError) as error:
        raise Damaged(log.path, f"the world after step {step}", str(error)) from error


def rebuild(log: RecordReader, state: World, suffix: str, mode: str = "DIRECT") -> BulletWorld:
    """Return a new world ``NAME@SUFFIX`` with a recorded state; to be called unrecorded."""
    world = open_world(f"{state.name}@{suffix}", mode)
    try:
        update(world, sim_step=state.sim_step)
        world.set_gravity(state.gravity)
        for body in state.bodies.values():
            restore_snapshot(load_body(log, body.loaded, world, body.color), reading(body))
        for held in state.attachments.values():
            carrier, carried = world.get_object(held.carrier), world.get_object(held.body)
            pose = held.position, held.orientation
            attachment.attach(carrier, carried, held.carrier_link or None, held.body_link or None, pose)
        for following in state.following.values():
            driving.resume(world.get_object(following.begin.body), following)
        if state.robot:
            world.set_robot(world.get_object(state.robot))
        world.beliefs.rebuild(map(_recorded, state.beliefs.values()))
    except BaseException:
        world.exit()
        raise
    return world


def open_world(name: str, mode: str = "DIRECT") -> BulletWorld:
    """Return an empty world that isn't the current one; its name gets a number if it is taken."""
    current = BulletWorld.current_bullet_world
    taken = {world.name for world in open_worlds()}
    numbered = (f"{name} ({number})" for number in itertools.count(2))
    world = BulletWorld(mode, name=next(title for title in itertools.chain([name], numbered) if title not in taken))
    if current is not None and not current.closed:
        BulletWorld.current_bullet_world = current
    return world


def load_body(
    log: RecordReader, loaded: LoadBody, world: BulletWorld, color: tuple[float, ...] | None = None
) -> Object:
    """Load a body from its recorded model.

    Its color is RGBA 0..1, empty for that of its model; by default the one that it was loaded with.

    Raises:
        Damaged: a file isn't in the recording, or isn't what was attached.
    """
    return Object(
        loaded.body,
        loaded.type,
        loaded.path,
        loaded.position,
        loaded.orientation,
        world,
        list(loaded.color if color is None else color) or None,
        description=description_of(loaded.robot_description),
        model=model_of(log, loaded),
    )


def _recorded(belief: Belief) -> records.Belief:
    """Return a belief as records have it: of what is held, its pose is the hand's."""
    held = belief.source == "held"
    return records.Belief(
        robot=belief.robot,
        object=belief.object,
        source=belief.source.upper(),
        position=() if held else belief.position,
        orientation=() if held else belief.orientation,
        sim_step=belief.sim_step,
        step=belief.step,
    )


def reading(body: Body) -> Snapshot:
    """Return a body's state as the engine takes it."""
    return Snapshot(body.pose, body.velocity, tuple(body.joints.values()), tuple(body.joint_velocities.values()))
