"""Errors of opening and reading recordings."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from recorder.errors import PortableError, suggestion


class ReplayError(PortableError):
    """Base class of the errors of this package. A message with several parts has colons between them."""

    def __init__(self, *parts: object) -> None:
        super().__init__(": ".join(map(str, parts)))


class NotALog(ReplayError):
    """The file isn't a recording of PyCRAM, or is completely unreadable."""

    def __init__(self, path: str | Path, cause: str) -> None:
        super().__init__(path, cause)
        self.path = str(path)
        self.cause = cause


class Unreadable(NotALog):
    """A recording that is completely unreadable: too damaged, cut off too early, or of an unknown release."""


class Damaged(ReplayError):
    """A part of a recording can't be read."""

    def __init__(self, path: str | Path, where: str, cause: str) -> None:
        super().__init__(f"{path}: {where} is damaged: {cause}")
        self.path = str(path)
        self.where = where  # the damaged part, such as a step or an attached file
        self.cause = cause


NONSENSE: Final = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    ArithmeticError,
    AttributeError,
    SyntaxError,  # reading a model that isn't XML raises this error
    zlib.error,
)
"""Errors that records cause which no recorder has written."""


def nonsense(path: str | Path, where: str, error: Exception) -> Damaged:
    """Return the error for a record whose content is impossible."""
    return Damaged(path, where, f"the content is inconsistent: {error}")


class MissingModels(Damaged):
    """Models are missing, because the shared file of a sweep has changed, or isn't in the recording's folder."""

    def __init__(self, path: str | Path, cause: str) -> None:
        super().__init__(path, "its models", cause)
        hint = "copy the file of models into the folder of the recording, or pack recordings before moving them"
        self.args = (f"{path}: its models are missing: {cause}; {hint}",)


class LogClosed(ReplayError):
    """A recording was read after its end, for example after its ``with`` block."""

    def __init__(self, path: str | Path) -> None:
        super().__init__(f"{path}: the recording was closed; read it inside its with block, or open it again")
        self.path = str(path)


class NoSuchStep(ReplayError, LookupError):
    """The recording has no such step."""

    def __init__(self, step: object, steps: int, hint: str = "") -> None:
        super().__init__(f"there is no step {step}: {hint or f'the recording has steps 0 to {steps - 1}'}")
        self.step = step  # the requested step
        self.steps = steps  # number of steps


class NoSuchName(ReplayError, LookupError):
    """There is no such body, joint, link or world at the step."""

    def __init__(self, kind: str, name: str, known: Iterable[str], hint: str = "") -> None:
        self.name = name
        self.known = sorted(set(known))
        super().__init__(f"there is no {kind}{f' {name!r}' if name else ''}; {hint or suggestion(name, self.known)}")


class NotRestored(ReplayError):
    """A world can't be restored."""

    def __init__(self, step: int, cause: str) -> None:
        super().__init__(f"the world after step {step} can't be restored: {cause}")
        self.step = step  # the requested step
        self.cause = cause
