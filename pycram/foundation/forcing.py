"""Decisions that a fork forces: candidates of choices, solutions of designators, limits, calls, the order of branches.

Code of PyCRAM calls :func:`forced` before each decision. Decisions are forced only in a run that a recording guides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, Protocol

SKIPPED: Final = "skip"  # the decision that a call isn't made


class Decider(Protocol):
    """An object that forces decisions."""

    def decide(self, decision: str, arguments: Mapping[str, Any]) -> Any:
        """Return the forced value of a decision, such as "choice grasp"; None if the decision is free.

        The kinds of decisions are choice (of a candidate), solution (of a designator), timeout (a limit in s), order
        (of branches), and call (of a function; :data:`SKIPPED` skips it).
        """

    def missing(self, decision: str, candidate: str, candidates: Sequence[str]) -> None:
        """Report that a choice doesn't have the forced candidate."""


_decider: Decider | None = None


@contextmanager
def decided_by(decider: Decider) -> Iterator[None]:
    """Let a decider force decisions of this process during the ``with`` block."""
    global _decider  # noqa: PLW0603  a process makes only one run
    before, _decider = _decider, decider
    try:
        yield
    finally:
        _decider = before


def decider() -> Decider | None:
    """Return the decider of this process; None if all decisions are free."""
    return _decider


def forced(decision: str, arguments: Mapping[str, Any]) -> Any:
    """Return the forced value of a decision; None if the decision is free."""
    return None if _decider is None else _decider.decide(decision, arguments)
