"""What the runs of a sweep are given: values of the plan's parameters, by the number of the run."""

from __future__ import annotations

import ast
import json
import math
import random
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import BadArgument
from pycram.plan_parameters import parsed, split
from recorder.suggestions import suggestion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

#: Distributions by name: how many numbers each takes, and how it draws.
_DISTRIBUTIONS: Final[Mapping[str, tuple[int, Callable[..., Any]]]] = {
    "uniform": (2, lambda dice, a, b: dice.uniform(a, b)),
    "normal": (2, lambda dice, mean, deviation: dice.gauss(mean, deviation)),
    "integers": (2, lambda dice, a, b: dice.randint(a, b)),
    "choice": (0, lambda dice, *values: dice.choice(values)),
}
_CALL: Final = re.compile(r"(\w+)\s*\((.*)\)", re.DOTALL)
_WORD: Final = re.compile(r"[^()\[\]{}'\"=]+")
_EXPECTED: Final = "uniform(a,b), normal(mean,deviation), integers(first,last) or choice(a,b,...)"


@dataclass(frozen=True, slots=True)
class Variations:
    """How parameters vary from run to run.

    Args:
        listed: Values by name; runs take all combinations in turn, the last name's values changing fastest.
        sampled: Distributions by name, as text; a value depends on the seed, the run's number and the name only.

    Raises:
        BadArgument: A parameter has no values, is given twice, or a distribution is none.
    """

    listed: Mapping[str, Sequence[Any]]
    sampled: Mapping[str, str]

    def __post_init__(self) -> None:
        for name in self.listed.keys() & self.sampled.keys():
            raise BadArgument("sample", name, "a parameter that has no listed values")
        for name, values in self.listed.items():
            if isinstance(values, str) or not values:
                raise BadArgument(name, values, "a list of one or more values")
        for name, text in self.sampled.items():
            _parse(name, text)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that vary."""
        return (*self.listed, *self.sampled)

    def of(self, seed: int, number: int) -> dict[str, Any]:
        """Return the values of a run."""
        values: dict[str, Any] = dict.fromkeys(self.listed)
        rest = number
        for name in [*self.listed][::-1]:
            rest, index = divmod(rest, len(self.listed[name]))
            values[name] = self.listed[name][index]
        for name, text in self.sampled.items():
            kind, arguments = _parse(name, text)
            dice = random.Random(f"{seed}/{number}/{name}")  # a text's own hash, whatever PYTHONHASHSEED
            values[name] = _DISTRIBUTIONS[kind][1](dice, *arguments)
        return values

    def every(self) -> Iterator[dict[str, Any]]:
        """Yield values with each of the listed ones in some, and one of each distribution."""
        drawn = self.of(0, 0)
        yield drawn
        for name, values in self.listed.items():
            yield from ({**drawn, name: value} for value in values)


def listed(text: str) -> tuple[str, list[Any]]:
    """Parse ``name=1,2,3``: values are JSON, or else texts; those with commas stand in brackets or quotes.

    Raises:
        BadArgument: It isn't that.
    """
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
    """Parse ``name=uniform(a,b)``.

    Raises:
        BadArgument: It isn't that.
    """
    name, distribution = split("sample", text, f"name={_EXPECTED}")
    _parse(name, distribution)
    return name, distribution


def _parse(name: str, text: object) -> tuple[str, list[Any]]:
    return _distribution(name, str(text))


@lru_cache  # each run's name has its values
def _distribution(name: str, text: str) -> tuple[str, list[Any]]:
    call = _CALL.fullmatch(text.strip())
    if call is None:
        raise BadArgument(name, text, _EXPECTED)
    kind, values = call.groups()
    if kind not in _DISTRIBUTIONS:
        raise BadArgument(name, text, f"a distribution; {suggestion(kind, _DISTRIBUTIONS)}")
    try:
        arguments = list(ast.literal_eval(f"({values},)"))
    except (SyntaxError, ValueError):  # choice(cup.stl,bowl.stl): texts without quotes
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
