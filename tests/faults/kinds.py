"""Faults that are put into working plans: each kind edits one place of a plan's source.

A kind yields every place where it can be put in. What a plan's author meant is still there in all other lines, so the
edited line is the line where the fix goes: the truth against which explanations are scored.
"""

from __future__ import annotations

import ast
import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Edit = tuple[int, str]  # the line of the fault in the edited source, from 1, and that source


@dataclass(frozen=True, slots=True)
class Fault:
    """A plan with one fault."""

    kind: str
    line: int  # of the edited source, from 1
    source: str


def faults(source: str) -> list[Fault]:
    """Return every fault that some kind can put into a plan, in a fixed order."""
    return [Fault(kind, line, text) for kind, make in KINDS.items() for line, text in make(source)]


# --- edits ------------------------------------------------------------------------------------------------------------


def _replaced(source: str, node: ast.AST, text: str) -> Edit:
    """Return the source with another text in the place of a node that is on one line."""
    lines = source.splitlines(keepends=True)
    at = node.lineno - 1
    line = lines[at].encode()
    lines[at] = (line[: node.col_offset] + text.encode() + line[node.end_col_offset :]).decode()
    return node.lineno, "".join(lines)


def _edits(source: str, new: Callable[[ast.AST], Iterator[str]]) -> Iterator[Edit]:
    """Yield an edit for each node on one line for which there is another text."""
    for node in ast.walk(ast.parse(source)):
        if hasattr(node, "lineno") and node.lineno == node.end_lineno:
            for text in new(node):
                yield _replaced(source, node, text)


def _numbers(node: ast.AST, count: int) -> list[float] | None:
    """Return the numbers of a list literal of some length."""
    if not isinstance(node, ast.List) or len(node.elts) != count:
        return None
    try:
        values = ast.literal_eval(node)
    except ValueError:
        return None
    return values if all(isinstance(each, int | float) for each in values) else None


def _statements(source: str) -> Iterator[tuple[list[ast.stmt], int]]:
    """Yield each statement that isn't an import or a definition: the list that it is in, and its place in there."""
    for node in ast.walk(ast.parse(source)):
        for name in ("body", "orelse"):
            listed = getattr(node, name, None)
            for number, each in enumerate(listed if isinstance(listed, list) else ()):
                if not isinstance(each, ast.Import | ast.ImportFrom | ast.FunctionDef | ast.Pass):
                    yield listed, number


def _lines(source: str, statement: ast.stmt) -> tuple[int, int]:
    return statement.lineno - 1, statement.end_lineno or statement.lineno


def _without(source: str, wanted: Callable[[ast.stmt], bool]) -> Iterator[Edit]:
    """Yield edits that leave a statement out; the fault's line is the one that follows."""
    for listed, number in _statements(source):
        if len(listed) > 1 and wanted(listed[number]):
            lines = source.splitlines(keepends=True)
            first, last = _lines(source, listed[number])
            del lines[first:last]
            yield min(first + 1, len(lines)), "".join(lines)


def _exchanged(source: str, wanted: Callable[[ast.stmt, ast.stmt], bool]) -> Iterator[Edit]:
    """Yield edits that exchange two statements; the fault's line is that of the one that comes too early."""
    for listed, number in _statements(source):
        if number and wanted(listed[number - 1], listed[number]):
            lines = source.splitlines(keepends=True)
            (first, middle), (begin, end) = _lines(source, listed[number - 1]), _lines(source, listed[number])
            lines[first:end] = lines[begin:end] + lines[middle:begin] + lines[first:middle]
            yield first + 1, "".join(lines)


def _calls(node: ast.AST, *names: str) -> bool:
    """Return whether a function or method with one of these names is called in a node."""
    called = (each.func for each in ast.walk(node) if isinstance(each, ast.Call))
    return any(getattr(each, "attr", getattr(each, "id", "")) in names for each in called)


def _is_call(node: ast.stmt, *names: str) -> bool:
    return isinstance(node, ast.Expr) and _calls(node, *names)


# --- kinds ------------------------------------------------------------------------------------------------------------


def _unit(source: str) -> Iterator[Edit]:
    """A length in cm instead of m."""

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and 0.01 < abs(node.value) < 2:
            yield f"{node.value * 100:g}"

    return _edits(source, new)


def _frame(source: str) -> Iterator[Edit]:
    """A position relative to the robot instead of in the world."""
    bases = [numbers for node in ast.walk(ast.parse(source)) if (numbers := _numbers(node, 3)) and numbers[2] == 0]

    def new(node: ast.AST) -> Iterator[str]:
        numbers = _numbers(node, 3)
        if numbers and bases and numbers[2] > 0:
            yield str([round(a - b, 3) for a, b in zip(numbers, bases[-1], strict=True)])

    return _edits(source, new)


def _quaternion(source: str) -> Iterator[Edit]:
    """w first instead of last."""

    def new(node: ast.AST) -> Iterator[str]:
        numbers = _numbers(node, 4)
        if numbers:
            yield str([numbers[3], *numbers[:3]])

    return _edits(source, new)


