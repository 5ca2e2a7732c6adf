"""The line of a call stack that decides: helpers such as ``do(**slots)`` only pass arguments of their callers on."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from functools import lru_cache
from linecache import getlines


def deciding(lines: Sequence[tuple[str, int]], text_of: Callable[[str], str] | None = None) -> int:
    """Return the index of the first line that chooses arguments; 0 if all lines only pass arguments on.

    ``lines`` has files and line numbers, innermost line first. ``text_of`` returns a file's text, by default from disk.
    """
    read = text_of or (lambda file: "".join(getlines(file)))
    return next((at for at, (file, number) in enumerate(lines) if not passes_on(read(file), number)), 0)


@lru_cache(maxsize=256)
def passes_on(text: str, number: int) -> bool:
    """Return whether a line only passes unnamed parameters of its function to another call."""
    nodes = syntax_nodes(text)
    around = [node for node in nodes if isinstance(node, ast.stmt) and node.lineno <= number <= (node.end_lineno or 0)]
    functions = [node for node in around if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    if not functions or isinstance(around[-1], ast.FunctionDef | ast.AsyncFunctionDef | ast.Raise):
        return False
    given = functions[-1].args
    own = {each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg) if each}
    calls = [node for node in ast.walk(around[-1]) if isinstance(node, ast.Call)]
    passed = [argument for call in calls for argument in [*call.args, *call.keywords]]
    return bool(passed) and all(_is_passed(each, own) for each in passed)


@lru_cache(maxsize=8)
def syntax_nodes(text: str) -> tuple[ast.AST, ...]:
    """Return the nodes of a text's syntax tree, outer nodes first; none if the text isn't Python."""
    try:
        return tuple(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError, RecursionError):
        return ()


def last_name(node: ast.AST | None) -> str:
    """Return the last name of an expression, such as ``door`` of ``self.door``; "" without a name."""
    return str(getattr(node, "attr", getattr(node, "id", "")))


def called_name(node: ast.AST) -> str:
    """Return the name of the called function or method; "" if the node isn't a call."""
    return last_name(node.func) if isinstance(node, ast.Call) else ""


def written_number(node: ast.AST) -> int | float | None:
    """Return the number of a constant; None for another node."""
    value = node.value if isinstance(node, ast.Constant) else None
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def stored(node: ast.AST) -> set[str]:
    """Return the variables that a syntax node assigns."""
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}


def _is_passed(argument: ast.AST, own: set[str]) -> bool:
    match argument:
        case ast.Starred(value=value) | ast.keyword(arg=None, value=value):
            return isinstance(value, ast.Name) and value.id in own
        case ast.Name(id=name):
            return name in own
    return isinstance(argument, ast.Call)  # the arguments of the inner call must be checked, too
