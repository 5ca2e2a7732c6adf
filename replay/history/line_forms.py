"""How improbable it is that a line of some form has the mistake: a rank, which the line's values and steps add to.

The numbers are weights of a logistic regression over plans with one known mistake; lower ranks are more probable.
Lines that compute have mistakes more often than lines that pass values on, load objects or perform motions.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Final

from recorder.plan_lines import called_name, syntax_nodes

_STATEMENTS: Final = ((ast.If | ast.While, -1.8), (ast.With, 1.3), (ast.For, 0.8))
_PASSING: Final = 1.8  # for lines that consist of names alone
_COMPUTING: Final = -2.4  # for lines of short functions that neither perform nor load anything
_OPERATOR: Final = 0.7
_CALLS: Final = {"perform": 1.5, "Object": 1.6, "BulletWorld": -0.7}
_WAITING: Final = 1.8, ("settle", "simulate", "park", "parking_arms")
_OTHER_CALL: Final = -0.7, ("get_object", "get_position", "get_pose", "settle", *_CALLS)  # not for these names
_SHORT: Final = 4  # maximum number of statements of a short function
_FUNCTIONS: Final = ast.FunctionDef | ast.AsyncFunctionDef
_NAMES: Final = ast.Name | ast.Attribute | ast.Tuple | ast.Starred | ast.expr_context


@lru_cache(maxsize=8)
def line_ranks(text: str) -> Mapping[int, float]:
    """Return the ranks of the lines of a source, by number. In a statement of many lines, each line counts alone."""
    nodes = syntax_nodes(text)
    functions = [node for node in nodes if isinstance(node, _FUNCTIONS)]
    own = {each.name for each in nodes if isinstance(each, _FUNCTIONS | ast.ClassDef)}
    short = [each for each in functions if len(each.body) <= _SHORT]
    short = [each for each in short if {*map(called_name, ast.walk(each))}.isdisjoint({"perform", "Object"})]
    computing = {line for each in short for line in range(each.lineno + 1, (each.end_lineno or 0) + 1)}
    ranks: dict[int, float] = {}
    for statement in nodes:  # outer statements come first
        if isinstance(statement, ast.stmt):
            parts = [*own_nodes(statement)]
            whole = hasattr(statement, "body") or statement.lineno == statement.end_lineno
            for line in range(statement.lineno, (statement.end_lineno or 0) + 1):
                at = parts if whole else [each for each in parts if getattr(each, "lineno", line) == line]
                ranks[line] = _rank(statement, at, own) + _COMPUTING * (line in computing)
    return ranks


def _rank(statement: ast.stmt, parts: list[ast.AST], own: set[str]) -> float:
    rank = sum(weight for kind, weight in _STATEMENTS if isinstance(statement, kind))
    rank += _PASSING * all(isinstance(each, _NAMES) for each in parts)
    rank += _OPERATOR * any(isinstance(each, ast.BinOp) for each in parts)
    called = {called_name(each) for each in parts} - {""}
    rank += sum(_CALLS.get(name, 0.0) for name in called) + _WAITING[0] * bool(called & {*_WAITING[1]})
    others = called - own - {*_OTHER_CALL[1]}
    return rank + _OTHER_CALL[0] * any(name[0].islower() for name in others)


def own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes in a statement or an expression, but not the statements in it."""
    for each in ast.iter_child_nodes(node):
        if not isinstance(each, ast.stmt):
            yield from (part for part in ast.walk(each) if not isinstance(part, ast.stmt))
