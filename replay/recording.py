"""A recording as users have it: its records, and from them states, trees and worlds.

It is the facade over :mod:`replay.file`, :mod:`replay.state`, :mod:`replay.explain` and :mod:`replay.restore`, and the
place where names of steps become numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.explain.step_names import step_of
from replay.explain.tree import tree
from replay.file.log import Log
from replay.state.fold import state_at

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.world.world import BulletWorld
    from recorder.tasks import Tree
    from replay.state.state import State


class Recording(Log):
    """A recording; opened by ``replay.open``. Not for several threads at once."""

    def step(self, name: int | str) -> int:
        """Return the number of a step; see :func:`replay.explain.step_names.step_of` for the names."""
        return step_of(self, name)

    def state_at(self, step: int | str) -> State:
        """Return what is true after a step.

        Args:
            step: a number, or a name of a step.

        Raises:
            NoSuchStep: there is no such step.
            Damaged: a record makes no sense.
        """
        return state_at(self, self.step(step))

    def tree(self) -> Tree:
        """Return the task tree: the classes that ``pycram.tasks`` has too."""
        return tree(self)

    def world_at(self, step: int | str, world: str | None = None, *, exact: bool = False) -> BulletWorld:
        """Return a live world as it was after a step; see :func:`replay.restore.world.world_at`."""
        from replay.restore.world import world_at  # noqa: PLC0415  it needs the executor and its engine; reading does not

        return world_at(self, step, world, exact=exact)


def open_recording(path: str | Path) -> Recording:
    """Open a recording.

    Args:
        path: the MCAP file; finished, cut, or still being written.

    Raises:
        NotALog: it isn't one, or nothing of it can be read.
    """
    return Recording(path)
