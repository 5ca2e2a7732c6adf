"""Rebuild live worlds of a past step from the recording alone.

By default, bodies are loaded from the recorded models and get the recorded state. The state is exact, but the solver's
contacts are unknown, so the world may continue in another way than the original. With ``exact``, each change is
executed again from the start, so the world continues like the original, bit for bit. A world that began before its
recording continues from its first keyframe, and differs in the last bits. Rebuilding isn't recorded.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Final, Self

from pycram.foundation.failures import DisplayError, PycramError
from pycram.physics.body import Snapshot
from pycram.world import attachment, driving, saved_state
from pycram.world.trajectory import Trajectory
from pycram.world.transaction import restore_snapshot, update
from pycram.world.world import BulletWorld, Object, open_worlds
from recorder import records
from recorder.records import BeginTrajectory, Keyframe, LoadBody, Mutation, Record
from recorder.tracing import journal
from recorder.tracing.journal import Journal, NullSink
from replay.errors import Damaged, NotRestored
from replay.restore.recorded_world import description_of, model_of, world_state
from replay.state.fold import fold, state_at
from replay.state.state import Body, RecordedBelief, Sampled, World

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader


def world_at(
    log: RecordReader,
    step: int,
    world: str | None = None,
    *,
    exact: bool = False,
    mode: str = "DIRECT",
    moment: float | None = None,
) -> BulletWorld:
    """Return the world of a past step, named ``NAME@STEP``, which becomes the current world. Its time stops.

    By default, the world was opened last. With ``exact``, every change is executed again, so that the world continues
    like the original. A ``moment`` is a simulated time in s within the next record: the world has the state of the last
    sample, or with ``exact`` of the last simulated step before the moment.

    Raises:
        NotRestored: No world is open at the step, or it can't be rebuilt exactly.
        Damaged: records or files are lost or invalid.
        DisplayError: No window can open.
    """
    state = world_state(log, step, world, moment)
    within = state_at(log, step, moment).sampled
    with journal.unrecorded(), _reporting_damage(log, step):
        if exact:
            restored = executed_again(log, step, state.name, mode)
            restored.beliefs.rebuild(map(_recorded, state.beliefs.values()))
            if within is not None and within.world == state.name:
                restored.simulate_steps(math.floor(within.asked * records.STEPS_PER_SECOND) - restored.sim_step)
        else:
            restored = rebuild(log, state, _suffix(step, within), mode)
    with ExitStack() as undoing:
        undoing.callback(restored.exit)
        journal.announce(restored)
        BulletWorld.current_bullet_world = restored
        undoing.pop_all()
    return restored


def _suffix(step: int, within: Sampled | None) -> str:
    return str(step) if within is None else f"{within.asked:g}s"


@contextmanager
def temporary_world(
    log: RecordReader, step: int, world: str | None = None, moment: float | None = None
) -> Iterator[BulletWorld]:
    """Yield a past world for a question; it isn't recorded, and isn't the current world. The block closes the world.

    :func:`world_at` describes arguments and errors.
    """
    state = world_state(log, step, world, moment)
    with journal.unrecorded():
        with _reporting_damage(log, step):
            restored = rebuild(log, state, _suffix(step, state_at(log, step, moment).sampled))
        with restored:
            yield restored


@contextmanager
def _reporting_damage(log: RecordReader, step: int) -> Iterator[None]:
    """Raise errors of the executor as damage of the recording, except DisplayError."""
    try:
        yield
    except DisplayError:
        raise
    except (PycramError, ValueError) as error:
        raise Damaged(log.path, f"the world after step {step}", str(error)) from error


def rebuild(log: RecordReader, state: World, suffix: str, mode: str = "DIRECT") -> BulletWorld:
    """Return a new world ``NAME@SUFFIX`` with a recorded state. The caller has switched recording off."""
    world = open_world(f"{state.name}@{suffix}", mode)
    with ExitStack() as undoing:
        undoing.callback(world.exit)
        update(world, sim_step=state.sim_step)
        world.set_gravity(state.gravity)
        for body in state.bodies.values():
            restore_snapshot(load_body(log, body.loaded, world, body.color), reading(body))
        for held in state.attachments.values():
            carrier, carried = world.get_object(held.carrier), world.get_object(held.body)
            links = held.carrier_link or None, held.body_link or None
            attachment.attach(carrier, carried, *links, (held.position, held.orientation), loose=held.loose)
        for following in state.following.values():
            driving.resume(world.get_object(following.begin.body), following)
        if state.robot:
            world.set_robot(world.get_object(state.robot))
        world.beliefs.rebuild(map(_recorded, state.beliefs.values()))
        undoing.pop_all()
    return world


def open_world(name: str, mode: str = "DIRECT") -> BulletWorld:
    """Return an empty world that isn't the current world. If the name exists, a number is added."""
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

    ``color`` is RGBA 0..1, or empty for the colour of the model. By default, the body has the recorded colour. If a
    file is missing or damaged, Damaged is raised.
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
        scale=loaded.scale or 1.0,
        model=model_of(log, loaded),
    )


