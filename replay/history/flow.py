"""The lines of a plan that may have made the values of a line, found in the source alone.

Names are followed to their assignments, calls to the return statements of the plan's functions, attributes and
containers to the lines that store values in them. Nothing is run.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping
from heapq import heappop, heappush
from typing import Final

from recorder.plan_lines import syntax_nodes
from replay.history.oddities import is_strong, oddities

_FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
_DECLARING: Final = (*_FUNCTIONS, ast.ClassDef, ast.Import, ast.ImportFrom)
_CHANGING: Final = ("add", "append", "clear", "extend", "insert", "pop", "popleft", "remove", "set_value", "update")
_STEP: Final = 0.75  # increase of the rank from a line to a line whose values flow into it
_PASSED: Final = 2.0  # increase of the rank of a line without numbers of its own
_LOADING: Final = 3.0  # increase of the rank of a line that loads an object
_BEFORE: Final = 2  # maximum number of statements before a line that are considered
_LAST: Final = 100.0  # increase of the rank of the line that failed
_ODD: Final = 20.0  # decrease of the rank of a line that looks like a slip
_MOST: Final = 100  # maximum number of lines that are followed
_TRIVIAL: Final = (0, 1)  # numbers that are hardly ever mistyped


class Flow:
    """The flow of values between the statements of a file."""

    def __init__(self, text: str) -> None:
        self._statements: list[tuple[ast.stmt, str]] = []  # statements by function; outer ones first
        self._made: dict[tuple[str, str], set[int]] = defaultdict(set)  # lines that set a name, by function and name
        self._returns: dict[str, set[int]] = defaultdict(set)
        self._conditions: dict[int, set[int]] = defaultdict(set)  # lines of conditions, by line of statement
        self._before: dict[int, list[int]] = {}  # for each statement's line, the lines of the statements just before it
        self._odd = {line for line, words in oddities(text).items() if is_strong(words)}
        for node in syntax_nodes(text)[:1]:
            self._visit(node, "", ())

    def _visit(self, node: ast.AST, function: str, conditions: tuple[int, ...]) -> None:
        if isinstance(node, _FUNCTIONS):
            function = node.name
            # the calls of a function make the values of its parameters
            self._made |= {(function, each.arg): set() for each in ast.walk(node.args) if isinstance(each, ast.arg)}
            for given in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
                self._returns[function].add(given.lineno)
        if isinstance(node, ast.stmt):
            self._statements.append((node, function))
            self._conditions[node.lineno] |= {*conditions}
            for name in _stored(node):
                self._made[function, name].add(node.lineno)
                self._made["", name] |= {node.lineno} if name.startswith(".") else set()
            if isinstance(node, ast.Return):
                self._returns[function].add(node.lineno)
        if isinstance(node, ast.If | ast.While):
            conditions = (*conditions, node.lineno)
        for _, block in ast.iter_fields(node):
            statements = [each for each in block if isinstance(each, ast.stmt)] if isinstance(block, list) else []
            lines = [each.lineno for each in statements if not isinstance(each, _DECLARING)]
            self._before |= {line: lines[max(at - _BEFORE, 0) : at] for at, line in enumerate(lines)}
        for each in ast.iter_child_nodes(node):
            self._visit(each, function, conditions)

    def lines(self, starts: Mapping[int, float], failed: int = 0) -> list[int]:
        """Return the lines whose values flow into some lines, the most probable first.

        Args:
            starts: lines with their ranks.
            failed: the line that failed; it comes last, unless it has numbers of its own.
        """
        ranks: dict[int, float] = {}
        waiting = sorted((rank, line) for line, rank in starts.items())
        while waiting and len(ranks) < _MOST:
            rank, line = heappop(waiting)
            if line in ranks:
                continue
            found = next(
                (each for each in reversed(self._statements) if each[0].lineno <= line <= (each[0].end_lineno or 0)),
                None,
            )
            if found is None:
                continue
            weight = _weight(found[0])
            ranks[line] = rank + weight + _LAST * (line == failed and weight > 0)
            for source in self._sources(*found):
                if source not in ranks:
                    heappush(waiting, (rank + _STEP, source))
            before = self._before.get(found[0].lineno, ()) if line in starts else ()
            for condition in (*self._conditions[found[0].lineno], *before):
                heappush(waiting, (rank + 2 * _STEP, condition))
        functions = {function for each, function in self._statements if each.lineno in ranks}
        others = {each.lineno for each, function in self._statements if function in functions} - {*ranks}
        ranks |= dict.fromkeys(self._odd & others, 2 * _STEP)
        ranks |= {line: ranks[line] - _ODD for line in self._odd & ranks.keys()}
        return sorted(ranks, key=lambda line: ranks[line])

    def _sources(self, statement: ast.stmt, function: str) -> Iterator[int]:
        for node in _own(statement):
            loaded = isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load)
            for name in (_named(node), f"{_named(node)}[]") if loaded else ():
                yield from self._made.get((function, name), self._made.get(("", name), ()))
                yield from self._returns.get(name.removeprefix("."), ())


def _own(statement: ast.stmt) -> Iterator[ast.AST]:
    """Yield the nodes of a statement, but not the statements in it."""
    for each in ast.iter_child_nodes(statement):
        if not isinstance(each, ast.stmt):
            yield from (node for node in ast.walk(each) if not isinstance(node, ast.stmt))


def _weight(statement: ast.stmt) -> float:
    """Return how improbable a mistake in a statement is: it only passes values on, or loads an object."""
    constants = [node.value for node in _own(statement) if isinstance(node, ast.Constant)]
    numbers = [each for each in constants if isinstance(each, int | float)]
    computes = any(isinstance(node, ast.BinOp | ast.Compare) for node in _own(statement))
    own = 1.0 if computes or any(each not in _TRIVIAL for each in numbers) else 0.5 * bool(constants)
    loads = any(isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Object") for node in _own(statement))
    return _PASSED * (1 - own) + _LOADING * loads


def _stored(statement: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement makes or changes; ``.x`` stands for an attribute, ``x[]`` for the items of x."""
    for node in _own(statement):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _CHANGING:
            yield f"{_named(node.func.value)}[]"
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
            yield f"{_named(node.value)}[]" if isinstance(node, ast.Subscript) else _named(node)


def _named(node: ast.AST) -> str:
    return f".{node.attr}" if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
