"""Render results as JSON data, and as sections of lines.

Records, tasks, lines of the plan and dataclasses have the same form in all results. A module registers a rule with
:func:`data` for a class whose JSON keys differ from its fields. Users of verbs depend on these keys.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import singledispatch

from google.protobuf.message import Message

from recorder.tasks import Node
from replay.history.source import Line
from replay.state.json_data import message_data, record_data


@singledispatch
def data(value: object) -> object:
    """Return a value as JSON data."""
    if is_dataclass(value) and not isinstance(value, type):
        return fields_data(value)
    if isinstance(value, tuple | list):
        return [data(item) for item in value]
    return {key: data(item) for key, item in value.items()} if isinstance(value, Mapping) else value


def fields_data(value: object, **keys: str) -> dict[str, object]:
    """Return the fields of a dataclass in order. ``keys`` contains new names of fields."""
    return {
        keys.get(each.name, each.name): data(getattr(value, each.name))
        for each in fields(value)  # type: ignore[arg-type]  # a dataclass
    }


@data.register(Message)
def _(message: Message) -> object:
    return record_data(message) if hasattr(message, "seq") else message_data(message)  # type: ignore[arg-type]


@data.register(Node)
def task_data(task: Node) -> dict[str, object]:
    """Return a task."""
    return {
        "id": task.id,
        "kind": task.kind,
        "name": task.name,
        "parameters": task.parameters,
        "steps": [task.started.seq, task.finished and task.finished.seq],
        "error": task.error,
    }


@data.register(Line)
def _(line: Line) -> dict[str, object]:
    return {"file": line.file, "line": line.number, "function": line.function, "text": line.text}


def call_stack(stack: Sequence[Line]) -> dict[str, object]:
    """Return a call stack as data: the innermost line, and the callers."""
    lines = [data(line) for line in stack]
    return {"line": lines[-1] if lines else None, "callers": lines[:-1]}


def section(title: str, body: Iterable[str]) -> Iterator[str]:
    """Yield an empty line, a title, and the indented lines. If there are no lines, yield nothing."""
    for number, line in enumerate(body):
        if not number:
            yield from ("", title)
        yield f"  {line}"
