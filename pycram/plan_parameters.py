"""Parameters of a plan: named values that a run may set, and variations: the values that a sweep gives its runs.

A plan declares parameters with :func:`parameters`, or as arguments of its main function.
"""

from __future__ import annotations

import ast
import json
import math
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, UsageError
from recorder.errors import suggestion
from recorder.plan_lines import called_name

MAIN: Final = "main"  # this function's arguments are the parameters of the plan
ANY: Final = object()  # represents a default that isn't known until the plan runs
#: Distributions by name: the number of arguments, and a function that draws a value from them.
_DISTRIBUTIONS: Final[Mapping[str, tuple[int, Callable[..., Any]]]] = {
    "uniform": (2, lambda dice, a, b: dice.uniform(a, b)),
    "normal": (2, lambda dice, mean, deviation: dice.gauss(mean, deviation)),
    "integers": (2, lambda dice, a, b: dice.randint(a, b)),
    "choice": (0, lambda dice, *values: dice.choice(values)),
}
_CALL: Final = re.compile(r"(\w+)\s*\((.*)\)", re.DOTALL)
_WORD: Final = re.compile(r"[^()\[\]{}'\"=]+")
_EXPECTED: Final = "uniform(a,b), normal(mean,deviation), integers(first,last) or choice(a,b,...)"

_given: Mapping[str, Any] = {}


class UnknownParameter(UsageError):
    """A run sets a parameter that the plan doesn't declare."""

    def __init__(self, plan: str, name: str, declared: list[str]) -> None:
        none = "the plan declares no parameters; declare them with pycram.parameters(name=default)"
        hint = suggestion(name, declared) if declared else none
        super().__init__(f"{plan} has no parameter {name!r}; {hint}")
        self.name = name  # name of the parameter
        self.declared = declared  # names of the declared parameters


export("pycram", UnknownParameter)


def parameters(**defaults: Any) -> SimpleNamespace:
    """Return a plan's parameters: the values that this run has set, else the defaults.

    A plan writes ``speed = pycram.parameters(speed=0.5).speed``. A value must have the type of its default, unless the
    default is None.

    Raises:
        BadArgument: A value has another type than its default.
    """
    return SimpleNamespace(**{name: fitting(name, _given.get(name, value), value) for name, value in defaults.items()})


@contextmanager
def giving(values: Mapping[str, Any]) -> Iterator[None]:
    """Set parameters of the plan that runs in the ``with`` block."""
    global _given  # noqa: PLW0603  a process runs one plan
    before, _given = _given, dict(values)
    try:
        yield
    finally:
        _given = before


def fitting(name: str, value: Any, default: Any) -> Any:
    """Convert a parameter's value to the type of its default; raise BadArgument if the value has another type."""
    if default is None or default is ANY or type(value) is type(default):
        return value
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(default, str) and isinstance(value, int | float):  # a text that looks like a number
        return str(value)
    if isinstance(default, tuple) and isinstance(value, list):
        return tuple(value)
    raise BadArgument(name, value, f"a value of type {type(default).__name__}, because the default is {default!r}")


