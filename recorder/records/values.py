"""Values of users (slots, answers, results) in records as a line of JSON, and errors as ``Failure``.

An object with a method ``__record__`` is recorded as the result of this method: None, a bool, number, string, list or
dict. Values with secret names, such as ``password``, are left out.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from hashlib import sha256
from typing import Any, Final, TypeAlias

from recorder.records.log_pb2 import Argument, Failure
from recorder.records.tracebacks import MAX_ERRORS, format_traceback, result_or

MAX_NESTING: Final = 100  # readers return a value with more nested lists and dictionaries as text
MAX_CHARACTERS: Final = 8 << 20  # longer JSON isn't recorded, because readers reject records of many MiB
MAX_DIGITS: Final = 300  # integers with more digits don't fit a float; readers return such a value as text
#: Pattern for strings and brackets. A string without an end quote extends to the end of the text.
_BRACKET: Final = re.compile(r'(?s)"(?:[^"\\]|\\.)*"?|[\[{}\]]')
_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")

Plain: TypeAlias = "bool | int | float | str | list[Plain] | dict[str, Plain] | None"  # a value of JSON
Position: TypeAlias = tuple[float, float, float]


def _plain(value: object) -> object:
    record = getattr(type(value), "__record__", None)  # ``type()`` returns the real type, also of a lazy result
    if record is not None:
        return _plain(record(value))
    for kinds, plain in _PLAIN:
        if isinstance(value, kinds):
            return plain(value)
    to_list = getattr(type(value), "tolist", None)  # whether it is a NumPy array, without importing NumPy
    if to_list is not None:
        return _plain(to_list(value))
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    return {"callable": f"{module}.{name}"} if module and name else {"repr": repr(value)}


_PLAIN: tuple[tuple[Any, Callable[[Any], object]], ...] = (
    ((bool, type(None)), lambda value: value),
    (str, lambda value: value),
    (int, int),
    (float, lambda value: float(value) if math.isfinite(value) else {"float": repr(float(value))}),
    (Mapping, lambda value: {str(key): _plain(item) for key, item in value.items()}),
    (AbstractSet, lambda value: sorted((_plain(item) for item in value), key=repr)),
    ((list, tuple), lambda value: [_plain(item) for item in value]),
)


def to_json(value: object) -> str:
    """Return any value as a line of JSON. Floats keep all bits, and arrays become lists.

    An object without ``__record__`` becomes ``{"repr": ...}``. A value that raises errors or is too long becomes
    ``{"untold": type, "because": ...}``, so that recording never breaks a plan.
    """
    return result_or(
        lambda: _json(value),
        lambda error: json.dumps({"untold": type(value).__qualname__, "because": format_error(error)}),
    )


def _json(value: object) -> str:
    text = json.dumps(_plain(value), ensure_ascii=False, separators=(",", ":"))
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"it has {len(text)} characters")
    try:
        text.encode()
    except UnicodeEncodeError:  # a lone surrogate
        return json.dumps(_plain(value), separators=(",", ":"))
    return text


def arguments(values: Mapping[str, object] | Iterable[tuple[str, object]]) -> list[Argument]:
    """Return named values for a record in the given order; values of secret names are left out."""
    pairs = values.items() if isinstance(values, Mapping) else values
    named = [(str(name), value) for name, value in pairs]
    return [Argument(name=name, json=to_json(LEFT_OUT if is_secret(name) else value)) for name, value in named]


def from_json(text: str) -> Plain:
    """Return the value of recorded JSON. Text that isn't valid JSON is returned unchanged."""
    try:
        return _loaded(text)
    except ValueError:
        return text


def _loaded(text: str) -> Plain:
    """Return the value that a line of JSON contains. Other texts and values beyond our limits raise ValueError."""
    if len(text) > MAX_NESTING and text.count("[") + text.count("{") > MAX_NESTING:
        depth = 0
        for bracket in _BRACKET.findall(text):
            depth += 1 if bracket in "[{" else -1 if bracket in "]}" else 0
            if depth > MAX_NESTING:
                raise ValueError(f"it is nested more than {MAX_NESTING} deep")
    value: Plain = _DECODER.decode(text)
    return value


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"a number has {len(text)} digits")
    return int(text)


def _refuse(text: str) -> float:
    raise ValueError(f"{text} is not JSON")


_DECODER: Final = json.JSONDecoder(parse_int=_integer, parse_constant=_refuse)


