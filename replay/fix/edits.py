"""Small edits of a plan, each at one place: candidates for a repair.

An edit replaces an expression by a similar expression (other unit, sign, index, operator, or name with the same role),
moves a statement, or inserts a wait. No edit removes a statement or changes an assertion, so a repair can't succeed by
dropping the plan's goal.
"""

from __future__ import annotations

import ast
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

_FACTORS: Final = (0.01, 0.001, math.pi / 180, 100.0, 0.1, 10.0)  # for wrong units and decimal points
_OPPOSITE: Final[dict[type[ast.AST], tuple[type[ast.AST], ...]]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Div,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Lt: (ast.Gt, ast.LtE),
    ast.Gt: (ast.Lt, ast.GtE),
    ast.LtE: (ast.GtE, ast.Lt),
    ast.GtE: (ast.LtE, ast.Gt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_RANGE: Final = re.compile(r"range\(1, (.+) \+ 1\)")
_FEW: Final = 2  # whole numbers up to this number are counts, not lengths
_STALE: Final = 0.6  # by how much a move of a line with stale values is likelier
_FAR: Final = 1.0  # cost of an edit that is larger than a typical mistake


@dataclass(frozen=True, slots=True, order=True)
class Edit:
    """An edited plan."""

    cost: float  # likely edits have a low cost; edits of the same kind have the same cost
    line: int  # number of the edited line
    what: str  # the edit, in words
    text: str  # the whole edited source
    asks: bool = False  # whether a value or name changes, rather than how values are computed


class Editor:
    """Edits one source file."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._source = text.encode()  # the syntax tree counts bytes
        self._lines = [line.decode() for line in self._source.splitlines(keepends=True)]
        self._tree = ast.parse(text)
        self._strings: dict[str, set[str]] = defaultdict(set)  # string constants by their role
        self._names: dict[str, set[str]] = defaultdict(set)  # variables by the call that returned their value
        self._goals: set[ast.AST] = set()  # the expressions of assertions, which stay unchanged
        self._counts: set[ast.AST] = set()  # expressions that count or number something, such as indices
        self._scene: set[ast.AST] = set()  # arguments of loaded objects; which objects there are stays unchanged
        self._checks: set[str] = set()  # functions with assertions
        for node in ast.walk(self._tree):
            self._protect(node)
            self._note_roles(node)

    def _protect(self, node: ast.AST) -> None:
        """Note the expressions that keep their value, and the numbers that count something."""
        if isinstance(node, ast.Subscript | ast.BinOp | ast.Compare | ast.Slice):
            self._counts |= {*ast.iter_child_nodes(node)}
        if isinstance(node, ast.Call):
            self._counts |= {*node.args} if ast.unparse(node.func) in ("range", "enumerate") else set()
            self._scene |= {*ast.walk(node)} if ast.unparse(node.func).endswith("Object") else set()
        if isinstance(node, ast.Dict) and len({ast.dump(key) for key in node.keys if key}) == len(node.keys):
            self._scene |= {*filter(None, node.keys)}  # a key that stands there twice may be wrong
        if _asserts(node):
            self._goals |= {*ast.walk(node)}
        if isinstance(node, ast.If) and any(map(_asserts, (*node.body, *node.orelse))):
            self._goals |= {node, *ast.walk(node.test)}
        if isinstance(node, ast.FunctionDef) and any(map(_asserts, ast.walk(node))):
            self._checks.add(node.name)

    def _note_roles(self, node: ast.AST) -> None:
        """Note which texts and names the plan uses in the same role."""
        for role, value in _roles(node):
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                self._strings[role].add(value.value)
            if isinstance(value, ast.Name):
                self._names[role].add(value.id)
        if isinstance(node, ast.withitem) and isinstance(node.context_expr, ast.Call):
            self._names[ast.unparse(node.context_expr.func)] |= _stored(node)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            self._names[ast.unparse(node.value.func)] |= _stored(node)

    def edits(self, line: int, alternatives: Iterable[Iterable[str]] = (), *, stale: bool = False) -> Iterator[Edit]:
        """Yield the edits of a line.

        Args:
            line: its number.
            alternatives: sets of texts that can replace each other, such as arms.
            stale: whether the line has values that were true earlier, so that its statement comes too early.
        """
        sets = [set(each) for each in alternatives]
        for node in ast.walk(self._tree):
            if getattr(node, "lineno", None) != line or node in self._goals:
                continue
            for new, what, cost in (*self._values(node, sets), *_structures(node), *_shifts(node)):
                asks = isinstance(node, ast.List | ast.Tuple | ast.Constant | ast.Name)
                yield self._edit(node, new, what, cost, asks=asks)
            if isinstance(node, ast.stmt):
                yield from (replace(edit, cost=edit.cost - _STALE * stale) for edit in self._moves(node))

    def insertions(self, line: int) -> Iterator[Edit]:
        """Yield the plan with a wait before a line."""
        lines = self._lines
        indent = lines[line - 1][: len(lines[line - 1]) - len(lines[line - 1].lstrip())]
        for world in sorted(self._names["BulletWorld"])[:1]:
            for call in ("settle()", "simulate(1)"):
                text = "".join([*lines[: line - 1], f"{indent}{world}.{call}\n", *lines[line - 1 :]])
                yield Edit(_FAR, line, f"{world}.{call} before line {line}", text)

    def _values(self, node: ast.AST, sets: Sequence[set[str]]) -> Iterator[tuple[str, str, float]]:
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            value = node.value
            is_count = isinstance(value, int) and value <= _FEW and node in self._counts
            for number, factor in enumerate(_FACTORS if value and not is_count else ()):
                yield f"{value * factor:.6g}", f"{value} times {factor:.3g}", 0.3 + 0.1 * number + 0.4 * (number > 2)
            if isinstance(value, float) or node not in self._counts:
                yield f"{-value!r}", f"the sign of {value}", 0.5
            if isinstance(value, int) and node in self._counts:
                for other in (value - 1, value + 1):
                    yield repr(other), f"{other} instead of {value}", 0.45
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in self._scene:
            fitting = set[str]().union(*(each for each in (*sets, *self._strings.values()) if node.value in each))
            for text in sorted(fitting - {node.value}):
                yield repr(text), f"{text!r} instead of {node.value!r}", 0.4
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node not in self._scene:
            fitting = set[str]().union(*(each for each in self._names.values() if node.id in each))
            for name in sorted(fitting - {node.id}):
                yield name, f"{name} instead of {node.id}", 0.6

    def _moves(self, statement: ast.stmt) -> Iterator[Edit]:
        """Yield the plan with a statement moved after or before other statements of its block."""
        for block in _blocks(self._tree):
            if statement not in block or isinstance(statement, ast.Import | ast.ImportFrom | ast.FunctionDef):
                continue
            at = block.index(statement)
            for to in (at + 1, at - 1, at + 2, at - 2):
                crossed = block[min(at, to) : max(at, to) + 1]
                if 0 <= to < len(block) and not any(map(self._is_check, crossed)):
                    order = [each for each in block if each is not statement]
                    order.insert(to, statement)
                    yield self._reordered(
                        block,
                        order,
                        statement,
                        f"after line {block[to].lineno}" if to > at else f"before line {block[to].lineno}",
                    )

    def _is_check(self, statement: ast.stmt) -> bool:
        """Return whether a statement asserts something, itself or by a call."""
        names = (getattr(each, "id", "") for each in ast.walk(statement))
        return any(map(_asserts, ast.walk(statement))) or not self._checks.isdisjoint(names)

    def _reordered(self, block: Sequence[ast.stmt], order: Sequence[ast.stmt], moved: ast.stmt, where: str) -> Edit:
        lines = self._lines
        parts = {id(each): lines[each.lineno - 1 : each.end_lineno] for each in block}
        gaps = [lines[a.end_lineno or a.lineno : b.lineno - 1] for a, b in pairwise(block)]
        new = [line for each, gap in zip(order, [*gaps, []], strict=True) for line in (*parts[id(each)], *gap)]
        start, end = block[0].lineno - 1, block[-1].end_lineno or block[-1].lineno
        return Edit(0.7, moved.lineno, f"line {moved.lineno} {where}", "".join([*lines[:start], *new, *lines[end:]]))

    def _edit(self, node: ast.AST, new: str, what: str, cost: float, *, asks: bool) -> Edit:
        start, end = self._offset(node.lineno, node.col_offset), self._offset(node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]
        text = (self._source[:start] + new.encode() + self._source[end:]).decode()
        return Edit(cost, node.lineno, what, text, asks)  # type: ignore[attr-defined]

    def _offset(self, line: int, column: int) -> int:
        return len("".join(self._lines[: line - 1]).encode()) + column


def _asserts(node: ast.AST) -> bool:
    return isinstance(node, ast.Assert | ast.Raise)


def _shifts(node: ast.AST) -> Iterator[tuple[str, str, float]]:
    """Yield a range that counts from 0 instead of 1."""
    shifted = _RANGE.fullmatch(ast.unparse(node)) if isinstance(node, ast.Call) else None
    if shifted:
        yield f"range({shifted[1]})", f"range({shifted[1]}) instead of {ast.unparse(node)}", 0.4


def _structures(node: ast.AST) -> Iterator[tuple[str, str, float]]:
    """Yield other forms of an expression: operators, order of items, negation, and blocks."""
    is_whole = isinstance(node, ast.expr) and not isinstance(node, ast.Starred | ast.Slice)
    copy = ast.parse(ast.unparse(node), mode="eval").body if is_whole else None
    if isinstance(copy, ast.BinOp | ast.BoolOp):
        for kind in _OPPOSITE.get(type(copy.op), ()):
            copy.op = kind()  # type: ignore[assignment]
            yield f"({ast.unparse(copy)})", f"{ast.unparse(node)} with another operator", 0.65
    elif isinstance(copy, ast.Compare) and len(copy.ops) == 1:
        for kind in _OPPOSITE.get(type(copy.ops[0]), ()):
            copy.ops = [kind()]  # type: ignore[list-item]
            yield ast.unparse(copy), f"{ast.unparse(copy)} instead of {ast.unparse(node)}", 0.55
    elif isinstance(copy, ast.List | ast.Tuple) and 2 <= len(copy.elts) <= 4 and isinstance(copy.ctx, ast.Load):
        items = copy.elts
        orders = [[*items[1:], items[0]], [items[-1], *items[:-1]]] if len(items) == 4 else []
        orders += [[*items[:at], items[at + 1], items[at], *items[at + 2 :]] for at in range(len(items) - 1)]
        for number, order in enumerate(orders):
            copy.elts = order
            text = ast.unparse(copy)
            yield text, f"{text} instead of {ast.unparse(node)}", 0.35 if len(items) == 4 and number < 2 else 0.42
    elif isinstance(copy, ast.UnaryOp) and isinstance(copy.op, ast.Not):
        yield f"({ast.unparse(copy.operand)})", f"without not: {ast.unparse(node)}", 0.56
    elif isinstance(node, ast.Name) and node.id == "par" and isinstance(node.ctx, ast.Load):
        yield "seq", "seq instead of par", 0.57
    elif isinstance(copy, ast.Call) and any(keyword.arg == "orientation" for keyword in copy.keywords):
        copy.keywords = [keyword for keyword in copy.keywords if keyword.arg != "orientation"]
        yield ast.unparse(copy), "without orientation", _FAR


def _roles(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield expressions with their roles: the keyword or the place of an argument, the key or place in a container."""
    if isinstance(node, ast.Call):
        function = ast.unparse(node.func)
        yield from ((keyword.arg, keyword.value) for keyword in node.keywords if keyword.arg)
        yield from ((f"{function} {at}", value) for at, value in enumerate(node.args))
    elif isinstance(node, ast.Dict):
        yield from (
            (f"{{}} {key.value!r}", value)
            for key, value in zip(node.keys, node.values, strict=True)
            if isinstance(key, ast.Constant)
        )
        yield from ((f"keys of line {node.lineno}", key) for key in node.keys if key is not None)
    elif isinstance(node, ast.List | ast.Tuple):
        yield from ((f"items of line {node.lineno}", value) for value in node.elts)


def _stored(node: ast.AST) -> set[str]:
    """Return the variables that a syntax node assigns."""
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}


def _blocks(tree: ast.AST) -> Iterator[list[ast.stmt]]:
    for node in ast.walk(tree):
        for name in ("body", "orelse", "finalbody"):
            block = getattr(node, name, None)
            if isinstance(block, list) and block:
                yield block
