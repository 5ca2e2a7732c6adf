"""How values of users (slots, answers, results) and errors stand in records: as one line of JSON, as a ``Failure``.

An object with a method ``__record__`` chooses its form with it: the method returns None, a bool, number, string, list
or dict. Values whose names say that they are secret are left out of recordings.

:class:`AssetFile` is a file that a recording carries so that it is self-contained: a model, a mesh, the plan's source.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from recorder.records.log_pb2 import Argument, Failure
from recorder.records.tracebacks import MAX_ERRORS, format_traceback, text_or

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


MAX_NESTING: Final = 100
"""Levels of lists and dictionaries in each other, in a recorded value; what is deeper is recorded as its text."""
MAX_CHARACTERS: Final = 8 << 20
"""Of a value; a longer one isn't recorded, as readers take a record of many MiB for damaged."""
MAX_DIGITS: Final = 300
"""Of a whole number, which a float still holds then; what has longer ones is recorded as its text."""
_BRACKET: Final = re.compile(r'(?s)"(?:[^"\\]|\\.)*"?|[\[{}\]]')  # a text that has no end takes all
_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")

Plain: TypeAlias = "bool | int | float | str | list[Plain] | dict[str, Plain] | None"
"""What JSON holds."""


def _plain(value: object) -> object:
    exact = _EXACT.get(type(value))
    if exact is not None:
        return exact(value)
    record = getattr(type(value), "__record__", None)  # of its real type: a lazy result imitates another
    if record is not None:
        return _plain(record(value))
    for kinds, plain in _PLAIN:
        if isinstance(value, kinds):
            return plain(value)
    to_list = getattr(type(value), "tolist", None)  # NumPy's; whoever only reads records need not import numpy
    if to_list is not None:
        return _plain(to_list(value))
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    return {"callable": f"{module}.{name}"} if module and name else {"repr": repr(value)}


def _finite(value: float) -> object:
    return float(value) if math.isfinite(value) else {"float": repr(float(value))}


def _mapping(value: Mapping[object, object]) -> object:
    return {str(key): _plain(item) for key, item in value.items()}


def _sequence(value: Iterable[object]) -> object:
    return [_plain(item) for item in value]


# Python's own types, which most values have
_EXACT: Mapping[type, Callable[[Any], object]] = {
    type(None): lambda value: value,
    bool: bool,
    str: str,
    int: int,
    float: _finite,
    dict: _mapping,
    list: _sequence,
    tuple: _sequence,
}

_PLAIN: tuple[tuple[Any, Callable[[Any], object]], ...] = (
    (str, lambda value: value),
    (int, int),
    (float, _finite),
    (Mapping, _mapping),
    (AbstractSet, lambda value: sorted((_plain(item) for item in value), key=repr)),
    ((list, tuple), _sequence),
)


def to_json(value: object) -> str:
    """Return any value as one line of JSON; floats keep all their bits.

    Arrays become lists, recordable objects the result of their ``__record__``, unknown objects ``{"repr": ...}``. A
    value that raises errors or is too long becomes ``{"untold": type, "because": ...}``: recording never breaks a plan.
    """
    try:
        text = json.dumps(_plain(value), ensure_ascii=False, separators=(",", ":"))
        if len(text) > MAX_CHARACTERS:
            raise ValueError(f"it has {len(text)} characters")  # noqa: TRY301  refused as any other
        text.encode()  # a lone surrogate can't be
    except UnicodeEncodeError:
        return json.dumps(_plain(value), separators=(",", ":"))
    except Exception as error:  # noqa: BLE001  the user's own __repr__ and __record__, and lists that hold themselves
        return json.dumps({"untold": type(value).__qualname__, "because": format_error(error)})
    return text


def arguments(values: Mapping[str, object] | Iterable[tuple[str, object]]) -> list[Argument]:
    """Named values as a record carries them, in the given order; without those that are named like secrets."""
    pairs = values.items() if isinstance(values, Mapping) else values
    named = [(str(name), value) for name, value in pairs]
    return [Argument(name=name, json=to_json(LEFT_OUT if is_secret(name) else value)) for name, value in named]


