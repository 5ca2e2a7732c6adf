"""Timeouts: what a part of the plan was waiting for, or doing, when its time was up."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

from recorder.records import STEPS_PER_SECOND, Mutation, Task, from_json
from recorder.tasks import State
from replay.explain.causes.cause import Simulated, Timeout
from replay.explain.causes.pending import pending, steps_of, stopped, subtree
from replay.explain.causes.raised import answers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tasks import Node
    from replay.explain.causes.case import Case
    from replay.explain.causes.cause import Pending
    from replay.history.source import Line

SIMULATED: Final = "simulated"  # the clock of a limit in simulated time
_MAX_TASKS: Final = 3


def find(case: Case) -> Iterator[Timeout]:
    """Yield what missed a deadline: that of a timeout, or of a wait by whose outcome the plan judged."""
    if case.task is not None and case.task.kind == "timeout" and case.failure.type == "TimedOut":
        tree = subtree(case, 0, case.task.last_step + 1)
        scope = tree.nodes[case.task.id]
        doing = tuple(pending(case, node, tree, case.step) for node in stopped(tree, scope))
        seconds, clock = case.task.parameters.get("seconds"), str(case.task.parameters.get("clock"))
        took = sorted(_ended(scope), key=lambda node: -duration(node, clock))[:_MAX_TASKS]
        simulated = _simulated(case, scope) if clock == SIMULATED else ()
        yield _timeout(case, seconds, clock, doing, tuple(took), _stopped_at(case), simulated)
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


def duration(node: Node, clock: str) -> float:
    """Return how long a task took by a clock, s."""
    if clock == SIMULATED and node.start is not None and node.end is not None:
        return node.end.sim_seconds - node.start.sim_seconds
    return node.seconds or 0.0


def _simulated(case: Case, scope: Node) -> tuple[Simulated, ...]:
    """Return the lines that took most of the simulated time within a scope."""
    lines: dict[Line | None, list[Mutation]] = defaultdict(list)
    for record in case.log.records(Mutation, scope.started.seq, scope.last_step):
        if record.HasField("simulate") and case.is_here(record):
            lines[case.line_of(record)].append(record)
    found = [
        Simulated(
            line,
            sum(record.simulate.steps for record in records) / STEPS_PER_SECOND,
            tuple(record.seq for record in records),
        )
        for line, records in lines.items()
    ]
    return tuple(sorted(found, key=lambda each: -each.seconds)[:_MAX_TASKS])


def _timeout(
    case: Case,
    seconds: object,
    clock: str,
    doing: tuple[Pending, ...],
    took: tuple[Node, ...],
    line: Line | None,
    simulated: tuple[Simulated, ...] = (),
) -> Timeout:
    limit = float(seconds) if isinstance(seconds, int | float) else 0.0
    steps = {case.step, *(step for each in doing for step in steps_of(each)), *(node.last_step for node in took)}
    steps |= {each.steps[-1] for each in simulated}
    return Timeout(tuple(sorted(steps)), limit, clock, doing, line, took, simulated)


def _stopped_at(case: Case) -> Line | None:
    """Return the plan's line that the deadline stopped, by the traceback."""
    stop = next((error for error in case.traced if error.type == "Cancelled" and error.lines), None)
    return case.line(stop.lines) if stop is not None else None
