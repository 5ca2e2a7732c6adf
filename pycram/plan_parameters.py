"""Parameters of a plan: named values that it declares with defaults, and that a run may be given others for.

A plan declares them by :func:`parameters`, or as arguments of its main function. Run alone, it has the defaults.
"""

from __future__ import annotations

import ast
import json
from contextlib import contextmanager
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import BadArgument, UsageError
from pycram.foundation.names import export
from recorder.errors import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

MAIN: Final = "main"  # the function whose arguments are parameters
ANY: Final = object()  # a default that isn't known before the plan runs

_given: Mapping[str, Any] = {}


class UnknownParameter(UsageError):
    """A plan was given a parameter that it doesn't declare.

    Attributes:
        name: The parameter.
        declared: Those that it declares.
    """

    def __init__(self, plan: str, name: str, declared: list[str]) -> None:
        hint = suggestion(name, declared) if declared else "it declares none: pycram.parameters(name=default)"
        super().__init__(f"{plan} has no parameter {name!r}; {hint}")
        self.name = name
        self.declared = declared


export("pycram", UnknownParameter)


def parameters(**defaults: Any) -> SimpleNamespace:
    """Return a plan's parameters: what this run was given, else the defaults.

    ``speed = pycram.parameters(speed=0.5).speed``. A value has to be of its default's type; None takes any.

    Raises:
        BadArgument: A value is of another type than its default.
    """
    return SimpleNamespace(**{name: fitting(name, _given.get(name, value), value) for name, value in defaults.items()})


@contextmanager
def giving(values: Mapping[str, Any]) -> Iterator[None]:
    """Give the plan that runs in the block values of its parameters."""
    global _given  # noqa: PLW0603  a plan runs in the whole process
    before, _given = _given, dict(values)
    try:
        yield
    finally:
        _given = before


def fitting(name: str, value: Any, default: Any) -> Any:
    """Return a parameter's value as its default's type.

    Raises:
        BadArgument: It is of another type.
    """
    if default is None or default is ANY or type(value) is type(default):
        return value
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(default, str) and isinstance(value, int | float):  # a text that looks like a number
        return str(value)
    if isinstance(default, tuple) and isinstance(value, list):
        return tuple(value)
    kind = type(default).__name__
    raise BadArgument(name, value, f"a parameter of type {kind}, as its default {default!r}")


def declared_in(plan: Path) -> dict[str, Any] | None:
    """Return the defaults of the parameters that a plan's file declares, by their names; the plan doesn't run.

    Defaults that aren't literals are :data:`ANY`. Returns None where a call like ``parameters(**others)`` hides them.

    Raises:
        SyntaxError: It is no Python.
    """
    tree = ast.parse(plan.read_bytes(), str(plan))
    found = dict(_of_main(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _called(node) == parameters.__name__:
            for keyword in node.keywords:
                if keyword.arg is None:
                    return None
                found[keyword.arg] = _literal(keyword.value)
    return found


def check(plan: Path, values: Mapping[str, Any]) -> None:
    """Check values for a plan before it runs.

    Raises:
        UnknownParameter: The plan's file doesn't declare one.
        BadArgument: One has another type than its default.
    """
    if not values:
        return
    declared = declared_in(plan)
    if declared is None:
        return
    for name, value in values.items():
        if name not in declared:
            raise UnknownParameter(plan.name, name, list(declared))
        fitting(name, value, declared[name])


def arguments_of_main(plan: Path, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of the values that are arguments of the plan's main function.

    Raises:
        SyntaxError: The plan is no Python.
    """
    if not values:
        return {}
    of_main = dict(_of_main(ast.parse(plan.read_bytes(), str(plan))))
    return {name: fitting(name, value, of_main[name]) for name, value in values.items() if name in of_main}


def value_of(text: str) -> tuple[str, Any]:
    """Parse ``name=value``; a value is JSON, or else a text.

    Raises:
        BadArgument: It isn't that.
    """
    name, value = split("set", text, "name=value")
    return name, parsed(value)


def split(option: str, text: str, expected: str) -> tuple[str, str]:
    """Return the name before ``=``, and what is after it.

    Args:
        option: What the text was given as.
        text: The text.
        expected: What it has to be, for messages.

    Raises:
        BadArgument: It isn't that.
    """
    name, equals, rest = text.partition("=")
    if not (equals and name.isidentifier()):
        raise BadArgument(option, text, expected)
    return name, rest


def parsed(text: str) -> Any:
    """Return a value that is JSON, or else a text."""
    try:
        return json.loads(text)
    except ValueError:
        return {"True": True, "False": False, "None": None}.get(text, text)


def _of_main(tree: ast.Module) -> Iterator[tuple[str, Any]]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == MAIN:
            of = node.args
            places = [*of.posonlyargs, *of.args]
            lacking: list[ast.expr | None] = [None] * (len(places) - len(of.defaults))
            pairs = list(zip(places, [*lacking, *of.defaults], strict=True))[len(of.posonlyargs) :]
            pairs += zip(of.kwonlyargs, of.kw_defaults, strict=True)
            yield from ((place.arg, _literal(default)) for place, default in pairs)


def _called(node: ast.Call) -> str:
    called = node.func
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def _literal(node: ast.expr | None) -> Any:
    try:
        return ANY if node is None else ast.literal_eval(node)
    except ValueError:
        return ANY
