"""The words about time: ``never contact(pr2, kitchen) after task:place``, ``eventually on(milk, island) within 2 s``.

A property is an expression, with words in any order about when the expression must hold::

    property := [always | never | eventually | at end] EXPRESSION [until EXPRESSION] [stays TIME] {when}
    when     := within TIME | during MOMENTS | after MOMENTS | before MOMENTS
    MOMENTS  := task:PATH | EXPRESSION

Without a word, a property means "always". Words in quotes or brackets belong to expressions.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

from recorder.properties.expressions import NUMBER, UNITS, BadProperty, PropertyExpression

ALWAYS, NEVER, EVENTUALLY, AT_END = "always", "never", "eventually", "at end"
_KINDS: Final = (ALWAYS, NEVER, EVENTUALLY, AT_END)
_SCOPES: Final = ("during", "after", "before")
_TIMES: Final = ("within", "stays")
_WORD: Final = re.compile(rf"(?<![\w.])({'|'.join((*_KINDS[:3], 'until', *_SCOPES, *_TIMES))}|at\s+end)(?!\w)")
_HIDDEN: Final = re.compile(r"""'(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*"|[()\[\]]""")
_TIME: Final = re.compile(rf"({NUMBER})\s*(\w*)")
_TASK: Final = "task:"


@dataclass(frozen=True, slots=True)
class Property:
    """A parsed property."""

    text: str
    kind: str  # "always", "never", "eventually" or "at end"
    body: PropertyExpression
    until: PropertyExpression | None = None  # for "until": the body must hold until this expression holds
    stays: float = 0.0  # time in s for which the body must hold without interruption
    within: float | None = None  # length in s of the first part of each episode, which alone counts; None: the whole
    during: Moments | None = None
    after: Moments | None = None
    before: Moments | None = None
    source: str = ""  # file and line of the property

    def __str__(self) -> str:
        return self.text

    @property
    def moments(self) -> tuple[Moments, ...]:
        """The tasks and conditions that limit the property's episodes."""
        return tuple(each for each in (self.during, self.after, self.before) if each is not None)

    @property
    def expressions(self) -> Iterator[PropertyExpression]:
        """All expressions of the property."""
        for each in (self.body, self.until, *(moments.expression for moments in self.moments)):
            if each is not None:
                yield each

    @property
    def needs_geometry(self) -> bool:
        """Whether the property is about contacts, which only the executor can measure."""
        return any(each.needs_geometry for each in self.expressions)


@dataclass(frozen=True, slots=True)
class Moments:
    """The executions of a task, or the periods in which an expression holds."""

    text: str
    task: tuple[str, ...] = ()  # names of outer tasks and the task, in small letters; outer names are optional
    expression: PropertyExpression | None = None


def parse(text: str, source: str = "") -> Property:
    """Parse a property; raise BadProperty for other texts. ``source`` is the property's file and line, for messages."""
    return _Parser(" ".join(text.split()), source).parse()


def parse_file(path: str | Path) -> list[Property]:
    """Parse a file with one property on each line, and comments after ``#``; raise BadProperty for other content."""
    file = Path(path)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise BadProperty(str(path), f"it isn't a text in UTF-8: {error}") from None
    found = []
    for number, text in enumerate(lines, 1):
        comment = f"{_hidden(text)}#".index("#")
        if line := text[:comment].strip():
            found.append(parse(line, f"{file.name}:{number}"))
    if not found:
        raise BadProperty(str(path), "it has no properties")
    return found


def _hidden(text: str) -> str:
    """Return the text in which spaces replace everything in quotes or brackets."""
    shown, depth, end = [], 0, 0
    for match in _HIDDEN.finditer(text):
        between = text[end : match.start()]
        shown.append(" " * len(between) if depth else between)
        shown.append("." * len(match[0]))
        depth = max(0, depth + {"(": 1, "[": 1, ")": -1, "]": -1}.get(match[0], 0))
        end = match.end()
    return "".join((*shown, " " * len(text[end:]) if depth else text[end:]))


class _Parser:
    def __init__(self, text: str, source: str) -> None:
        self._text, self._source = text, source
        self._found: dict[str, str] = {}

    def _refuse(self, cause: str) -> NoReturn:
        raise BadProperty(self._text, cause, self._source)

    def parse(self) -> Property:
        words = list(_WORD.finditer(_hidden(self._text)))
        ends = [*(word.start() for word in words[1:]), len(self._text)]
        body = self._text[: words[0].start() if words else None].strip(" ,")
        for word, end in zip(words, ends, strict=bool(words)):
            name = " ".join(word[0].split())
            if name in self._found:
                self._refuse(f"the word {name!r} occurs twice")
            self._found[name] = self._text[word.end() : end].strip(" ,")
        kinds = [each for each in _KINDS if each in self._found]
        if len(kinds) > 1:
            self._refuse(f"{kinds[0]!r} and {kinds[1]!r} can't be combined")
        kind = kinds[0] if kinds else ALWAYS
        stated = self._found.pop(kind, "")
        if body and stated:
            self._refuse(f"two expressions, {body!r} and {stated!r}; join them with 'and', or write two properties")
        if not body and not stated:
            self._refuse("it has no expression, such as milk.z > 0.5")
        until = self._expression("until")
        stays, within = self._time("stays") or 0.0, self._time("within")
        if until is not None and (kind != ALWAYS or stays):
            self._refuse(f"'until' and {'stays' if stays else kind!r} can't be combined")
        scopes = {name: self._moments(name) for name in _SCOPES if name in self._found}
        expression = PropertyExpression(body or stated, self._source)
        return Property(self._text, kind, expression, until, stays, within, **scopes, source=self._source)

    def _expression(self, word: str) -> PropertyExpression | None:
        if word not in self._found:
            return None
        if not self._found[word]:
            self._refuse(f"an expression is missing after {word!r}")
        return PropertyExpression(self._found[word], self._source)

    def _moments(self, word: str) -> Moments:
        text = self._found[word]
        if not text.startswith(_TASK):
            return Moments(text, expression=self._expression(word))
        path = text.removeprefix(_TASK).strip("'\"/ ")
        if not path:
            self._refuse(f"the name of a task is missing after {word} task:")
        return Moments(text, tuple(path.casefold().split("/")))

    def _time(self, word: str) -> float | None:
        if word not in self._found:
            return None
        match = _TIME.fullmatch(self._found[word])
        size, kind = UNITS.get(match[2] or "s", (0.0, "")) if match is not None else (0.0, "")
        if match is None or kind != "s":
            self._refuse(f"a time such as 2 s must follow {word!r}, not {self._found[word]!r}")
        return float(match[1]) * size
