"""What is in the tables of a folder of recordings, as it is written beside them, and locks on their parts."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from replay.runs.schema import TABLES, VERSION

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_CONTENTS: Final = "contents.json"
_PART: Final = re.compile(r"\.?(\d{6,})(\..*)?", re.ASCII)  # its name; with a dot before it while it is written


@dataclass
class Contents:
    """What is in the tables.

    Attributes:
        files: size and time of each recording that was read, and its part; those that can't be read have the reason.
        next: number of the next part.
    """

    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    next: int = 1

    @property
    def parts(self) -> dict[str, list[str]]:
        """Names of the recordings by part."""
        found = defaultdict(list)
        for name, facts in self.files.items():
            if "part" in facts:
                found[facts["part"]].append(name)
        return found

    @classmethod
    def read(cls, tables: Path) -> Contents:
        """Return what is in a folder of tables: nothing, where that can't be known or another release made them."""
        numbers = [int(found[1]) for name in parts_there(tables) if (found := _PART.fullmatch(name))]
        nothing = cls(next=max(numbers, default=0) + 1)  # who reads the old ones may go on
        try:
            content = json.loads((tables / _CONTENTS).read_text(encoding="utf-8"))
            contents = cls(dict(content["files"]), int(content["next"]))
            decimal = all(part.isdecimal() for part in contents.parts)  # no other folders
            ours = content["version"] == VERSION and decimal
            intact = ours and all(
                (tables / part / f"{table.name}.parquet").is_file() for part in contents.parts for table in TABLES
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return nothing
        return contents if intact else nothing

    def write(self, tables: Path) -> None:
        """Write it down, whole or not at all."""
        partial = tables / f".{_CONTENTS}.{os.getpid()}"
        content = {"version": VERSION, "next": self.next, "files": self.files}
        try:
            partial.write_text(json.dumps(content, indent=0), encoding="utf-8")
            partial.replace(tables / _CONTENTS)
        finally:
            partial.unlink(missing_ok=True)


def parts_there(tables: Path) -> set[str]:
    """Return the names of the folders of parts, also of those that are no longer in the contents."""
    found = tables.iterdir() if tables.is_dir() else ()
    return {each.name for each in found if _PART.fullmatch(each.name) and each.is_dir() and not each.is_symlink()}


@contextlib.contextmanager
def flocked(folder: Path, *, exclusive: bool) -> Iterator[None]:
    """Hold a lock on a folder where the system can; it isn't waited for.

    Raises:
        BlockingIOError: another one holds it.
    """
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:  # some network file systems have none
            pass
        yield
    finally:
        os.close(descriptor)
