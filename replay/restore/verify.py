"""Verify a recording: check that it is consistent, and that repeating its changes has the recorded effects.

The changes are executed in new worlds. Each new mutation is compared with the recorded mutation to the last bit: poses,
joints, velocities, attachments and samples. They are equal with the same build of the engine on the same kind of
computer. On other computers, the last bits may differ, and contacts amplify the differences; then the result contains
the largest deviation. In a world that began before its recording, changes without physics may differ by a micrometre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import PycramError
from pycram.world.transaction import restore_snapshot, take_snapshot
from pycram.world.world import BulletWorld
from recorder.packages import other_versions
from recorder.records import Keyframe, Mutation
from recorder.records.text import text_of
from recorder.tracing.journal import unrecorded
from replay.errors import Damaged, ReplayError
from replay.restore.world import Reexecution, reading
from replay.state.integrity import Deviation, Problem, Verification, Verifier, first_deviation
from replay.state.json_data import record_data
from replay.state.state import World

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

OTHER_ENVIRONMENT_TOLERANCE: Final = 1e-3  # of effects on another computer or with another engine, m or rad

_DIFFERENT: Final = "when it is repeated, the change has another effect"
_LATE_TOLERANCE: Final = 1e-6  # m or rad, tolerance of changes without physics in worlds that continue from a keyframe
#: The last bits of effects depend on these versions.
_ENVIRONMENT_KEYS: Final = ("pycram", "pybullet", "machine", "platform")


def verify(log: RecordReader, progress: Callable[[int], None] | None = None) -> Verification:
    """Verify a recording up to the first problem. ``progress`` is called with each step."""
    with Reexecution(log, "again") as reexecution:
        return _Verifier(log, reexecution).run(progress)


class _Verifier(Verifier):
    static = False

    def __init__(self, log: RecordReader, reexecution: Reexecution) -> None:
        super().__init__(log)
        self._reexecution = reexecution
        self.environment = other_versions(log.metadata, *_ENVIRONMENT_KEYS)

    def forget(self) -> None:
        super().forget()
        self._reexecution.forget()

    def check(self, record: Keyframe | Mutation) -> Problem | None:
        """Repeat a change, and compare the effects. A world that isn't open yet begins with its keyframe."""
        try:
            if isinstance(record, Mutation):
                return self._repeat(record)
            if record.world not in self._reexecution.worlds:
                self._reexecution.begin(record)
                self.worlds.add((record.world, record.seq))
                self.late[record.world] = None
        except (PycramError, ReplayError, ValueError) as error:
            if isinstance(error, Damaged) or isinstance(record, Keyframe) or record.HasField("load_body"):
                self.damage.append(str(error))
            return self._problem(record, f"the change can't be repeated: {error}")
        return None

    def _repeat(self, record: Mutation) -> Problem | None:
        repeated = self._reexecution.repeat(record)
        self.changes += 1
        if record.HasField("open_world"):
            self.worlds.add((record.world, record.seq))
        if repeated is None and self.log.newer is not None:
            self.unknown[record.world] = None
            self._follow(record)
            return None
        if repeated is None:
            return self._problem(record, "this release doesn't know this kind of change")
        if self.log.newer is not None:
            record = Mutation.FromString(record.SerializeToString())
            record.DiscardUnknownFields()
        if record.drags:  # the world continues from the recorded state, because a drag by hand can't be repeated
            self.dragged[record.world] = None
            self._reexecution.late.add(record.world)
        if record.world in self._reexecution.late:
            return self._compare_late(record)
        if repeated.SerializeToString() == record.SerializeToString():
            return None
        deviation = first_deviation(record_data(record), record_data(repeated))
        if deviation is None:
            deviation = Deviation("a last bit", "another", "another")
        if self.environment:
            return self._compare_elsewhere(record, deviation)
        return self._problem(record, _DIFFERENT, deviation)

    def _compare_late(self, record: Mutation) -> Problem | None:
        world = self._reexecution.worlds.get(record.world)
        if world is None:  # the world has already ended
            return None
        state = self.state(record.world)
        if not record.HasField("simulate"):
            worst = _worst(world, state)
            if worst is not None and worst.size > _LATE_TOLERANCE:
                return self._problem(record, _DIFFERENT, worst)
            self._note(worst)
            return None
        self._follow(record)
        return None

    def _follow(self, record: Mutation) -> None:
        """Set a world to the state after the record. From then on, the world is compared with a tolerance."""
        world, state = self._reexecution.worlds.get(record.world), self.state(record.world)
        self._reexecution.late.add(record.world)
        with unrecorded():
            for body in world.objects if world is not None else ():
                restore_snapshot(body, reading(state.body(body.name)))

    def _compare_elsewhere(self, record: Mutation, deviation: Deviation) -> Problem | None:
        world = self._reexecution.worlds.get(record.world)
        worst = deviation if world is None else _worst(world, self.state(record.world)) or deviation
        if worst.size > OTHER_ENVIRONMENT_TOLERANCE:
            where = ", ".join(self.environment)
            return self._problem(record, f"{_DIFFERENT}; but the environment is different: {where}", worst)
        self._note(worst)
        return None

    def _note(self, deviation: Deviation | None) -> None:
        if deviation is not None and (self.largest is None or deviation.size > self.largest.size):
            self.largest = deviation

    def _problem(self, record: Keyframe | Mutation, cause: str, deviation: Deviation | None = None) -> Problem:
        return Problem(record.seq, f"{cause} ({text_of(record)[0]})", deviation, self.tasks.path(record.task))


def _worst(world: BulletWorld, state: World) -> Deviation | None:
    """Return the largest deviation of a world from its recorded state; None if all values are equal bit for bit."""
    bodies = [body.name for body in world.objects]
    pairs = [(body.name, held.body.name) for body in world.objects for held in body.carried]
    if sorted(bodies) != sorted(state.bodies):
        return Deviation("objects", ", ".join(state.bodies), ", ".join(bodies))
    if sorted(pairs) != sorted(state.attachments):
        return Deviation("attachments", ", ".join(map(str, state.attachments)), ", ".join(map(str, pairs)))
    return max(_deviations(world, state), key=lambda deviation: deviation.size, default=None)


def _deviations(world: BulletWorld, state: World) -> Iterator[Deviation]:
    for body in world.objects:
        expected, actual = state.body(body.name), take_snapshot(body)
        for field, recorded, values in (
            ("position", expected.position, actual.pose[0]),
            ("orientation", expected.orientation, actual.pose[1]),
        ):
            for index, (a, b) in enumerate(zip(recorded, values, strict=True)):
                if a != b:
                    yield Deviation(f"{body.name}.{field}[{index}]", a, b)
        for name, value in zip(body.joints, actual.positions, strict=True):
            if expected.joint(name) != value:
                yield Deviation(f"{body.name}.{name}", expected.joint(name), value)
