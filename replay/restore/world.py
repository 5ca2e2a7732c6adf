"""Worlds as they were: a live :class:`~pycram.bullet_world.BulletWorld` after any step, from the recording alone.

There are two ways back. From the *state*: bodies are loaded from the recording's own models and put where they were;
poses, joints, velocities, attachments, gravity, colours and the robot are the recorded ones, at once, but what the
solver knew of contacts and the targets of sagging motors are not, so the future is a likely one. By *re-execution*
(``exact``): every change is made again from the start, so the future is the original's too, bit for bit.

A world that is rebuilt is on no record while it is built. Handed to a user it is introduced to recordings that run,
with its whole state; one that only serves a question or a picture never appears anywhere.
"""

from __future__ import annotations

import itertools
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from pycram.foundation.failures import DisplayError, PycramError
from pycram.models import load
from pycram.models.robots.description import RobotDescription
from pycram.world import attachment
from pycram.world.current import open_worlds
from pycram.world.snapshot import Snapshot, restore_snapshot
from pycram.world.world import BulletWorld, Object
from recorder.tracing import journal
from replay.errors import Damaged, NotRestored
from replay.explain.step_names import step_of
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.models.load import Model
    from recorder.records import LoadBody
    from replay.file.log import Log
    from replay.state.state import Body, World

__all__ = ["load_body", "open_world", "reading", "rebuild", "world_at"]


def world_at(
    log: Log, step: int | str, world: str | None = None, *, exact: bool = False, mode: str = "DIRECT"
) -> BulletWorld:
    """A world as it was after a step; it becomes the current one, and stands still until somebody lets time run.

    Args:
        log: the recording.
        step: a number, or a name as :func:`replay.explain.step_names.step_of` knows them.
        world: its name; without one, the open one that was opened last.
        exact: get there by executing every change again, so that its future is the original's too.
        mode: "DIRECT" or "GUI".

    Returns:
        The world, called ``NAME@STEP``.

    Raises:
        NotRestored: none was open then, or it can't be had exactly.
        Damaged: records or files are lost, or make no sense.
        DisplayError: no window can open.
    """
    told = _told(log, step, world)
    number = step_of(log, step)
    with journal.unrecorded(), _explained(log, number):
        if exact:
            from replay.restore.reexecute import executed_again  # noqa: PLC0415  it opens and loads worlds by this module

            restored = executed_again(log, number, told.name, mode)
        else:
            restored = rebuild(log, told, str(number), mode)
    try:
        journal.announce(restored)
        BulletWorld.current_bullet_world = restored
    except BaseException:
        restored.exit()
        raise
    return restored


@contextmanager
def unrecorded(log: Log, step: int | str, world: str | None = None) -> Iterator[BulletWorld]:
    """A world as it was, for a question or a picture: never the current one, on no record, gone after the block.

    Args:
        log: the recording.
        step: as for :func:`world_at`.
        world: as for :func:`world_at`.

    Yields:
        The world.

    Raises:
        NotRestored: none was open then.
        Damaged: records or files are lost, or make no sense.
    """
    told = _told(log, step, world)
    number = step_of(log, step)
    with journal.unrecorded():
        with _explained(log, number):
            restored = rebuild(log, told, str(number))
        with restored:
            yield restored


@contextmanager
def _explained(log: Log, step: int) -> Iterator[None]:
    """Tells what the executor refuses as damage of the recording; only a window that can't open is no fault of it."""
    try:
        yield
    except DisplayError:
        raise
    except (PycramError, ValueError) as error:
        raise Damaged(log.path, f"the world after step {step}", str(error)) from error


def _told(log: Log, step: int | str, name: str | None) -> World:
    """What the recording tells of the world that is wanted."""
    state = state_at(log, step_of(log, step))
    if name is None and not any(world.open for world in state.worlds.values()):
        closed = ", ".join(state.worlds)
        hint = f" (there was: {closed}); take a step before its end" if closed else " yet; take a later step"
        raise NotRestored(state.step, f"no world is open then{hint}")
    world = state.world(name)
    if not world.open:
        raise NotRestored(state.step, f"{world.name} has ended by then; take a step before its end")
    if state.doubt:
        raise Damaged(log.path, f"the world after step {state.step}", state.doubt)
    return world


def rebuild(log: Log, told: World, mark: str, mode: str = "DIRECT") -> BulletWorld:
    """Builds a world from its state; call it aside.

    Args:
        log: whose attachments hold the models.
        told: the state.
        mark: follows the world's name.
        mode: "DIRECT" or "GUI".
    """
    world = open_world(f"{told.name}@{mark}", mode)
    try:
        world.sim_step = told.sim_step
        world.set_gravity(told.gravity)
        for body in told.bodies.values():
            restore_snapshot(load_body(log, body.loaded, world, body.color), reading(body))
        for held in told.attachments.values():
            carrier, carried = world.get_object(held.carrier), world.get_object(held.body)
            pose = held.position, held.orientation
            attachment.attach(carrier, carried, held.carrier_link or None, held.body_link or None, pose)
        if told.robot:
            world.set_robot(world.get_object(told.robot))
    except BaseException:
        world.exit()
        raise
    return world


def open_world(name: str, mode: str = "DIRECT") -> BulletWorld:
    """Opens an empty world without making it the current one; the name gets a number if it is taken.

    Args:
        name: its name.
        mode: "DIRECT" or "GUI".
    """
    current = BulletWorld.current_bullet_world
    taken = {world.name for world in open_worlds()}
    free = next(title for title in _numbered(name) if title not in taken)
    world = BulletWorld(mode, name=free)
    if current is not None and not current.closed:
        BulletWorld.current_bullet_world = current
    return world


def _numbered(name: str) -> Iterator[str]:
    yield name
    for number in itertools.count(2):
        yield f"{name} ({number})"


def load_body(log: Log, loaded: LoadBody, world: BulletWorld, color: tuple[float, ...] | None = None) -> Object:
    """Loads a body again, from the recording's own models.

    Args:
        log: the recording.
        loaded: how it was loaded.
        world: where it appears.
        color: RGBA 0..1 that it has got since, empty for that of its model; by default the one it was loaded with.

    Raises:
        Damaged: a file isn't in the recording, or isn't what was attached.
    """
    text = loaded.robot_description
    paint = loaded.color if color is None else color
    return Object(
        loaded.body,
        loaded.type,
        loaded.path,
        loaded.position,
        loaded.orientation,
        world,
        list(paint) or None,
        description=_description(text) if text else None,
        model=_model(log, loaded),
    )


def _model(log: Log, loaded: LoadBody) -> Model:
    names = [f"{asset.sha256}/{asset.path.rpartition('/')[2]}" for asset in loaded.assets]
    if not names:
        raise Damaged(log.path, f"the loading of {loaded.body}", "it names no files")
    missing = next((name for name in names if name not in log.assets), None)
    if missing is not None:
        raise Damaged(log.path, f"the attached file {missing}", "it isn't there")
    return load.restore((name, log.assets[name]) for name in names)


@cache
def _description(text: str) -> RobotDescription:
    return RobotDescription.parse(text, "the recording's robot description")


def reading(body: Body) -> Snapshot:
    """A body's state as the engine takes it.

    Args:
        body: the state.
    """
    return Snapshot(body.pose, body.velocity, tuple(body.joints.values()), tuple(body.joint_velocities.values()))