def from_json(text: str) -> Plain:
    """Return a value that a record has as JSON; what isn't JSON (another program's, or damaged) as it is."""
    try:
        return _loaded(text)
    except ValueError:
        return text


def _loaded(text: str) -> Plain:
    """Return the value of a line of JSON; raise ValueError if it isn't JSON or exceeds our limits."""
    if len(text) > MAX_NESTING and text.count("[") + text.count("{") > MAX_NESTING:
        depth = 0
        for bracket in _BRACKET.findall(text):
            depth += 1 if bracket in "[{" else -1 if bracket in "]}" else 0
            if depth > MAX_NESTING:
                raise ValueError(f"it is nested more than {MAX_NESTING} deep")
    value: Plain = (_WARY if _LONG_NUMBER.search(text) else _DECODER).decode(text)
    return value


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"a number has {len(text)} digits")
    return int(text)


def _refuse(text: str) -> float:
    raise ValueError(f"{text} is not JSON")


_DECODER: Final = json.JSONDecoder(parse_constant=_refuse)
_WARY: Final = json.JSONDecoder(parse_int=_integer, parse_constant=_refuse)  # calls Python for each number
_LONG_NUMBER: Final = re.compile(rf"(?<![0-9])[0-9]{{{MAX_DIGITS}}}")


def argument_values(arguments: Iterable[Argument], *, strict: bool = False) -> dict[str, Plain]:
    """Return the named values that a record carries; if strict, raise ValueError for one that isn't JSON."""
    return {argument.name: _loaded(argument.json) if strict else from_json(argument.json) for argument in arguments}


def _message(error: BaseException) -> str:
    return text_or(lambda: str(error), lambda broken: f"<no message: {type(broken).__qualname__}>")


def format_error(error: BaseException) -> str:
    """An exception by its type, and its message if it has one."""
    text = _message(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def failure(error: BaseException, *, trace: bool = True, errors: int = MAX_ERRORS) -> Failure:
    """An exception as a record carries it: type, message, its ``data`` if any, and traceback with so many errors."""
    data = getattr(error, "data", None)
    text = ""
    if trace:
        with suppress(Exception):  # of the error's own methods
            text = format_traceback(error, errors=errors)
    return Failure(
        type=escaped(type(error).__qualname__),
        message=escaped(_message(error)),
        data=arguments(data) if isinstance(data, Mapping) else [],
        traceback=escaped(text),
    )


def format_failure(failure: Failure) -> str:
    """A recorded failure by its type, and its message if it has one."""
    return f"{failure.type}: {failure.message}" if failure.message else failure.type


def without_addresses(text: str) -> str:
    """Return a text without the addresses that Python gives objects in it which have no text of their own.

    They are others in each process.
    """
    return _ADDRESS.sub("", text)


def escaped(text: str) -> str:
    """A text with lone surrogates as escapes, which a file can hold.

    Python has them for the bytes of names of files, threads and the like that aren't UTF-8.
    """
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


LEFT_OUT: Final = "<left out>"

_SECRET: Final = frozenset(
    word + plural
    for word in ("password", "passphrase", "passwd", "pwd", "secret", "token", "key", "apikey", "credential")
    for plural in ("", "s")
)
_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


@lru_cache(maxsize=4096)
def is_secret(name: str) -> bool:
    """Whether a word of a name (``api_key``, ``apiKey``, ``API-KEY``) says that its value is secret."""
    return any(word.lower() in _SECRET for word in _WORDS.findall(name))


def without_secrets(arguments: Sequence[str]) -> list[str]:
    """A command line without the values of options that are named like secrets: ``--token X``, ``--token=X``."""
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
    """One file, identified by its content; its name has no folders."""

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
        """The attachment's name in the recording: ``<sha256>/<name>``."""
        return f"{self.sha256}/{self.name}"
