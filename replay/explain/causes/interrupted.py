"""Plans that somebody interrupted, by Ctrl-C or a signal, or whose process ended without closing the recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Run
from recorder.tasks import State
from replay.explain.causes.cause import Interrupted
from replay.explain.causes.pending import pending, steps_of, stopped, subtree
from replay.history.failures import INTERRUPT

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tasks import Node, Tree
    from replay.explain.causes.case import Case

_NAMES: Final = {"SIGINT": "Ctrl-C", "": "Ctrl-C"}  # no name: of the first releases


def find(case: Case) -> Iterator[Interrupted]:
    """Yield by what a plan was interrupted, and while it did what."""
    end = case.log[-1]
    closed = isinstance(end, Run) and end.phase == Run.FINISHED
    if case.failure.type != (INTERRUPT if closed else ""):  # what failed before is another case
        return
    by = _NAMES.get(end.interrupted_by, end.interrupted_by) if isinstance(end, Run) and closed else ""
    tree = subtree(case, 0, len(case.log))
    doing = tuple(pending(case, node, tree, case.step) for node in (_interrupted(tree) if by else stopped(tree)))
    error = next(reversed(case.traced), None)
    line = case.line(error.lines) if error is not None and error.lines else None
    steps = {case.step, *(step for each in doing for step in steps_of(each))}
    yield Interrupted(tuple(sorted(steps)), by, doing, line)


def _interrupted(tree: Tree) -> list[Node]:
    """Return the innermost tasks that were interrupted, or cancelled by that."""
    hit = [node for _, node in tree.walk() if node.error is not None and node.error[0] == INTERRUPT]
    found: list[Node] = []
    for node in hit:
        cancelled = [part for part in stopped(tree, node) if part.status is State.CANCELLED]
        if not any(child in hit for child in node.children):
            found += cancelled or [node]
    return found
