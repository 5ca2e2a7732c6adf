"""Steps by the commands that they record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Mutation

if TYPE_CHECKING:
    from replay.recording import Recording


def mutation(log: Recording, command: str, which: int = 0) -> int:
    """The step of the how-many-th such command."""
    return [r.seq for r in log.records(Mutation) if r.WhichOneof("command") == command][which]
