"""Timeouts: what a part of the plan was waiting for, or doing, when its time was up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Task, from_json
from recorder.tasks import State
from replay.explain.causes.cause import Timeout
from replay.explain.causes.pending import pending, steps_of, stopped, subtree
from replay.explain.causes.raised import answers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tasks import Node
    from replay.explain.causes.case import Case
    from replay.explain.causes.cause import Pending
    from replay.explain.plan_source import Line

_MAX_TASKS: Final = 3


def find(case: Case) -> Iterator[Timeout]:
    """Yield what missed a deadline: that of a timeout, or of a wait by whose outcome the plan judged."""
    if case.task is not None and case.task.kind == "timeout" and case.failure.type == "TimedOut":
        tree = subtree(case, 0, case.task.last_step + 1)
        scope = tree.nodes[case.task.id]
        doing = tuple(pending(case, node, tree, case.step) for node in stopped(tree, scope))
        took = sorted(_ended(scope), key=lambda node: -(node.seconds or 0.0))[:_MAX_TASKS]
        seconds, clock = case.task.parameters.get("seconds"), case.task.parameters.get("clock")
        yield _timeout(case, seconds, str(clock), doing, tuple(took), _stopped_at(case))
        return
    for wait in list(answers(case))[-1:]:
        if isinstance(wait, Task) and from_json(wait.result_json) is False:
            tree = subtree(case, 0, case.step + 1)
            node = tree.nodes[wait.task]
            single = pending(case, node, tree, wait.seq)
            yield _timeout(case, node.parameters.get("timeout"), "wall", (single,), (), case.line_of(node.started))


def _ended(scope: Node) -> Iterator[Node]:
    """Yield what was done within a scope, also in blocks that were not."""
    for node in scope.children:
        if node.status in (State.SUCCEEDED, State.FAILED):
            yield node
        else:
            yield from _ended(node)


def _timeout(
    case: Case, seconds: object, clock: str, doing: tuple[Pending, ...], took: tuple[Node, ...], line: Line | None
) -> Timeout:
    limit = float(seconds) if isinstance(seconds, int | float) else 0.0
    steps = {case.step, *(step for each in doing for step in steps_of(each)), *(node.last_step for node in took)}
    return Timeout(tuple(sorted(steps)), limit, clock, doing, line, took)


def _stopped_at(case: Case) -> Line | None:
    """Return the plan's line that the deadline stopped, by the traceback."""
    stop = next((error for error in case.traced if error.type == "Cancelled" and error.lines), None)
    return case.line(stop.lines) if stop is not None else None
