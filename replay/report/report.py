"""Render results as JSON data, and as sections of lines.

Records, tasks, lines of the plan and dataclasses have the same form in all results. A module registers a rule with
:func:`data` for a class whose JSON keys differ from its fields. Users of verbs depend on these keys.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache, singledispatch
from pathlib import Path
from typing import TYPE_CHECKING

from google.protobuf.message import Message

from recorder.packages import needed
from recorder.tasks import Node
from replay.errors import ReplayError
from replay.history.source import Line
from replay.state.json_data import message_data, record_data

if TYPE_CHECKING:
    from jinja2 import Environment
    from PIL import Image


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


_QUALITY = 78  # quality of JPEG pictures, 0 to 100


def page(template: str, **values: object) -> str:
    """Return a page made from a template."""
    return _templates().get_template(template).render(values)


@cache
def _templates() -> Environment:
    with needed("render"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415  an extra

    folder = FileSystemLoader(Path(__file__).parent / "templates")
    return Environment(loader=folder, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def embedded(picture: Image.Image) -> str:
    """Return a picture as a data URL (JPEG)."""
    file = io.BytesIO()
    picture.convert("RGB").save(file, "JPEG", quality=_QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def write(file: str, content: bytes) -> None:
    """Write a file; raise ReplayError if the page can't be written."""
    try:
        Path(file).write_bytes(content)
    except OSError as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error
