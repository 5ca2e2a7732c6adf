"""Open recordings, and read every past step.

``replay.open(path)`` returns a :class:`Recording`, which has the records by step; ``log.state_at(step)`` returns the
state of every world after a step. Readers need neither the plan nor the physics engine. ``replay.open_runs(folder)``
opens a folder of recordings as tables.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import recorder  # noqa: F401  limits the threads of NumPy, so it must be imported before NumPy

if TYPE_CHECKING:
    from replay.errors import Damaged, LogClosed, NoSuchName, NoSuchStep, NotALog, NotRestored, ReplayError, Unreadable
    from replay.recording import Recording
    from replay.runs.folder import Runs
    from replay.state.fold import fold
    from replay.state.state import Attachment, Body, State, World

    open = Recording  # noqa: A001  replay.open reads well

#: Modules of public names. All other public names are in ``replay.errors``.
_MODULES = dict.fromkeys(("Attachment", "Body", "State", "World"), "state.state") | {
    "Recording": "recording",
    "open": "recording",
    "fold": "state.fold",
}


def __getattr__(name: str) -> object:
    """Import public names on demand, so that commands without a recording start fast."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"replay.{_MODULES.get(name, 'errors')}")
    value: object = getattr(module, "Recording" if name == "open" else name)
    return globals().setdefault(name, value)


def open_runs(path: "str | Path") -> "Runs":
    """Open a folder of recordings as tables (:class:`replay.runs.folder.Runs`).

    The extra ``runs`` must be installed.
    """
    from recorder.packages import needed  # noqa: PLC0415  only folders need this import

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
