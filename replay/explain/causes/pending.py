"""What a part of a plan was doing when it was stopped: what it waited for, its values, and who could have helped."""

from __future__ import annotations

import ast
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from recorder.records import Fluent, Refusal, Task, from_json
from recorder.tasks import State, Tree
from replay.explain.causes.case import objects_in
from replay.explain.causes.cause import Fulfiller, Pending
from replay.history.source import syntax_nodes

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.records import Plain
    from recorder.tasks import Node
    from replay.explain.causes.case import Case

_NO_LEAF: Final = "timeout"  # the only parameter of a wait that isn't one of its fluents
_MAX_CHANGES: Final = 5
_MAX_TASKS: Final = 10_000
_SETTERS: Final = ("set_value", "pulse")


def subtree(case: Case, start: int, stop: int) -> Tree:
    """Return the tasks of some steps; of very many the last ones."""
    tree = Tree(limit=_MAX_TASKS)
    for record in case.log.records(Task, start, stop):
        tree.apply(record)
    return tree


def stopped(tree: Tree, root: Node | None = None) -> list[Node]:
    """Return the innermost tasks that were cancelled or never ended, of a tree or below one of its tasks."""
    nodes = [node for _, node in (root.walk() if root is not None else tree.walk())]

    def is_open(node: Node) -> bool:
        return node is not root and node.status in (State.CANCELLED, State.RUNNING, State.CREATED)

    return [node for node in nodes if is_open(node) and not any(is_open(child) for child in node.children)]


def pending(case: Case, node: Node, tree: Tree, step: int) -> Pending:
    """Return what a task was doing at a step; the tree has what ran beside it."""
    line = case.line_of(node.asked or node.started)
    motion = node.motion if node.motion.kind == "motion" else node
    if node.kind == "wait":
        leaves = {name: value for name, value in node.parameters.items() if name != _NO_LEAF}
        values, changed = _values(case, leaves, node.started.seq, step)
        return Pending(node, True, line, values, changed, tuple(_fulfillers(case, leaves, tree, step)))
    inner = [child for child in node.children if child.kind == "process-module"]
    if motion.kind != "motion" or inner or node.kind == "process-module":
        return Pending(node, node.start is not None, line)
    others = [each for _, each in tree.walk() if each.kind == "motion" and each is not motion]
    holders = tuple(each for each in others if _ran(each, node, step))
    return Pending(node, False, line, holders=holders)


def steps_of(pending: Pending) -> Iterator[int]:
    """Yield the steps on which it rests."""
    yield pending.task.started.seq
    yield from pending.changed
    for each in pending.fulfillers:
        if each.step is not None:
            yield each.step
        yield from (task.last_step for task in (each.task, each.failed) if task is not None)
        if each.refused is not None:
            yield each.refused.seq


def _ran(motion: Node, waiting: Node, step: int) -> bool:
    begun = any(child.kind == "process-module" for child in motion.children)
    return begun and motion.started.seq < step and (motion.finished is None or motion.last_step > waiting.started.seq)


def _values(case: Case, leaves: Mapping[str, Plain], start: int, step: int) -> tuple[dict[str, Plain], tuple[int, ...]]:
    """Return the values of fluents at a step, and the last steps since the start in which they got values."""
    values, changed = dict(leaves), []
    for record in case.log.records(Fluent, start, step + 1):
        if record.name in leaves:
            values[record.name] = from_json(record.after_json)
            changed.append(record.seq)
    return values, tuple(changed[-_MAX_CHANGES:])


def _fulfillers(case: Case, leaves: Mapping[str, Plain], tree: Tree, step: int) -> Iterator[Fulfiller]:
    """Yield what sets the fluents: by the plan's source, else by records."""
    found = False
    last = {record.name: record for record in case.log.records(Fluent, stop=step + 1) if record.name in leaves}
    for name in leaves:
        record = last.get(name)
        for file, number in _lines_that_set(case, name):
            line = case.source.line(file, number)
            task = _task_of(tree, line.function, step) if line is not None else None
            failed = _failed_in(case, task)
            done = record.seq if record is not None and task is not None and _is_in(record.task, task) else None
            found = True
            yield Fulfiller(line, task, done, failed, _refused_in(case, task, step))
    if found:
        return
    for record in last.values():
        task = tree.nodes.get(record.task)
        if not record.source:
            yield Fulfiller(case.line_of(task.started) if task is not None else None, task, record.seq)
    for name in leaves:
        failed = _failed_about(case, name, step)
        if failed is not None:
            yield Fulfiller(case.line_of(failed.started), failed, None, failed)


def _failed_about(case: Case, name: str, step: int) -> Node | None:
    """Return the last motion that failed about what the name of a fluent that follows the world names."""
    words = set(name.replace("(", " ").replace(")", " ").split())
    for motion in reversed(case.failed.motions):
        if motion.last_step <= step and motion.failed:
            given = {*objects_in(list(motion.parameters.values())), *map(str, motion.parameters.values())}
            if words & given:
                return motion
    return None


def _lines_that_set(case: Case, name: str) -> list[tuple[str, int]]:
    """Return the lines of the plan that set or pulse the fluent of a name, by its attached source."""
    return [(file, line) for file in case.source.files for line in _setters(case.source.text(file), name)]


@lru_cache(maxsize=64)
def _setters(text: str, name: str) -> tuple[int, ...]:
    """Return the numbers of the lines that set the fluent that is made with a name, by the variable that it is in."""
    nodes = syntax_nodes(text)
    variables = set()
    for node in nodes:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and _last(node.value.func) == "Fluent":
            given = [*node.value.args[1:2], *(each.value for each in node.value.keywords if each.arg == "name")]
            if any(isinstance(each, ast.Constant) and each.value == name for each in given):
                variables |= {_last(target) for target in node.targets}
    calls = (node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute))
    setters = (node for node in calls if isinstance(node.func, ast.Attribute) and node.func.attr in _SETTERS)
    return tuple(node.lineno for node in setters if _last(node.func.value) in variables)  # type: ignore[attr-defined]


def _last(node: ast.expr) -> str:
    """Return the last name of an expression: of ``self.door`` it is ``door``."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _task_of(tree: Tree, function: str, step: int) -> Node | None:
    """Return the last branch that runs a function of the plan, by its name."""
    named = [node for _, node in tree.walk() if node.kind == "branch" and node.name.rpartition(".")[2] == function]
    return next((node for node in reversed(named) if node.created.wall_ns and node.started.seq <= step), None)


def _failed_in(case: Case, task: Node | None) -> Node | None:
    """Return the last motion that failed in a task."""
    if task is None:
        return None
    inside = (motion for motion in reversed(case.failed.motions) if motion.failed)
    return next((motion for motion in inside if any(each.id == task.id for each in motion.around())), None)


def _refused_in(case: Case, task: Node | None, step: int) -> Refusal | None:
    """Return the last refusal in a task."""
    if task is None or not case.log.counts().get("refusal"):
        return None
    refusals = case.log.records(Refusal, task.started.seq, step + 1)
    return next((each for each in reversed(list(refusals)) if _is_in(each.task, task)), None)


def _is_in(number: int, task: Node) -> bool:
    return any(node.id == number for _, node in task.walk())
