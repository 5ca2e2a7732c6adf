"""Saved states of a world.

A state has poses and velocities of objects; positions, velocities and motor targets of joints; attachments, gravity,
the robot and the robots' beliefs. Values are restored exactly, but the engine normalises orientations (error up to
2e-16). The solver's cached contacts aren't part of a state, so a restored world may continue differently.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from pycram.foundation.failures import BadArgument, ObjectsChanged, WorldClosed
from pycram.physics.body import Snapshot
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.transaction import AT_REST, Transaction, take_snapshot, update
from recorder import records
from recorder.records.beliefs import Key
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    from pycram.world.beliefs import Steps
    from pycram.world.world import BulletWorld


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SavedState:
    """The state of a world at one moment, for ``world.restore(saved)``."""

    world: BulletWorld
    objects: tuple[Object, ...]  # all objects of the world at that moment
    command: records.Restore  # the record that restores the state
    #: Steps of the records from which robots learned the beliefs, if this process wrote these records.
    steps: Mapping[Key, Steps] = field(default_factory=dict)
    snapshots: Mapping[Object, Snapshot] = field(default_factory=dict)  # states of the objects without joints

    def __repr__(self) -> str:
        return f"<state of {self.world.name} at {self.command.sim_step / records.STEPS_PER_SECOND:.3f} s>"


def save(world: BulletWorld) -> SavedState:
    """Return the present state of a world; raises WorldClosed if the world has ended."""
    with world.lock:
        if world.closed:
            raise WorldClosed(world.name, "save its state")
        world.trajectories.refuse_any("save the state of a world")
        command = records.Restore(
            sim_step=world.sim_step,
            bodies=[_state_of(body) for body in world.objects],
            attachments=[held.record() for body in world.objects for held in body.carried],
            gravity=world.gravity,
            robot=world.robot.name if world.robot else "",
            beliefs=world.beliefs.records(),
        )
        snapshots = {body: take_snapshot(body) for body in world.objects if not body.handle.joints}
        return SavedState(world, tuple(world.objects), command, world.beliefs.saved(), snapshots)


def restore(world: BulletWorld, saved: SavedState) -> None:
    """Restore a saved state of a world in one transaction; see :meth:`pycram.world.world.BulletWorld.restore`."""
    if not isinstance(saved, SavedState) or saved.world is not world:
        raise BadArgument("saved", saved, f"a state that {world.name}.save() has returned")
    put_back(world, saved.command, saved.objects, saved.steps, saved.snapshots)


def put_back(
    world: BulletWorld,
    command: records.Restore,
    objects: Collection[Object] | None = None,
    steps: Mapping[Key, Steps] | None = None,
    snapshots: Mapping[Object, Snapshot] = MappingProxyType({}),
) -> None:
    """Restore a recorded state of a world. Without ``objects``, names determine the objects of the state.

    ``steps`` are the steps of the records from which robots learned the beliefs; None if the command contains them.
    """
    with world.transactions.begin(records.Mutation(restore=command)) as transaction:
        expected = {*(world.objects if objects is None else objects)}
        bodies = {body.name: body for body in world.objects if body in expected}
        added = [body.name for body in world.objects if body not in expected]
        named = [state.body for state in command.bodies]
        named += [name for held in command.attachments for name in (held.carrier, held.body)]
        removed = list(dict.fromkeys(name for name in named if name not in bodies))
        if added or removed:
            raise ObjectsChanged(world.name, added, removed)
        if objects is None:
            _check(command, bodies)
        world.trajectories.end_all()
        saved = {(held.carrier, held.body): held for held in command.attachments}
        kept = {}
        for body in world.objects:
            for held in body.carried:
                pair = held.carrier.name, held.body.name
                known, wanted = held.record(), saved.get(pair)
                links = known.carrier_link, known.body_link
                if wanted is not None and links == (wanted.carrier_link, wanted.body_link):
                    kept[pair] = known
                else:
                    attachment.end(held, transaction)
        for state in command.bodies:
            body = bodies[state.body]
            _put(body, state, snapshots.get(body), transaction)
        for pair, wanted in saved.items():
            if kept.get(pair) != wanted:
                attachment.put_back(bodies[wanted.carrier], bodies[wanted.body], wanted, transaction)
        x, y, z = command.gravity
        world.engine.set_gravity((x, y, z))
        update(world, gravity=(x, y, z))
        world.beliefs.restored(steps or {})
        if steps is not None:
            transaction.number = partial(_number, transaction.command.restore, steps)
        world._robot = bodies.get(command.robot)  # noqa: SLF001  set_robot() would write a second record


def _check(command: records.Restore, bodies: Mapping[str, Object]) -> None:
    """Raise BadArgument if a recorded command, which may contain any numbers, doesn't fit these objects."""
    for state in command.bodies:
        joints = len(bodies[state.body].handle.joints)
        numbers = (state.joint_positions, state.joint_velocities, state.joint_targets)
        whole = (len(state.position), len(state.orientation)) == (3, 4) and len(state.velocity) in (0, 6)
        if not whole or any(len(values) != joints for values in numbers):
            raise BadArgument("saved", state.body, f"a pose, a velocity and {joints} joints of {state.body}")
    for held in command.attachments:
        for name, link in ((held.carrier, held.carrier_link), (held.body, held.body_link)):
            if link:
                bodies[name].check_link(link)
    if len(command.gravity) != 3:
        raise BadArgument("saved", command.gravity[:], "three numbers of gravity")


def _number(command: records.Restore, steps: Mapping[Key, Steps], journal: Journal) -> None:
    for belief in command.beliefs:
        belief.step = steps.get((belief.robot, belief.object), {}).get(journal, -1)


def _state_of(body: Object) -> records.SavedBody:
    engine, handle = body.world.engine, body.handle
    (position, orientation), velocity = engine.center_pose(handle), engine.velocity(handle)
    positions, velocities = engine.joints(handle)
    return records.SavedBody(
        body=body.name,
        position=position,
        orientation=orientation,
        velocity=velocity if velocity != AT_REST else (),
        joint_positions=positions,
        joint_velocities=velocities,
        joint_targets=[handle.targets[name] for name in handle.joints],
    )


def _put(body: Object, state: records.SavedBody, was: Snapshot | None, transaction: Transaction) -> None:
    """Restore an object's state; if the state doesn't differ, the solver keeps its cached contacts."""
    if was is take_snapshot(body) or _state_of(body) == state:  # nothing has changed the body, or not for good
        return
    engine, handle = body.world.engine, body.handle
    x, y, z = state.position
    i, j, k, w = state.orientation
    engine.set_center_pose(handle, ((x, y, z), (i, j, k, w)))
    if state.velocity:
        engine.set_velocity(handle, state.velocity[:])
    joints = handle.joints
    positions = dict(zip(joints, state.joint_positions, strict=True))
    engine.set_joints(handle, positions, dict(zip(joints, state.joint_velocities, strict=True)))
    targets = dict(zip(joints, state.joint_targets, strict=True))
    engine.set_targets(handle, {name: target for name, target in targets.items() if target != positions[name]})
    transaction.mark_modified(body)
    if body.is_environment:
        transaction.fire(body.world.get_manipulation_event(), body)
