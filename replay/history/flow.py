"""Find in the source of a plan the lines that may have made the values of a line.

A name leads to its assignments, a call to the return statements of the plan's function. An attribute or a container
leads to the lines that store values in it. Nothing is run.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from heapq import heappop, heappush
from typing import Final

from recorder.plan_lines import called_name, syntax_nodes, written_number
from replay.history.line_forms import line_ranks, own_nodes
from replay.history.oddities import CHANGING, DECLARING, FUNCTIONS, is_strong, oddities

_LEAVING: Final = ast.Continue | ast.Break | ast.Return | ast.Raise
_STORING: Final = (*CHANGING, "set_value")
_STEP: Final = 0.01  # increase of the rank from a line to a line whose values flow into it
_CONDITION: Final = 1.1  # increase of the rank from a line to a condition, or to a statement before it
_START: Final = -1.5  # rank of a line that was given
_COMPUTING: Final = -1.9  # added if such a line has numbers or operators
_FAILED: Final = 1.0  # added for the line that failed
_BEFORE: Final = 2  # maximum number of statements before a line that are considered
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
        self._forms = line_ranks(text)
        for node in syntax_nodes(text)[:1]:
            self._visit(node, "", ())

    def _visit(self, node: ast.AST, function: str, conditions: tuple[int, ...]) -> None:
        if isinstance(node, FUNCTIONS):
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
        guards: dict[ast.AST, tuple[int, ...]] = {}
        for _, block in ast.iter_fields(node):
            statements = [each for each in block if isinstance(each, ast.stmt)] if isinstance(block, list) else []
            lines = [each.lineno for each in statements if not isinstance(each, DECLARING) and not _is_idle(each)]
            self._before |= {line: lines[max(at - _BEFORE, 0) : at] for at, line in enumerate(lines)}
            guards |= _guards(statements)
        for child in ast.iter_child_nodes(node):
            self._visit(child, function, (*conditions, *guards.get(child, ())))

    def lines(self, starts: Mapping[int, float], failed: int = 0) -> list[int]:
        """Return the lines whose values flow into some lines, the most probable first.

        Args:
            starts: lines with their ranks.
            failed: the line that failed.
        """
        ranks: dict[int, float] = {}
        waiting = sorted((rank, line) for line, rank in starts.items())
        while waiting and len(ranks) < _MOST:
            rank, line = heappop(waiting)
            if line in ranks:
                continue
            inner = reversed(self._statements)
            found = next((each for each in inner if each[0].lineno <= line <= (each[0].end_lineno or 0)), None)
            if found is None or (_is_idle(found[0]) and line not in starts):
                continue
            parts = [*own_nodes(found[0])]
            computes = any(isinstance(node, ast.BinOp | ast.USub) for node in parts)
            computes |= any(written_number(node) not in (None, *_TRIVIAL) for node in parts)
            given = _START + _COMPUTING * computes if line in starts else 0.0
            ranks[line] = rank + self._forms.get(line, 0.0) + given + _FAILED * (line == failed)
            for source in self._sources(*found):
                if source not in ranks:
                    heappush(waiting, (rank + _STEP, source))
            before = self._before.get(found[0].lineno, ()) if line in starts else ()
            for condition in (*self._conditions[found[0].lineno], *before):
                heappush(waiting, (rank + _CONDITION, condition))
        functions = {function for each, function in self._statements if each.lineno in ranks}
        others = {each.lineno for each, function in self._statements if function in functions} - {*ranks}
        ranks |= dict.fromkeys(self._odd & others, 0.0)
        ranks |= {line: ranks[line] - _ODD for line in self._odd & ranks.keys()}
        return sorted(ranks, key=lambda line: ranks[line])

    def _sources(self, statement: ast.stmt, function: str) -> Iterator[int]:
        for node in own_nodes(statement):
            loaded = isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load)
            for name in (_named(node), f"{_named(node)}[]") if loaded else ():
                yield from self._made.get((function, name), self._made.get(("", name), ()))
                yield from self._returns.get(name.removeprefix("."), ())


def _guards(block: Sequence[ast.stmt]) -> dict[ast.AST, tuple[int, ...]]:
    """Return for each statement of a block the lines of conditions before it that may leave the block."""
    leaving = [each for each in block if isinstance(each, ast.If) and isinstance(each.body[-1], _LEAVING)]
    return {each: tuple(guard.lineno for guard in leaving if guard.lineno < each.lineno) for each in block}


def _is_idle(statement: ast.stmt) -> bool:
    """Return whether no value flows out of a statement: a docstring, a print, or an assertion that held."""
    alone = statement.value if isinstance(statement, ast.Expr) else statement
    return isinstance(alone, ast.Constant | ast.Assert) or called_name(alone) == "print"


def _stored(statement: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement makes or changes; ``.x`` stands for an attribute, ``x[]`` for the items of x."""
    for node in own_nodes(statement):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _STORING:
            yield f"{_named(node.func.value)}[]"
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
            yield f"{_named(node.value)}[]" if isinstance(node, ast.Subscript) else _named(node)


def _named(node: ast.AST) -> str:
    return f".{node.attr}" if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
