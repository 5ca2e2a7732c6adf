"""Opens recordings: any past step, from the file alone.

``replay.open(path)`` returns a :class:`Recording`: its records by step, and with ``log.state_at(step)`` the state of
every world after a step. It needs neither the plan nor the physics engine. ``replay.open_runs(folder)`` opens a folder
of recordings as tables.
"""

from typing import TYPE_CHECKING

from replay.errors import Damaged, LogClosed, NoSuchName, NoSuchStep, NotALog, NotRestored, ReplayError, Unreadable
from replay.recording import Recording
from replay.state.fold import fold
from replay.state.state import Attachment, Body, State, World

if TYPE_CHECKING:
    from pathlib import Path

    from replay.runs.folder import Runs

open = Recording  # noqa: A001  replay.open reads well


def open_runs(path: "str | Path") -> "Runs":
    """Open a folder of recordings as tables, which needs the extra ``runs``; see :class:`replay.runs.folder.Runs`."""
    from recorder.packages import needed  # noqa: PLC0415  only folders need it

    with needed("runs"):
        from replay.runs.folder import Runs  # noqa: PLC0415

        return Runs(path)


__all__ = [
    "Attachment",
    "Body",
    "Damaged",
    "LogClosed",
    "NoSuchName",
    "NoSuchStep",
    "NotALog",
    "NotRestored",
    "Recording",
    "ReplayError",
    "State",
    "Unreadable",
    "World",
    "fold",
    "open",
    "open_runs",
]


def __dir__() -> list[str]:
    return __all__