def _axes(source: str) -> Iterator[Edit]:
    """x and y exchanged."""

    def new(node: ast.AST) -> Iterator[str]:
        numbers = _numbers(node, 3) or _numbers(node, 2)
        if numbers and numbers[0] != numbers[1]:
            yield str([numbers[1], numbers[0], *numbers[2:]])

    return _edits(source, new)


def _sign(source: str) -> Iterator[Edit]:
    """A wrong sign of a number, or of an operation."""

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield ast.unparse(node.operand)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
            other = copy.deepcopy(node)
            other.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
            yield ast.unparse(other)

    return _edits(source, new)


def _index(source: str) -> Iterator[Edit]:
    """An index that is off by one."""

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Constant | ast.Slice):
            yield f"{ast.unparse(node.value)}[{ast.unparse(node.slice)} - 1]"
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and node.slice.value == 0:
            yield f"{ast.unparse(node.value)}[-1]"

    return _edits(source, new)


def _arm(source: str) -> Iterator[Edit]:
    """The other arm."""
    others = {"left": "right", "right": "left"}

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Constant) and node.value in others:
            yield repr(others[node.value])

    return _edits(source, new)


def _wrong_object(source: str) -> Iterator[Edit]:
    """Another object of the scene."""
    loaded = [each for each in ast.walk(ast.parse(source)) if isinstance(each, ast.Call) and _calls(each, "Object")]
    kinds = [each.args[0].value for each in loaded if len(each.args) > 3 and isinstance(each.args[0], ast.Constant)]
    within = {each.lineno for each in loaded}

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Constant) and node.value in kinds and len(kinds) > 1 and node.lineno not in within:
            yield repr(kinds[kinds.index(node.value) - 1])
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in kinds and len(kinds) > 1:
            yield kinds[kinds.index(node.id) - 1]

    return _edits(source, new)


def _condition(source: str) -> Iterator[Edit]:
    """A comparison the wrong way round."""
    others = {
        ast.Lt: ast.Gt(),
        ast.Gt: ast.Lt(),
        ast.Eq: ast.NotEq(),
        ast.NotEq: ast.Eq(),
        ast.In: ast.NotIn(),
        ast.NotIn: ast.In(),
    }

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Compare) and type(node.ops[0]) in others:
            other = copy.deepcopy(node)
            other.ops[0] = others[type(node.ops[0])]
            yield ast.unparse(other)

    return _edits(source, new)


def _stale_read(source: str) -> Iterator[Edit]:
    """A quantity of the world that is read before the change, not after it."""
    reads = ("get_position", "get_AABB", "get_joint_position", "get_pose")
    return _exchanged(
        source, lambda one, other: isinstance(other, ast.Assign) and _calls(other, *reads) and isinstance(one, ast.Expr)
    )


def _missing_wait(source: str) -> Iterator[Edit]:
    """A wait, or the settling of the scene, that is left out."""
    return _without(source, lambda each: _is_call(each, "wait_for", "settle", "simulate"))


def _missing_step(source: str) -> Iterator[Edit]:
    """A motion that is left out."""
    return _without(source, lambda each: _is_call(each, "perform", "park", "drive", "fetch"))


def _order(source: str) -> Iterator[Edit]:
    """Two motions in the wrong order."""
    return _exchanged(
        source,
        lambda one, other: _is_call(one, "perform", "park", "fetch") and _is_call(other, "perform", "park", "deliver"),
    )


def _too_early(source: str) -> Iterator[Edit]:
    """A fluent, an event or a counter that is set before its time."""
    sets = lambda each: _is_call(each, "set_value", "shut", "append", "count") or isinstance(each, ast.AugAssign)  # noqa: E731
    return _exchanged(source, lambda one, other: sets(other) and isinstance(one, ast.Expr))


def _lost_update(source: str) -> Iterator[Edit]:
    """A counter that doesn't count."""

    def new(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add):
            yield f"{ast.unparse(node.target)} = {ast.unparse(node.value)}"
        if isinstance(node, ast.BinOp) and _calls(node.left, "get_value"):
            yield ast.unparse(node.right)

    return _edits(source, new)


def _wrong_world(source: str) -> Iterator[Edit]:
    """A second world that is opened on the way, and so is the current one."""
    for listed, number in _statements(source):
        if _calls(listed[number], "Object") and "world" in source:
            lines = source.splitlines(keepends=True)
            first, _ = _lines(source, listed[number])
            indent = " " * listed[number].col_offset
            lines.insert(first, f"{indent}spare = BulletWorld()\n")
            yield first + 1, "".join(lines)


KINDS: Final[dict[str, Callable[[str], Iterator[Edit]]]] = {
    "unit": _unit,
    "frame": _frame,
    "quaternion": _quaternion,
    "axes": _axes,
    "sign": _sign,
    "index": _index,
    "arm": _arm,
    "wrong-object": _wrong_object,
    "condition": _condition,
    "stale-read": _stale_read,
    "missing-wait": _missing_wait,
    "missing-step": _missing_step,
    "order": _order,
    "too-early": _too_early,
    "lost-update": _lost_update,
    "wrong-world": _wrong_world,
}
"""All kinds of faults in plans, by name."""
