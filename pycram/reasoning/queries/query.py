"""What every reasoning query has in common: it leaves no trace, and its answer goes on record.

While a query runs, the world's lock is held and the world refuses changes, so that a query that tries one by mistake is
told. Queries may ask each other; each public call is one record, unless it was asked wrongly.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

from pycram.foundation.failures import BadArgument, NoWorld, UsageError
from pycram.handle import unwrap
from pycram.world.world import BulletWorld, Object
from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from typing import Self

T = TypeVar("T")


class Verdict(int):
    """Yes or no, and why.

    Behaves as the bool that it is; ``evidence`` holds what it rests on.
    """

    evidence: Mapping[str, object]

    def __new__(cls, answer: object, evidence: Mapping[str, object] | None = None) -> Self:
        """Makes it from anything that is true or false."""
        verdict = super().__new__(cls, bool(answer))
        verdict.evidence = dict(evidence or {})
        return verdict

    def __repr__(self) -> str:
        return repr(bool(self))

    __str__ = __repr__

    def __record__(self) -> object:
        """How it stands in records."""
        return bool(self)


class Found(list[T], Generic[T]):
    """The objects found, and why; behaves as the list that it is."""

    def __init__(self, items: Iterable[T] = (), evidence: Mapping[str, object] | None = None) -> None:
        super().__init__(items)
        self.evidence: Mapping[str, object] = dict(evidence or {})


@dataclass(slots=True)
class Asking:
    """A query that is running; it sets ``answer``, and ``picture`` if it looked at something."""

    answer: object = None
    evidence: dict[str, object] = field(default_factory=dict)
    picture: records.Picture | None = None


@contextmanager
def asking(name: str, world: BulletWorld, arguments: Mapping[str, object]) -> Iterator[Asking]:
    """Runs its block as a query.

    Args:
        name: of the query.
        world: the world that it is about.
        arguments: what was asked, for the record.

    Yields:
        Where the answer is put.

    Raises:
        WorldClosed: the world has ended.
    """
    start = time.perf_counter_ns()
    with world.lock:
        transactions = world.transactions
        outer = transactions.query
        transactions.query = ""  # asked inside another query: that one is fine
        try:
            transactions.check(f"ask {name}")
        finally:
            transactions.query = outer
        transactions.query = name
        asked = Asking()
        error: BaseException | None = None
        try:
            yield asked
        except BaseException as raised:
            error = raised
            raise
        finally:
            transactions.query = outer
            if journal.recording() and not isinstance(error, UsageError):  # what can't be asked has not been asked
                record = records.Query(
                    name=name,
                    arguments=records.arguments(arguments),
                    answer_json=records.to_json(asked.answer),
                    evidence=records.arguments(asked.evidence),
                    duration_ns=time.perf_counter_ns() - start,
                    failure=records.failure(error) if error is not None else None,
                    picture=asked.picture,
                )
                journal.emit(record, world=world.name, sim_step=world.sim_step)


def robot_of(robot: object) -> Object:
    """A robot that a query is about.

    Args:
        robot: the robot, or a branch's handle for it.

    Raises:
        BadArgument: it isn't one.
    """
    machine = unwrap(robot)
    if not isinstance(machine, Object) or not machine.is_robot:
        raise BadArgument("robot", machine, 'an object of type "robot"')
    return machine


def world_of(*bodies: Object, world: BulletWorld | None = None) -> BulletWorld:
    """The world that a query is about.

    Args:
        bodies: the objects asked about; they are in the same world.
        world: the world that was named, if any.

    Raises:
        BadArgument: something isn't an object, or objects are in different worlds.
        NoWorld: nothing says which world.
    """
    if world is not None and not isinstance(world, BulletWorld):
        raise BadArgument("world", world, "a BulletWorld")
    place = world
    for body in bodies:
        if not isinstance(body, Object):
            raise BadArgument("object", body, "an Object of a world")
        if place is None:
            place = body.world
        elif body.world is not place:
            raise BadArgument("object", body, f"an object of {place.name}; {body.name} is in {body.world.name}")
        _ = body.handle  # a removed one says so
    if place is None:
        place = BulletWorld.current_bullet_world
    if place is None:
        raise NoWorld
    return place
