"""Cells of tables: labels, JSON, the parameters of runs."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from recorder.records import from_json, to_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.records import Argument, Event, Fluent, Mutation, Query, Refusal, Run, Task

_OBJECT: Final = re.compile(r'\{"object":"((?:[^"\\]|\\.)*)","world":"(?:[^"\\]|\\.)*"\}')
_OPTION: Final = re.compile(r"--([A-Za-z][\w-]*)(?:=(.*))?", re.DOTALL)
_MAX_NAMED: Final = 3  # objects in a label


def parameters(start: Run) -> list[tuple[str, str]]:
    """Return what a run was given: a sweep's parameters, else options of its arguments."""
    given = {each.name: each.value_json for each in start.parameters}
    return list((given or _options(start.arguments)).items())


def _options(arguments: Sequence[str]) -> Mapping[str, str]:
    """Return the options among arguments, as ``--arm left`` or ``--arm=left``, their values as JSON."""
    found: dict[str, str] = {}
    for at, argument in enumerate(arguments):
        option = _OPTION.fullmatch(argument)
        if option is None:
            continue
        following = arguments[at + 1] if at + 1 < len(arguments) else "--"
        value = option[2] if option[2] is not None else None if following.startswith("--") else following
        found[option[1]] = "true" if value is None else to_json(from_json(value))
    return found


def json_of(arguments: Sequence[Argument]) -> str:
    """Return named values as one JSON object; "" if there are none."""
    if not arguments:
        return ""
    return "{" + ",".join([f"{_key(each.name)}:{each.json or 'null'}" for each in arguments]) + "}"


@lru_cache(maxsize=10_000)
def _key(name: str) -> str:
    return json.dumps(name)


def label(name: str, arguments: Sequence[Argument]) -> str:
    """Return a name with the objects among the values that it was given, else with the type that it looks for."""
    found: dict[str, None] = {}
    for argument in arguments:
        if '{"object":' in argument.json:
            found |= dict.fromkeys(_OBJECT.findall(argument.json))
    if not found:
        named = next((each.json for each in arguments if each.name == "object" and each.json.startswith('"')), "")
        found = {named[1:-1]: None} if named else {}
    return f"{name}({', '.join(list(found)[:_MAX_NAMED])})" if found else name


def source(record: Task | Query | Mutation | Event | Fluent | Refusal) -> str:
    """Return the plan's line that a record is from, as `file:line`; "" if none is known."""
    return f"{record.source_file}:{record.source_line}" if record.source_file else ""
