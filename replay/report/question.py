"""Questions for ``ask``: ``visible(milk, wide_stereo_optical_frame)``.

A question is a call of a query with names, strings, numbers, lists and keyword arguments. Python parses the question,
but never executes it. A name is an object, the robot or a frame. The text of a recorded query can also be asked as a
question.
"""

from __future__ import annotations

import ast
import json
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from keyword import iskeyword
from typing import Final, TypeAlias

from recorder.records import Plain, Query
from replay.errors import ReplayError


@dataclass(frozen=True, slots=True)
class Name:
    """A name without quotes. Only the last part of a dotted name counts: ``BulletWorld.robot`` is the robot."""

    text: str


_QUOTED: Final = re.compile(r"""\s*('(?:[^'\\\n]|\\.)+'|"(?:[^"\\\n]|\\.)+")\s*""")
_LITERALS: Final[Mapping[str, bool | None]] = {"true": True, "false": False, "null": None}

Term: TypeAlias = "Name | str | float | int | bool | list[Term] | None"


@dataclass(frozen=True, slots=True)
class QueryCall:
    """A call of a query, with positional and keyword arguments."""

    query: str
    arguments: tuple[Term, ...] = ()
    keywords: Mapping[str, Term] = field(default_factory=dict)

    def __str__(self) -> str:
        terms = [_text(term) for term in self.arguments]
        terms += [f"{name}={_text(term)}" for name, term in self.keywords.items()]
        return f"{self.query}({', '.join(terms)})"


class BadQuestion(ReplayError):
    """A question has errors, or the world of the step can't answer it."""

    def __init__(self, question: str, cause: str) -> None:
        super().__init__(question, cause)
        self.cause = cause


def question_of(record: Query) -> QueryCall:
    """Return a recorded query as a question with named arguments. Unreadable arguments raise BadQuestion."""
    try:
        arguments = {argument.name: _recorded(json.loads(argument.json)) for argument in record.arguments}
    except ValueError as error:
        raise BadQuestion(f"step {record.seq}", f"its arguments can't be decoded: {error}") from error
    return QueryCall(record.name, (), {name: term for name, term in arguments.items() if term is not None})


def _recorded(value: Plain) -> Term:
    if isinstance(value, dict):
        return Name(str(value.get("object", "")))
    return [_recorded(item) for item in value] if isinstance(value, list) else value


def parse(text: str) -> QueryCall:
    """Parse a question such as ``visible(milk, [0.5, 0.6, 1.5], threshold=0.5)``; raise BadQuestion for other texts."""
    try:
        with warnings.catch_warnings(action="ignore"):  # the parser warns about texts that look like mistakes in code
            call = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        cause = error.msg.partition(". ")[0] if isinstance(error, SyntaxError) else str(error)
        quotes = "; put names with spaces into quotes: stable('milk carton')" if re.search(r"\w \w", text) else ""
        raise BadQuestion(text, f"it can't be parsed: {cause}{quotes}") from None
    if not isinstance(call, ast.Call):
        raise BadQuestion(text, "a question is the call of a query, such as stable(milk)")
    try:
        query = _identifier(call.func)
        arguments = tuple(_term(node) for node in call.args)
        keywords = {str(keyword.arg): _term(keyword.value) for keyword in call.keywords if keyword.arg is not None}
    except (ReplayError, RecursionError) as error:
        cause = str(error) or "it is nested too deeply"
        raise BadQuestion(text, f"{cause}; arguments are names, strings, numbers and lists") from None
    if any(keyword.arg is None for keyword in call.keywords):
        raise BadQuestion(text, "** can't be used here")
    if len(keywords) < len(call.keywords):
        raise BadQuestion(text, "the question has an argument twice")
    return QueryCall(query, arguments, keywords)


def _term(node: ast.expr) -> Term:
    """Return an argument; raise ReplayError for other expressions."""
    if isinstance(node, ast.Name) and node.id in _LITERALS:
        return _LITERALS[node.id]
    if isinstance(node, ast.Name | ast.Attribute):
        return Name(_identifier(node))
    if isinstance(node, ast.List | ast.Tuple):
        return [_term(item) for item in node.elts]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        number = _term(node.operand)
        if isinstance(number, int | float) and not isinstance(number, bool):
            return -number if isinstance(node.op, ast.USub) else number
    if isinstance(node, ast.Constant) and (node.value is None or isinstance(node.value, bool | int | float | str)):
        return node.value
    raise ReplayError(f"{ast.unparse(node)} can't be an argument (put a name that isn't an identifier into quotes)")


def _identifier(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        _identifier(node.value)
        return node.attr
    if isinstance(node, ast.Name):
        return node.id
    raise ReplayError(f"{ast.unparse(node)} isn't a name")


def written(name: str) -> str:
    """Return a name in the form that commands accept. A name that isn't an identifier has quotes, as in Python."""
    return name if name.isidentifier() and not iskeyword(name) and name not in _LITERALS else repr(name)


def unquoted(text: str) -> tuple[str, str]:
    """Return the quoted name at the start of a text ("" if there is none), and the rest of the text."""
    found = _QUOTED.match(text)
    return ("", text) if found is None else (str(ast.literal_eval(found[0].strip())), text[found.end() :])


def _text(term: Term) -> str:
    if isinstance(term, Name):
        return written(term.text)
    return f"[{', '.join(map(_text, term))}]" if isinstance(term, list) else repr(term)