def _recorded(belief: RecordedBelief) -> records.Belief:
    """Return a belief in the form of records; the pose of a held object is left out."""
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
    """Return the state of a body in the engine's form."""
    return Snapshot(body.pose, body.velocity, tuple(body.joints.values()), tuple(body.joint_velocities.values()))


class _LastMutation(NullSink):
    def __init__(self) -> None:
        self.record: Mutation | None = None

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002
        if isinstance(record, Mutation):
            self.record = Mutation.FromString(payload)


class Reexecution:
    """Worlds ``NAME@SUFFIX`` in which recorded changes are repeated. The context manager closes the worlds."""

    def __init__(self, log: RecordReader, suffix: str, mode: str = "DIRECT") -> None:
        self._log = log
        self._suffix = suffix
        self._mode = mode
        self._last = _LastMutation()
        self._journal = Journal([self._last])
        self.worlds: dict[str, BulletWorld] = {}  # open worlds, by recorded name
        self.late: set[str] = set()  # names of worlds that continue from a keyframe, or after a drag by hand

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.forget()

    def forget(self) -> None:
        """Close all worlds."""
        with journal.unrecorded():
            for world in self.worlds.values():
                world.exit()
        self.worlds.clear()

    def begin(self, frame: Keyframe) -> None:
        """Rebuild a world from a keyframe."""
        state = fold([frame]).worlds[frame.world]
        with journal.unrecorded():
            self.worlds[frame.world] = rebuild(self._log, state, self._suffix, self._mode)
        self.late.add(frame.world)

    def repeat(self, record: Mutation, *, observed: bool = True) -> Mutation | None:
        """Repeat a recorded change; return the new mutation with the envelope of the recorded mutation.

        Return None for a change that isn't repeated here, or that this release doesn't know.

        Raises:
            PycramError: The change can't be repeated.
            NotRestored: The beginning of the world isn't recorded.
            Damaged: The change contradicts the clock of the world.
        """
        command = record.WhichOneof("command") or ""
        if command == "set_realtime":  # the effects of real time are recorded as simulations
            return record
        if command != "open_world" and record.world not in self.worlds:
            raise NotRestored(record.seq, f"the recording lacks the beginning of {record.world}")
        if command == "simulate":
            steps, at = record.simulate.steps, self.worlds[record.world].sim_step
            if at + steps != record.sim_step:  # a damaged number of steps could take years
                cause = f"it simulates {steps} steps from step {at} on, and ends at {record.sim_step}"
                raise Damaged(self._log.path, f"step {record.seq}", cause)
        self._last.record = None
        with journal.unrecorded(*([self._journal] if observed else [])):
            if command == "open_world":
                self.late.discard(record.world)
                self.worlds[record.world] = open_world(f"{record.world}@{self._suffix}", self._mode)
            elif command == "load_body":
                load_body(self._log, record.load_body, self.worlds[record.world])
            elif command in _COMMANDS:
                _COMMANDS[command](self.worlds[record.world], getattr(record, command))
            if command == "close_world":
                del self.worlds[record.world]
        repeated = self._last.record
        if repeated is not None:
            repeated.seq, repeated.wall_time_ns, repeated.thread = record.seq, record.wall_time_ns, record.thread
            repeated.monotonic_ns = record.monotonic_ns
            repeated.world, repeated.task, repeated.cause = record.world, record.task, record.cause
            repeated.source_file, repeated.source_line = record.source_file, record.source_line
            repeated.callers.extend(record.callers)
            repeated.by_fork = record.by_fork
            _keep_what_follows(record, repeated, with_overlaps=self._log.format > 0)
        return repeated


