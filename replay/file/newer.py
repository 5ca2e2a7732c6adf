"""Recordings of newer releases: what this one doesn't know of them.

They are read as far as they go: unknown fields are left out, of records of unknown kinds the envelope is read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records.definition import PACKAGE, format_number, unknown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from replay.file.index import Index

_MAX_NAMES: Final = 4  # in a message
_FIRST: Final = [0, 1, 0]  # release: no recording of it is newer
_MAX_DIGITS: Final = 9  # of a number that is one
_RELEASE: Final = re.compile(r"(\d{1,9})\.(\d{1,9})(?:\.(\d{1,9}))?")


@dataclass(frozen=True, slots=True)
class Newer:
    """A newer release than this one, that wrote a recording.

    Attributes:
        release: its version.
        format: its format; see :mod:`recorder.records.definition`.
        fields: what it has in messages that this one knows: fields, and values of enums, as ``Mutation.force``.
        kinds: kinds of records that this one doesn't know.
    """

    release: str
    format: int
    fields: tuple[str, ...]
    kinds: tuple[str, ...]

    def __str__(self) -> str:
        text = f"written by PyCRAM {self.release or 'of an unknown version'}, which is newer than this one"
        if self.fields:
            be = "is" if len(self.fields) == 1 else "are"
            text += f"; {_counted(self.fields, 'field')} unknown here {be} ignored {_listed(self.fields)}"
        if self.kinds:
            text += f"; of {_counted(self.kinds, 'kind')} of records only the envelope is read {_listed(self.kinds)}"
        return text


def _counted(names: Sequence[str], word: str) -> str:
    return f"{len(names)} {word}{'' if len(names) == 1 else 's'}"


def _listed(names: Sequence[str]) -> str:
    more = ", ..." if len(names) > _MAX_NAMES else ""
    return f"({', '.join(names[:_MAX_NAMES])}{more})"


def format_of(index: Index) -> int:
    """Return the format of a recording; 0 of one that doesn't tell it: they are older."""
    text = index.metadata.get("pycram", {}).get("format", "")
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= _MAX_DIGITS else 0


def newer_of(index: Index) -> Newer | None:
    """Return the release that wrote a file if it is newer than this one, by its format or its version."""
    number = format_of(index)
    release = index.metadata.get("pycram", {}).get("pycram", "")
    if number <= format_number() and not _is_later(release):
        return None
    messages = {name.removeprefix(f"{PACKAGE}."): data for name, data in index.definitions.items() if _is_ours(name)}
    names = unknown(messages.values())
    kinds = tuple(name for name in names if name in messages)
    unknown_messages = {name for name in names if "." not in name}
    fields = tuple(name for name in names if "." in name and name.partition(".")[0] not in unknown_messages)
    return Newer(release, number, fields, kinds)


def _is_ours(name: str) -> bool:
    return name.startswith(f"{PACKAGE}.")


def _is_later(release: str) -> bool:
    """Return whether a release is later than this one, as far as that is known."""
    other = _RELEASE.match(release)
    if other is None or _numbers(other) <= _FIRST:
        return False
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415  slow to import

    try:
        own = _RELEASE.match(version("pycram"))
    except PackageNotFoundError:
        return False
    return own is not None and _numbers(other) > _numbers(own)


def _numbers(release: re.Match[str]) -> list[int]:
    return [int(part or 0) for part in release.groups()]