def argument_values(arguments: Iterable[Argument], *, strict: bool = False) -> dict[str, Plain]:
    """Return the named values of a record. If ``strict`` is true, text that isn't JSON raises ValueError."""
    return {argument.name: _loaded(argument.json) if strict else from_json(argument.json) for argument in arguments}


def _message(error: BaseException) -> str:
    return result_or(lambda: str(error), lambda broken: f"<no message: {type(broken).__qualname__}>")


def format_error(error: BaseException) -> str:
    """Return the type of an exception, with its message if there is one."""
    text = _message(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def failure(error: BaseException, *, trace: bool = True, errors: int = MAX_ERRORS) -> Failure:
    """Return an exception for a record: type, message, ``data``, and a traceback of at most ``errors`` errors."""
    data = getattr(error, "data", None)
    text = ""
    if trace:
        with suppress(Exception):  # methods of the error may raise any error
            text = format_traceback(error, errors=errors)
    return Failure(
        type=escaped(type(error).__qualname__),
        message=escaped(_message(error)),
        data=arguments(data) if isinstance(data, Mapping) else [],
        traceback=escaped(text),
    )


def format_failure(failure: Failure) -> str:
    """Return the type of a recorded failure, with its message if there is one."""
    return f"{failure.type}: {failure.message}" if failure.message else failure.type


def format_assertion(message: str, line: str) -> str:
    """Return a text for a plan's assertion that failed: its message, or else its line of code."""
    return f"the plan's assertion doesn't hold: {message or line}"


def without_addresses(text: str) -> str:
    """Return a text without addresses of objects, because these differ in each process."""
    return _ADDRESS.sub("", text)


def escaped(text: str) -> str:
    """Return a text in which escapes replace lone surrogates, because these can't be written.

    Python uses lone surrogates for bytes that aren't UTF-8, for example in names of files.
    """
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def name_of(value: object) -> str:
    """Return the name of a recorded object, or a recorded text; "" for other values."""
    name = value.get("object") if isinstance(value, dict) else value
    return name if isinstance(name, str) else ""


def vector(value: object, length: int) -> tuple[float, ...] | None:
    """Return a recorded value as ``length`` finite numbers; None for other values."""
    if not isinstance(value, list | tuple) or len(value) != length:
        return None
    finite = all(isinstance(number, int | float) and math.isfinite(number) for number in value)
    return tuple(map(float, value)) if finite else None


def position(value: object) -> Position | None:
    """Return a recorded position, or the position of a recorded pose; None for other values."""
    if isinstance(value, list) and len(value) == 2:
        value = value[0]
    numbers = vector(value, 3)
    return (numbers[0], numbers[1], numbers[2]) if numbers is not None else None


def first_position(values: Mapping[str, Any], objects: Mapping[str, Position]) -> Position | None:
    """Return the first position among recorded values, or else the position of the first named object; or None.

    ``objects`` contains positions by name.
    """
    found = map(position, values.values())
    named = (objects.get(name_of(value)) for value in values.values())
    return next((each for each in (*found, *named) if each is not None), None)


LEFT_OUT: Final = "<left out>"

_SECRET: Final = frozenset(
    word + plural
    for word in ("password", "passphrase", "passwd", "pwd", "secret", "token", "key", "apikey", "credential")
    for plural in ("", "s")
)
_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


@lru_cache(maxsize=4096)
def is_secret(name: str) -> bool:
    """Return whether the value of a name such as ``api_key``, ``apiKey`` or ``API-KEY`` is secret."""
    return any(word.lower() in _SECRET for word in _WORDS.findall(name))


def without_secrets(arguments: Sequence[str]) -> list[str]:
    """Return a command line without the values of options with secret names, such as ``--token X`` or ``--token=X``."""
    kept: list[str] = []
    secret = False
    for text in arguments:
        option, equals, _ = text.partition("=")
        if secret and not text.startswith("-"):
            kept.append(LEFT_OUT)
        elif equals and is_secret(option):
            kept.append(f"{option}={LEFT_OUT}")
        else:
            kept.append(text)
        secret = not equals and text.startswith("-") and is_secret(option)
    return kept


@dataclass(frozen=True)
class AssetFile:
    """A file that a recording contains: a model, a mesh or a plan's source. The name contains no folders."""

    name: str
    content: bytes
    media_type: str = "application/octet-stream"

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", escaped(self.name))

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the content in hex."""
        return sha256(self.content).hexdigest()

    @property
    def key(self) -> str:
        """The name of the attachment in a recording: ``<sha256>/<name>``."""
        return f"{self.sha256}/{self.name}"
