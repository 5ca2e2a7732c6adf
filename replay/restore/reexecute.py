"""Executes recorded changes again in worlds of its own: the same commands from the start give the same bits.

A repeated change is recorded as a mutation that can be compared with the original one field by field. A world that
existed before its recording began can't be had from its start: it continues from its first keyframe, near to the
original, but not the same to the last bit once time runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.world import driving, saved_state
from pycram.world.trajectory import Trajectory
from recorder.records import Keyframe, Mutation
from recorder.tracing.journal import Journal, NullSink, unrecorded
from replay.errors import Damaged, NotRestored
from replay.restore.world import load_body, open_world, rebuild
from replay.state.fold import fold

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import TracebackType
    from typing import Self

    from pycram.world.world import BulletWorld
    from recorder.records import AttachBody, BeginTrajectory, DetachBody, MoveBody, MoveJoints, Record
    from replay.file.record_reader import RecordReader


class _LastMutation(NullSink):
    """A sink that keeps the last mutation."""

    def __init__(self) -> None:
        self.record: Mutation | None = None

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Keep a record."""
        if isinstance(record, Mutation):
            self.record = Mutation.FromString(payload)


class Reexecution:
    """Worlds ``NAME@SUFFIX`` in which recorded changes are made again; a context manager that closes them."""

    def __init__(self, log: RecordReader, suffix: str, mode: str = "DIRECT") -> None:
        self._log = log
        self._suffix = suffix
        self._mode = mode
        self._last = _LastMutation()
        self._journal = Journal([self._last])
        self.worlds: dict[str, BulletWorld] = {}  # those that are open, by their recorded names
        # names of those that continue from a keyframe, or from what somebody dragged by hand
        self.late: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.forget()

    def forget(self) -> None:
        """Close all worlds."""
        with unrecorded():
            for world in self.worlds.values():
                world.exit()
        self.worlds.clear()

    def begin(self, frame: Keyframe) -> None:
        """Rebuild a world from its keyframe, if it isn't there."""
        if frame.world not in self.worlds:
            state = fold([frame]).worlds[frame.world]
            with unrecorded():
                self.worlds[frame.world] = rebuild(self._log, state, self._suffix, self._mode)
            self.late.add(frame.world)

    def repeat(self, record: Mutation, *, observed: bool = True) -> Mutation | None:
        """Make a recorded change again, and return the new mutation in the old one's envelope.

        It is None if the change isn't observed, or unknown to this release.

        Raises:
            PycramError: it can't be made.
            NotRestored: its world isn't there.
            Damaged: it contradicts the world's clock.
        """
        command = record.WhichOneof("command") or ""
        if command == "set_realtime":  # what it simulated is recorded as simulate commands
            return record
        if command != "open_world" and record.world not in self.worlds:
            raise NotRestored(record.seq, f"the recording lacks the beginning of {record.world}")
        if command == "simulate":
            _check_clock(self._log, self.worlds[record.world], record)
        self._last.record = None
        with unrecorded(*([self._journal] if observed else [])):
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


def _check_clock(log: RecordReader, world: BulletWorld, record: Mutation) -> None:
    """Refuse to simulate another time than a world's clock tells: it could be years."""
    if world.sim_step + record.simulate.steps != record.sim_step:
        cause = (
            f"it simulates {record.simulate.steps} steps from step {world.sim_step} on, and ends at {record.sim_step}"
        )
        raise Damaged(log.path, f"step {record.seq}", cause)


def _keep_what_follows(record: Mutation, repeated: Mutation, *, with_overlaps: bool) -> None:
    """Take over what says nothing of how a change is made; overlaps only where the recording's release records them."""
    if record.HasField("open_world"):
        repeated.open_world.mode = record.open_world.mode  # a window changes nothing
    if record.HasField("load_body") and not with_overlaps and not record.load_body.overlaps:
        del repeated.load_body.overlaps[:]
    if record.simulate.HasField("settled"):  # follows from the states
        repeated.simulate.settled = record.simulate.settled


def executed_again(log: RecordReader, step: int, name: str, mode: str = "DIRECT") -> BulletWorld:
    """Return a world that is open after a step, with all that the engine knew: its future is the original's.

    Raises:
        NotRestored: the world began before the recording.
        Damaged: records before that step are lost.
    """
    lifetime = next(lifetime for lifetime in log.lifetimes if lifetime.world == name and lifetime.has(step))
    chunks = [number for number in lifetime.changes if number <= log.chunk_of(step)]
    for _ in log.records_of(lifetime, (Mutation, Keyframe), chunks):  # of what wasn't read, nothing is known to be lost
        pass
    gap = next((gap for gap in log.lost() if gap.start <= step), None)
    if gap is not None:
        cause = f"step {gap.start} is lost; without exact, the state may do"
        raise Damaged(log.path, f"what led to step {step}", cause)
    with Reexecution(log, str(step), mode) as reexecution:
        for record in log.records_of(lifetime, (Mutation, Keyframe), chunks):
            if record.seq > step:
                break
            if isinstance(record, Mutation):
                if record.drags:
                    dragged = f"{record.drags[0].body} was dragged by hand at step {record.seq}"
                    raise NotRestored(step, f"{dragged}; without exact, the state will do")
                reexecution.repeat(record, observed=False)
            elif name not in reexecution.worlds:
                raise NotRestored(step, f"{name} began before the recording; without exact, the state will do")
        return reexecution.worlds.pop(name)


def _move_body(world: BulletWorld, command: MoveBody) -> None:
    world.get_object(command.body).set_position_and_orientation(command.position, command.orientation)


def _move_joints(world: BulletWorld, command: MoveJoints) -> None:
    world.get_object(command.body).set_joint_positions(dict(zip(command.joints, command.positions, strict=True)))


def _attach(world: BulletWorld, command: AttachBody) -> None:
    carrier, body = world.get_object(command.carrier), world.get_object(command.body)
    carrier.attach(body, command.carrier_link or None, command.body_link or None)


def _detach(world: BulletWorld, command: DetachBody) -> None:
    world.get_object(command.carrier).detach(world.get_object(command.body))


def _begin_trajectory(world: BulletWorld, command: BeginTrajectory) -> None:
    search = command.search if command.HasField("search") else None
    trajectory = Trajectory.of_record(command.trajectory)
    driving.begin(world, world.get_object(command.body), trajectory, search, command.number)


_COMMANDS: Final[Mapping[str, Callable[[BulletWorld, Any], None]]] = {
    "remove_body": lambda world, command: world.get_object(command.body).remove(),
    "move_body": _move_body,
    "move_joints": _move_joints,
    "attach_body": _attach,
    "detach_body": _detach,
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
