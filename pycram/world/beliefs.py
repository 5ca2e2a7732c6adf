"""Beliefs of a world's robots about objects, while the plan runs; see :mod:`recorder.records.beliefs`.

Beliefs are a part of the world's state, so forked processes, saved states and keyframes contain them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeAlias

from pycram.world.attachment import held
from pycram.world.transaction import Transaction
from recorder.records import Belief, beliefs as fold
from recorder.records.beliefs import Key
from recorder.tracing import journal as journals
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

    Steps: TypeAlias = Mapping[Journal, int]  # the step of one record in each recording


class WorldBeliefs:
    """The beliefs of a world's robots; callers hold the world's lock."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._beliefs: dict[Key, Belief] = {}
        self._steps: dict[Key, Steps] = {}  # steps of the records from which robots learned the beliefs

    def of(self, robot: str) -> list[tuple[Belief, int]]:
        """Return a robot's beliefs, the latest first, with the step of the record from which it learned each belief.

        The step is -1 if no running recording contains the record.
        """
        own = [belief for (name, _), belief in self._beliefs.items() if name == robot]
        return [(belief, self._step(belief)) for belief in reversed(own)]

    def look(self, evidence: Mapping[str, object], steps: Steps = MappingProxyType({})) -> None:
        """Update the beliefs after a perception with evidence of :func:`recorder.records.beliefs.sightings`."""
        self._steps.update(dict.fromkeys(fold.look(self._beliefs, evidence, self._world.sim_step), steps))

    def follow(self, transaction: Transaction, steps: Steps) -> None:
        """Update the beliefs after a transaction; ``steps`` are the steps of its record."""
        world = self._world
        carriers: dict[str, str] | None = None
        if transaction.attached or transaction.detached:
            carried = [body for robot in world.robots for body in held(robot)]
            carriers = {body.name: body.carrier.name for body in carried if body.carrier is not None}
        learned = fold.follow(
            self._beliefs,
            transaction.command,
            world.sim_step,
            removed=transaction.removed,
            carriers=carriers,
            robots=[robot.name for robot in world.robots],
            pose_of=lambda name: world.get_object(name).get_position_and_orientation(),
        )
        self._steps.update(dict.fromkeys(learned, steps))

    def saved(self) -> dict[Key, Steps]:
        """Return the steps of the present beliefs, for :meth:`restored`."""
        return {key: self._steps.get(key, {}) for key in self._beliefs}

    def restored(self, steps: Mapping[Key, Steps]) -> None:
        """Set the steps of beliefs from a saved state."""
        self._steps = dict(steps)

    def rebuild(self, recorded: Iterable[Belief]) -> None:
        """Set the beliefs from a recording, in a world that is rebuilt from the recording."""
        fold.restore(self._beliefs, recorded)
        self._steps.clear()

    def records(self, journal: Journal | None = None) -> list[Belief]:
        """Return copies of the beliefs for a record, with the steps in a recording, or -1 without a recording."""
        copies = []
        for key, belief in self._beliefs.items():
            copy = Belief()
            copy.CopyFrom(belief)
            copy.step = self._steps.get(key, {}).get(journal, -1) if journal is not None else -1
            copies.append(copy)
        return copies

    def _step(self, belief: Belief) -> int:
        steps = self._steps.get((belief.robot, belief.object))
        if not steps:
            return belief.step
        return next((step for journal, step in steps.items() if journals.records_here(journal)), -1)
