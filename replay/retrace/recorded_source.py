"""The plan's source as it is attached to a recording, written out to run in place of what is on the disk now.

Attached are the plan and those of its modules that stand in a call stack, by their file names. What isn't attached,
modules and other files beside the plan, is linked to from the folder where it was, and comes from the disk.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from recorder.records import Run
from replay.explain.plan_source import name_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from replay.file.record_reader import RecordReader

_CACHE = "__pycache__"  # would have what was compiled of the files on the disk


class NoSource(LookupError):
    """The plan's own source isn't attached."""


class RecordedSource:
    """The recorded source of a plan.

    Args:
        log: the recording.
        program: the plan's file, as it was run.

    Attributes:
        program: the same.
        files: the attached files by their paths in the plan's folder.
        left_out: names of attached files whose places aren't known, or aren't below the plan's folder.

    Raises:
        NoSource: it isn't attached.
    """

    def __init__(self, log: RecordReader, program: Path) -> None:
        self.program = program
        began = log[0]
        digest = began.plan.sha256 if isinstance(began, Run) else ""
        keys = [key for key in log.assets if key.endswith(".py")]
        main = [key for key in keys if name_of(key) == program.name and key.startswith(digest)]
        if len(main) != 1:
            raise NoSource
        places = _places(log) - {program}
        self.files = {Path(program.name): log.assets[main[0]]}
        self.left_out: list[str] = []
        for key in keys:
            fitting = [place for place in places if place.name == name_of(key)]
            shared = sum(name_of(other) == name_of(key) for other in keys) > 1
            if key == main[0]:
                continue
            if len(fitting) == 1 and not shared and fitting[0].is_relative_to(program.parent):
                self.files[fitting[0].relative_to(program.parent)] = log.assets[key]
            else:
                self.left_out.append(name_of(key))

    @property
    def texts(self) -> dict[Path, bytes]:
        """The attached files by the paths that they had."""
        return {self.program.parent / place: text for place, text in self.files.items()}

    def write(self, folder: Path) -> Path:
        """Write it into a folder, links to everything else beside it, and return the plan's file there."""
        name = self.program.parent.name
        target = folder / (name if name not in ("", "..") else "plan")  # it was run as ../plan.py
        _lay(self.files, self.program.parent, target)
        return target / self.program.name

    def __str__(self) -> str:
        names = ", ".join(sorted(map(str, self.files)))
        outside = (
            f"; {', '.join(sorted(set(self.left_out)))} and all else come" if self.left_out else "; all else comes"
        )
        return f"the recorded source runs: {names}{outside} from the disk"


def _lay(texts: Mapping[Path, bytes], original: Path, target: Path) -> None:
    """Write files below a folder, and links to what else the original has there."""
    target.mkdir(parents=True)
    within: dict[str, dict[Path, bytes]] = {}
    for place, text in texts.items():
        if len(place.parts) == 1:
            (target / place).write_bytes(text)
        else:
            within.setdefault(place.parts[0], {})[Path(*place.parts[1:])] = text
    for name, parts in within.items():
        _lay(parts, original / name, target / name)
    for other in original.iterdir() if original.is_dir() else ():
        if other.name != _CACHE and not (target / other.name).exists():
            (target / other.name).symlink_to(other)


def _places(log: RecordReader) -> set[Path]:
    """Return the paths of all files in call stacks."""
    files: set[str] = set()
    for record in log:
        files.add(getattr(record, "source_file", ""))
        files.update(caller.file for caller in getattr(record, "callers", ()))
    return {Path(file) for file in files if file}
