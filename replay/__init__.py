"""Opens recordings: any step back, from the file alone.

``replay.open(path)`` gives a :class:`Recording`: its records by step, and with ``log.state_at(step)`` what was true of
every world after one. Needs neither the plan nor the physics engine.
"""

from replay.errors import Damaged, LogClosed, NoSuchName, NoSuchStep, NotALog, NotRestored, ReplayError, Unreadable
from replay.recording import Recording
from replay.state.fold import fold
from replay.state.state import Attachment, Body, State, World

open = Recording  # noqa: A001  replay.open reads well

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
]
