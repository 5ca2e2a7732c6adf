"""Parts of a plan that were skipped for want of what a failed perception would have found.

By the plan's source: the line that led to the perception sets a variable, or puts something into it; further on in the
same function a ``for``, ``while`` or ``if`` reads it, and what that would have done with it isn't on record.
"""

from __future__ import annotations

import ast
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.records import Mutation, Query, Task
from replay.history.source import syntax_nodes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tasks import Node
    from replay.explain.causes.case import Case
    from replay.explain.causes.preconditions import Lacking
    from replay.history.source import Line

_PERCEIVING: Final = ("detecting", "world-state-detecting")
_SEARCHED: Final = 2000  # records in which the plan may have run that part


def skipped(case: Case, lack: Lacking) -> tuple[Node, str, Line] | None:
    """Return the failed perception of what a motion lacked, the variable, and the line that skipped what uses it."""
    body = case.world.bodies.get(lack.subject) if case.world is not None else None
    if body is None:
        return None
    of_type = (each for each in case.motions(*_PERCEIVING) if each.parameters.get("object-type") == body.type)
    motion = next(of_type, None)
    if motion is None or not motion.failed:
        return None
    for line in case.source.call_stack(motion.started):
        for function, name in sorted(case.names_in([line], ast.Store)):
            for head, last in _heads(case, line, function, name):
                if not _ran(case, motion, head, last):
                    return motion, name, head
    return None


def _heads(case: Case, line: Line, function: str, name: str) -> Iterator[tuple[Line, int]]:
    """Yield the lines after one that decide by a variable what is done with it, and the last line of each body."""
    for node in syntax_nodes(case.source.text(line.file)):
        if not isinstance(node, ast.For | ast.While | ast.If) or node.lineno <= line.number:
            continue
        head = case.source.line(line.file, node.lineno)
        decided = node.iter if isinstance(node, ast.For) else node.test
        used = {name, *(_names(node.target) if isinstance(node, ast.For) else ())}
        if head is None or head.function != function or name not in _names(decided):
            continue
        calls = [part for statement in node.body for part in ast.walk(statement) if isinstance(part, ast.Call)]
        if any(used & _names(part) for part in calls):
            yield head, node.body[-1].end_lineno or node.lineno


def _names(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _ran(case: Case, motion: Node, head: Line, last: int) -> bool:
    """Return whether a record since a motion came from a line below a head, or that can't be told."""
    records = list(islice(case.log.records((Task, Mutation, Query), motion.last_step + 1, case.began), _SEARCHED))
    if len(records) == _SEARCHED:
        return True
    stacks = (case.source.call_stack(record) for record in records)
    return any(line.file == head.file and head.number < line.number <= last for stack in stacks for line in stack)
