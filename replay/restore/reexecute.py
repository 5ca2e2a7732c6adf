"""Executes a recording's changes again, in worlds of its own: the same commands from the start give the same bits.

What the funnel tells of a change that is made again has the form of a record, so it can be compared with the recorded
one field by field. A world that existed before its recording began can't be had from its start: it goes on from its
first keyframe, near to the original, but not the same to the last bit once time runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation
from recorder.tracing.journal import Journal, unrecorded
from replay.errors import Damaged, NotRestored
from replay.restore.world import load_body, open_world, rebuild
from replay.state.fold import fold

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import TracebackType
    from typing import Self

    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from recorder.records import Record
    from recorder.records.asset import AssetFile
    from replay.file.log import Log


class _Told:
    """A sink that keeps the last mutation."""

    def __init__(self) -> None:
        self.last: Mutation | None = None

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Takes a record."""
        if isinstance(record, Mutation):
            self.last = Mutation.FromString(payload)

    def attach(self, asset: AssetFile) -> None:
        """Takes a file: the recording has it."""

    def close(self) -> None:
        """Ends."""


class Reexecution:
    """Worlds in which a recording's changes are made again; a block of it ends them.

    Args:
        log: the recording.
        mark: follows the worlds' names.
        mode: "DIRECT" or "GUI".

    Attributes:
        worlds: those that are open, by their names on record.
        late: names of those that go on from a keyframe.
    """

    def __init__(self, log: Log, mark: str, mode: str = "DIRECT") -> None:
        self._log = log
        self._mark = mark
        self._mode = mode
        self._told = _Told()
        self._journal = Journal([self._told])
        self.worlds: dict[str, BulletWorld] = {}
        self.late: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with unrecorded():
            for world in self.worlds.values():
                world.exit()

    def begin(self, frame: Keyframe) -> None:
        """Goes on with a world from its keyframe, if it isn't there.

        Args:
            frame: the keyframe.
        """
        if frame.world not in self.worlds:
            told = fold([frame]).worlds[frame.world]
            with unrecorded():
                self.worlds[frame.world] = rebuild(self._log, told, self._mark, self._mode)
            self.late.add(frame.world)

    def repeat(self, record: Mutation, *, tell: bool = True) -> Mutation | None:
        """Makes a change again.

        Args:
            record: the change on record.
            tell: whether it is to be told what happened.

        Returns:
            What happened now, under the old one's envelope; None if nothing is told.

        Raises:
            PycramError: it can't be made.
            NotRestored: its world isn't there.
        """
        command = record.WhichOneof("command") or ""
        if command == "set_realtime":  # what it simulated is on record as stretches
            return record
        if command != "open_world" and record.world not in self.worlds:
            raise NotRestored(record.seq, f"the recording doesn't tell how {record.world} began")
        self._told.last = None
        with unrecorded(*([self._journal] if tell else [])):
            if command == "open_world":
                self._open(record)
            elif command in _COMMANDS:
                _COMMANDS[command](self, self.worlds[record.world], record)
            if command == "close_world":
                del self.worlds[record.world]
        now = self._told.last
        if now is not None:
            now.seq, now.wall_time_ns, now.thread = record.seq, record.wall_time_ns, record.thread
            now.world, now.task = record.world, record.task
            now.source_file, now.source_line = record.source_file, record.source_line
            now.callers.extend(record.callers)
            if command == "open_world":
                now.open_world.mode = record.open_world.mode  # a window changes nothing
        return now

    def _open(self, record: Mutation) -> None:
        self.late.discard(record.world)
        self.worlds[record.world] = open_world(f"{record.world}@{self._mark}", self._mode)

    def load(self, world: BulletWorld, record: Mutation) -> None:
        """Loads a body again, from the recording's models."""
        load_body(self._log, record.load_body, world)


def executed_again(log: Log, step: int, name: str, mode: str = "DIRECT") -> BulletWorld:
    """A world as it was after a step, with all that the engine knew: its future is the original's, bit for bit.

    Args:
        log: the recording.
        step: the step.
        name: of the world, which is open after that step.
        mode: "DIRECT" or "GUI".

    Raises:
        NotRestored: the world began before the recording.
        Damaged: records before that step are lost.
    """
    gap = next((gap for gap in log.lost() if gap.start <= step), None)
    if gap is not None:
        cause = f"step {gap.start} is lost; without exact, the state may do"
        raise Damaged(log.path, f"what led to step {step}", cause)
    lifetime = next(lifetime for lifetime in log.lifetimes if lifetime.world == name and lifetime.has(step))
    chunks = [number for number in lifetime.changes if number <= log.chunk_of(step)]
    with Reexecution(log, str(step), mode) as again:
        for record in log.records_of(lifetime, (Mutation, Keyframe), chunks):
            if record.seq > step:
                break
            if isinstance(record, Mutation):
                again.repeat(record, tell=False)
            elif isinstance(record, Keyframe) and name not in again.worlds:
                raise NotRestored(step, f"{name} began before the recording; without exact, the state will do")
        return again.worlds.pop(name)


def _move_body(_: Reexecution, world: BulletWorld, record: Mutation) -> None:
    command = record.move_body
    world.get_object(command.body).set_position_and_orientation(command.position, command.orientation)


def _move_joints(_: Reexecution, world: BulletWorld, record: Mutation) -> None:
    command = record.move_joints
    world.get_object(command.body).set_joint_positions(dict(zip(command.joints, command.positions, strict=True)))


def _attach(_: Reexecution, world: BulletWorld, record: Mutation) -> None:
    command = record.attach_body
    carrier, body = _pair(world, command.carrier, command.body)
    carrier.attach(body, command.carrier_link or None, command.body_link or None)


def _detach(_: Reexecution, world: BulletWorld, record: Mutation) -> None:
    carrier, body = _pair(world, record.detach_body.carrier, record.detach_body.body)
    carrier.detach(body)


def _pair(world: BulletWorld, carrier: str, body: str) -> tuple[Object, Object]:
    return world.get_object(carrier), world.get_object(body)


def _set_robot(_: Reexecution, world: BulletWorld, record: Mutation) -> None:
    name = record.set_robot.body
    world.set_robot(world.get_object(name) if name else None)


_COMMANDS: Final[Mapping[str, Callable[[Reexecution, BulletWorld, Mutation], None]]] = {
    "load_body": Reexecution.load,
    "remove_body": lambda _, world, record: world.get_object(record.remove_body.body).remove(),
    "move_body": _move_body,
    "move_joints": _move_joints,
    "attach_body": _attach,
    "detach_body": _detach,
    "set_gravity": lambda _, world, record: world.set_gravity(record.set_gravity.gravity),
    "set_color": lambda _, world, record: world.get_object(record.set_color.body).set_color(record.set_color.color),
    "set_robot": _set_robot,
    "simulate": lambda _, world, record: world.simulate_steps(record.simulate.steps),
    "reset": lambda _, world, __: world.reset(),
    "close_world": lambda _, world, __: world.exit(),
}