def declared_in(plan: Path) -> dict[str, Any] | None:
    """Return the defaults of the parameters that a plan's file declares, by name, without running the plan.

    A default that isn't a literal is :data:`ANY`. The result is None if a call like ``parameters(**others)`` hides
    names. SyntaxError is raised if the file isn't Python.
    """
    tree = ast.parse(plan.read_bytes(), str(plan))
    found = dict(_of_main(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and called_name(node) == parameters.__name__:
            for keyword in node.keywords:
                if keyword.arg is None:
                    return None
                found[keyword.arg] = _literal(keyword.value)
    return found


def check(plan: Path, values: Mapping[str, Any]) -> None:
    """Raise UnknownParameter or BadArgument if values don't fit the parameters that a plan's file declares."""
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
    """Return the values that are arguments of the plan's main function; raise SyntaxError if the file isn't Python."""
    if not values:
        return {}
    of_main = dict(_of_main(ast.parse(plan.read_bytes(), str(plan))))
    return {name: fitting(name, value, of_main[name]) for name, value in values.items() if name in of_main}


def value_of(text: str) -> tuple[str, Any]:
    """Parse ``name=value``; the value is JSON or plain text; raise BadArgument if the text has another form."""
    name, value = split("set", text, "name=value")
    return name, parsed(value)


def split(option: str, text: str, expected: str) -> tuple[str, str]:
    """Return the name before ``=`` and the text after it; raise BadArgument with ``option`` and ``expected``."""
    name, equals, rest = text.partition("=")
    if not (equals and name.isidentifier()):
        raise BadArgument(option, text, expected)
    return name, rest


def parsed(text: str) -> Any:
    """Parse a value, which is JSON or plain text."""
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


def _literal(node: ast.expr | None) -> Any:
    try:
        return ANY if node is None else ast.literal_eval(node)
    except ValueError:
        return ANY


@dataclass(frozen=True, slots=True)
class Variations:
    """The parameters that vary between the runs of a sweep. Wrong values and distributions raise BadArgument."""

    #: Values by name. Runs take all combinations one after the other; the values of the last name change fastest.
    listed: Mapping[str, Sequence[Any]]
    #: The distributions by name, as text. A drawn value depends only on the seed, the run's number and the name.
    sampled: Mapping[str, str]

    def __post_init__(self) -> None:
        for name in self.listed.keys() & self.sampled.keys():
            raise BadArgument("sample", name, "a parameter that has no listed values")
        for name, values in self.listed.items():
            if isinstance(values, str) or not values:
                raise BadArgument(name, values, "a list of one or more values")
        for name, text in self.sampled.items():
            _distribution(name, str(text))

    def of(self, seed: int, number: int) -> dict[str, Any]:
        """Return the values of a run."""
        values: dict[str, Any] = dict.fromkeys(self.listed)
        rest = number
        for name in [*self.listed][::-1]:
            rest, index = divmod(rest, len(self.listed[name]))
            values[name] = self.listed[name][index]
        for name, text in self.sampled.items():
            kind, arguments = _distribution(name, str(text))
            dice = random.Random(f"{seed}/{number}/{name}")  # Seeds that are texts don't depend on PYTHONHASHSEED
            values[name] = _DISTRIBUTIONS[kind][1](dice, *arguments)
        return values

    def every(self) -> Iterator[dict[str, Any]]:
        """Yield combinations that together contain each listed value, and one value of each distribution."""
        drawn = self.of(0, 0)
        yield drawn
        for name, values in self.listed.items():
            yield from ({**drawn, name: value} for value in values)


def listed(text: str) -> tuple[str, list[Any]]:
    """Parse ``name=1,2,3``: JSON or plain texts, with quotes or brackets around commas; else raise BadArgument."""
    expected = "name=value or name=value,value,..."
    name, values = split("set", text, expected)
    if not values:
        raise BadArgument("set", text, expected)
    try:
        whole: list[Any] = json.loads(f"[{values}]")
    except ValueError:
        return name, [parsed(part) for part in values.split(",")]
    return name, whole


def sampled(text: str) -> tuple[str, str]:
    """Parse ``name=uniform(a,b)``; raise BadArgument if the text has another form."""
    name, distribution = split("sample", text, f"name={_EXPECTED}")
    _distribution(name, distribution)
    return name, distribution


@lru_cache  # cached, because a sweep draws the values for the name of each recording
def _distribution(name: str, text: str) -> tuple[str, list[Any]]:
    call = _CALL.fullmatch(text.strip())
    if call is None:
        raise BadArgument(name, text, _EXPECTED)
    kind, values = call.groups()
    if kind not in _DISTRIBUTIONS:
        raise BadArgument(name, text, f"a distribution; {suggestion(kind, _DISTRIBUTIONS)}")
    try:
        arguments = list(ast.literal_eval(f"({values},)"))
    except (SyntaxError, ValueError):  # the arguments are texts without quotes, such as choice(cup.stl,bowl.stl)
        words = [each.strip() for each in values.split(",")]
        if not all(map(_WORD.fullmatch, words)):
            raise BadArgument(name, text, _EXPECTED) from None
        arguments = list(map(parsed, words))
    count = _DISTRIBUTIONS[kind][0]
    numbers = all(isinstance(each, int | float) and math.isfinite(each) for each in arguments)
    whole = kind != "integers" or (all(isinstance(each, int) for each in arguments) and arguments == sorted(arguments))
    if (count and (len(arguments) != count or not numbers)) or not arguments or not whole:
        raise BadArgument(name, text, _EXPECTED)
    return kind, arguments
