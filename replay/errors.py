"""What opening and reading recordings can raise."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


class ReplayError(Exception):
    """Base of what this package raises on purpose."""


class NotALog(ReplayError):
    """The file isn't a recording of PyCRAM, or nothing of it can be read.

    Attributes:
        path: the file.
        cause: why.
    """

    def __init__(self, path: str | Path, cause: str) -> None:
        super().__init__(f"{path}: {cause}")
        self.path = str(path)
        self.cause = cause


class NoSuchStep(ReplayError, LookupError):
    """A step that the recording doesn't have.

    Attributes:
        step: what was asked for.
        steps: how many there are.
    """

    def __init__(self, step: object, steps: int, hint: str = "") -> None:
        super().__init__(f"there is no step {step}; the recording has steps 0 to {steps - 1}{hint}")
        self.step = step
        self.steps = steps


class NoSuchName(ReplayError, LookupError):
    """A body, joint, link or world that wasn't there at that step.

    Attributes:
        name: what was asked for.
        known: what was there.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.name = name
        self.known = sorted(known)
        super().__init__(f"there is no {kind} {name!r}; there are {', '.join(self.known) or 'none'}")
