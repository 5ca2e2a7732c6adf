"""Names that the second of two runs has for what the first calls otherwise: worlds, and fluents without a name.

A world that the plan didn't name has the process' next number, as ``world_3``, and so has a fluent: runs that were
recorded in one process go on where the last one ended. Worlds are paired by name, numbered ones and the rest by the
order in which they were opened; fluents by how many came before since the first that is seen.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from recorder.records import Fluent, Task

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.records import Plain, Record
    from replay.file.record_reader import RecordReader

_NUMBERED: Final = re.compile(r"\b(world|fluent)_([1-9]\d*)\b")
_WAITS: Final = frozenset({"wait", "whenever"})  # kinds of tasks that are named after a fluent


class PairedNames:
    """Turns names of a second run into those of the first.

    Attributes:
        worlds: names of the first run's worlds by those of the second's; equal ones are left out.
    """

    def __init__(self, first: RecordReader, second: RecordReader) -> None:
        self.worlds = dict(_pairs(_worlds(first), _worlds(second)))
        self._offsets: list[int | None] = [None, None]  # numbers of the first fluents that are seen, by run

    def note(self, run: int, record: Record) -> None:
        """Look at a record of a run, 0 or 1, before it is compared: fluents count from the first that is seen."""
        if self._offsets[run] is None and (
            isinstance(record, Fluent) or (isinstance(record, Task) and record.kind in _WAITS)
        ):
            numbers = [int(number) for word, number in _NUMBERED.findall(record.name) if word == "fluent"]
            self._offsets[run] = min(numbers, default=None)

    @property
    def any(self) -> bool:
        """Whether any name differs, as far as is known by now."""
        return bool(self.worlds) or self._shift != 0

    @property
    def _shift(self) -> int:
        before, after = self._offsets
        return before - after if before is not None and after is not None else 0

    def text(self, text: str) -> str:
        """Return a text of the second run with the names of the first."""
        return _NUMBERED.sub(self._renamed, text)

    def _renamed(self, match: re.Match[str]) -> str:
        if match[1] == "world":
            return self.worlds.get(match[0], match[0])
        return f"fluent_{int(match[2]) + self._shift}"

    def data(self, value: Plain, key: str = "") -> Plain:
        """Return data of a record of the second run with the names of the first."""
        if isinstance(value, dict):
            return {self.text(name): self.data(item, name) for name, item in value.items()}
        if isinstance(value, list):
            return [self.data(item) for item in value]
        if isinstance(value, str):
            return self.worlds[value] if key == "world" and value in self.worlds else self.text(value)
        return value


def _worlds(log: RecordReader) -> list[str]:
    """Return the names of its worlds in the order of their opening."""
    return list(dict.fromkeys(lifetime.world for lifetime in log.lifetimes))


def _pairs(first: list[str], second: list[str]) -> Iterable[tuple[str, str]]:
    """Yield names of the second run's worlds with the first's of another name that they are compared with."""
    numbered = [[name for name in names if _NUMBERED.fullmatch(name)] for names in (first, second)]
    yield from zip(numbered[1], numbered[0], strict=False)
    paired = [set(names[: min(map(len, numbered))]) for names in numbered]
    others = [[name for name in names if name not in done] for names, done in zip((first, second), paired, strict=True)]
    rest = [
        [name for name in names if name not in both] for names in others for both in [set(others[0]) & set(others[1])]
    ]
    yield from zip(rest[1], rest[0], strict=False)