def _keep_what_follows(record: Mutation, repeated: Mutation, *, with_overlaps: bool) -> None:
    """Copy the fields that don't depend on the repetition. Overlaps are removed if the recording has none."""
    if record.HasField("open_world"):
        repeated.open_world.mode = record.open_world.mode  # opening a window changes nothing in the world
    if record.HasField("load_body") and not with_overlaps and not record.load_body.overlaps:
        del repeated.load_body.overlaps[:]
    if record.simulate.HasField("settled"):  # this field follows from the states
        repeated.simulate.settled = record.simulate.settled


def executed_again(log: RecordReader, step: int, name: str, mode: str = "DIRECT") -> BulletWorld:
    """Return an open world after a step with the complete state of the engine, so that its future equals the original.

    Raises:
        NotRestored: The world began before the recording.
        Damaged: Records before the step are lost.
    """
    lifetime = next(lifetime for lifetime in log.lifetimes if lifetime.world == name and lifetime.has(step))
    chunks = [number for number in lifetime.changes if number <= log.chunk_of(step)]
    for _ in log.records_of(lifetime, (Mutation, Keyframe), chunks):  # readers of records add losses
        pass
    gap = next((gap for gap in log.lost() if gap.start <= step), None)
    if gap is not None:
        cause = f"step {gap.start} is lost; restore the world without exact=True (--exact)"
        raise Damaged(log.path, f"the part before step {step}", cause)
    with Reexecution(log, str(step), mode) as reexecution:
        for record in log.records_of(lifetime, (Mutation, Keyframe), chunks):
            if record.seq > step:
                break
            if isinstance(record, Mutation):
                if record.drags:
                    dragged = f"{record.drags[0].body} was dragged by hand at step {record.seq}"
                    raise NotRestored(step, f"{dragged}; restore the world without exact=True (--exact)")
                reexecution.repeat(record, observed=False)
            elif name not in reexecution.worlds:
                raise NotRestored(step, f"{name} began before the recording; restore it without exact=True (--exact)")
        return reexecution.worlds.pop(name)


def _begin_trajectory(world: BulletWorld, command: BeginTrajectory) -> None:
    search = command.search if command.HasField("search") else None
    trajectory = Trajectory.of_record(command.trajectory)
    driving.begin(world, world.get_object(command.body), trajectory, search, command.number, coasts=command.coasts)


_COMMANDS: Final[Mapping[str, Callable[[BulletWorld, Any], None]]] = {
    "remove_body": lambda world, command: world.get_object(command.body).remove(),
    "move_body": lambda world, command: world.get_object(command.body).set_position_and_orientation(
        command.position, command.orientation
    ),
    "move_joints": lambda world, command: world.get_object(command.body).set_joint_positions(
        dict(zip(command.joints, command.positions, strict=True))
    ),
    "attach_body": lambda world, command: attachment.attach(
        world.get_object(command.carrier),
        world.get_object(command.body),
        command.carrier_link or None,
        command.body_link or None,
        along=[world.get_object(name) for name in command.along],
        left=[world.get_object(name) for name in command.left],
    ),
    "detach_body": lambda world, command: attachment.detach(
        world.get_object(command.carrier), world.get_object(command.body)
    ),
    "set_gravity": lambda world, command: world.set_gravity(command.gravity),
    "set_color": lambda world, command: world.get_object(command.body).set_color(command.color),
    "set_robot": lambda world, command: world.set_robot(world.get_object(command.body) if command.body else None),
    "simulate": lambda world, command: world.simulate_steps(command.steps),
    "begin_trajectory": _begin_trajectory,
    "stop_trajectory": lambda world, command: driving.stop(world, command.number),
    "reset": lambda world, _: world.reset(),
    "restore": saved_state.put_back,
    "close_world": lambda world, _: world.exit(),
}
