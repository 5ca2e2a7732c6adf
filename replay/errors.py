"""What opening and reading recordings can raise; every one says what, where, and what to do."""

from __future__ import annotations

import difflib
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


class Unreadable(NotALog):
    """A recording of which nothing can be read: too damaged, cut too early, or of an unknown release."""


class Damaged(ReplayError):
    """A part of a recording that can't be read; the rest can.

    Attributes:
        path: the file.
        where: the part: a step, an attached file.
        cause: what is wrong with it.
    """

    def __init__(self, path: str | Path, where: str, cause: str) -> None:
        super().__init__(f"{path}: {where} is damaged: {cause}")
        self.path = str(path)
        self.where = where
        self.cause = cause


class LogClosed(ReplayError):
    """A recording that is read after it was closed, as behind the ``with`` that opened it.

    Attributes:
        path: the file.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(f"{path}: it was closed; read it within its with, or open it again")
        self.path = str(path)


class NoSuchStep(ReplayError, LookupError):
    """A step that the recording doesn't have.

    Attributes:
        step: what was asked for.
        steps: how many there are.
    """

    def __init__(self, step: object, steps: int, hint: str = "") -> None:
        super().__init__(f"there is no step {step}: {hint or f'the recording has steps 0 to {steps - 1}'}")
        self.step = step
        self.steps = steps


class NoSuchName(ReplayError, LookupError):
    """A body, joint, link or world that wasn't there at that step.

    Attributes:
        name: what was asked for.
        known: what was there.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], hint: str = "") -> None:
        self.name = name
        self.known = sorted(set(known))
        near = difflib.get_close_matches(name, self.known, 3)
        told = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(self.known) or 'none'}"
        super().__init__(f"there is no {kind}{f' {name!r}' if name else ''}; {hint or told}")


class NotRestored(ReplayError):
    """A world that can't be had again as it was.

    Attributes:
        step: the step that was asked for.
        cause: why not.
    """

    def __init__(self, step: int, cause: str) -> None:
        super().__init__(f"the world after step {step} can't be restored: {cause}")
        self.step = step
        self.cause = cause
