"""Failures that blocks and cleanups raise, and usage errors of blocks."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from pycram.foundation.errors import PlanFailure, PycramError, UsageError, export
from recorder import notebook
from recorder.records import format_error
from recorder.records.tracebacks import format_traceback
from recorder.tracing.call_stack import call_site

MAX_LEVELS: Final = 8  # maximum number of nested failed blocks in texts; more would take minutes to write
MAX_LEAVES: Final = 8  # maximum number of shown failures if blocks are nested deeper; others are counted
_MAX_FRAMES: Final = 1000  # maximum number of frames of each failure in a traceback of several failures


class BlockClosed(UsageError):
    """A plan added a branch to a block that has ended."""

    def __init__(self, block: str, branch: str) -> None:
        super().__init__(f"{branch} can't be a branch of this {block} block: the block has ended")
        self.block = block  # kind of the block, such as "par".
        self.branch = branch  # name of the branch


class RunsEarly(UsageError):
    """Plain Python in the body of a sequence would act before earlier actions of the sequence."""

    def __init__(self, what: str, block: str, pending: Sequence[str]) -> None:
        self.what = what  # the premature action
        self.block = block  # kind of the sequence: "seq" or "try_in_order"
        self.pending = tuple(pending)  # names of the earlier actions that have not ended
        self.file, self.line = call_site()  # the plan's file and line; the first line is 1
        have = "have" if len(self.pending) > 1 else "has"
        super().__init__(
            f"{notebook.place(self.file, self.line)} would {what} too early: {', '.join(self.pending)} {have} not "
            f"ended in this {block} block. In the body of a concurrent block, PyCRAM only reads a {block} block, so "
            "plain Python between the actions runs immediately. Put this Python code into a function, and make the "
            f"function an action: `with {block} as s: ...; s(function)`"
        )


class OutlivesTimeout(UsageError):
    """Code inside a timeout added a branch to a block outside, where the deadline wouldn't apply to the branch."""

    def __init__(self, block: str, branch: str) -> None:
        self.block = block  # kind of the block, such as "par".
        self.branch = branch  # name of the branch
        self.file, self.line = call_site()  # the plan's file and line; the first line is 1
        super().__init__(
            f"{notebook.place(self.file, self.line)} adds {branch} inside a timeout to the {block} block around the "
            f"timeout. This block ends after the timeout, so the deadline wouldn't apply to {branch}. Open the block "
            f"inside the timeout, as in `with timeout(...), {block} as s:`, or open the timeout inside {branch}"
        )


class BranchesFailed(PlanFailure):
    """A block of the plan language failed; this failure contains the failures of all branches.

    This failure is an instance of all types that the branches' failures have in common. If all branches failed with
    ``Unreachable``, ``except Unreachable`` catches the block's failure, which has the fields of the first failure.
    """

    def __new__(cls, block: str, failures: Iterable[PlanFailure]) -> BranchesFailed:  # noqa: PYI034  a subclass
        """Make an instance of all types that the failures have in common."""
        failures = tuple(failures)
        if cls is BranchesFailed:
            kind = _combined_type(tuple(type(leaf) for leaf in _leaves(failures)))
            return super().__new__(kind, block, failures)
        return super().__new__(cls, block, failures)

    def __init__(self, block: str, failures: Iterable[PlanFailure]) -> None:
        members = tuple(failures)
        fields = vars(self)  # a property of the type may have the name of a field
        if len(type(self).__bases__) > 1:
            fields.update(vars(next(_leaves(members))))
        leaves, causes, left_out = tuple(_leaves(members)), members, 0
        levels = 1 + max((f._levels for f in members if isinstance(f, BranchesFailed)), default=0)  # noqa: SLF001  as self
        if levels > MAX_LEVELS:
            levels, causes, left_out = 1, leaves[:MAX_LEAVES], max(0, len(leaves) - MAX_LEAVES)
        fields.update(block=block, failures=members, _leaves=leaves, _causes=causes, _levels=levels, _left_out=left_out)
        self.__cause__ = causes[0] if len(causes) == 1 else Tracebacks(causes)

    _leaves: tuple[PlanFailure, ...]
    _causes: tuple[PlanFailure, ...]  # failures in the message; only leaves if the failures are nested too deeply
    _levels: int  # number of levels of nested blocks that the message shows
    _left_out: int  # number of leaves that the message doesn't show

    @property
    def block(self) -> str:
        """The kind of block: "par", ... This is a property, because types of failures may have a field "block"."""
        return str(vars(self)["block"])

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """Failures of the branches and of the body, in order."""
        failures: tuple[PlanFailure, ...] = vars(self)["failures"]
        return failures

    @property
    def leaves(self) -> tuple[PlanFailure, ...]:
        """The failures; each failed block is replaced by its leaves."""
        return self._leaves

    @property
    def data(self) -> Mapping[str, object]:
        """The fields by name; "failures" contains the type, message and fields of each shown failure of a branch."""
        failures = [{"type": type(f).__name__, "message": str(f), "data": f.data} for f in self._causes]
        return {**super().data, "failures": failures}

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the block and the failures; unpickling combines the failures' types again."""
        return BranchesFailed, (self.block, self.failures)

    def __str__(self) -> str:
        texts = [str(f) if isinstance(f, BranchesFailed) else format_error(f) for f in self._causes]
        if self._left_out:
            texts.append(f"and {self._left_out} more")
        return f"{self.block} failed: {'; '.join(texts)}"


class NotCleanedUp(PlanFailure):
    """A block or a timeout cancelled a branch, and the branch's cleanup (``finally_``) failed."""

    def __init__(self, action: str, failure: PlanFailure) -> None:
        super().__init__(f"{action}, the cleanup of a cancelled branch, failed: {format_error(failure)}")
        self.action = action  # name of the cleanup
        self.failure = failure  # the failure of the cleanup
        self.__cause__ = failure


class Retry(BaseException):
    """Ends an attempt: ``retry`` raises this error, and only the attempt catches the error."""

    def __init__(self, attempt: object, number: int, changed: Mapping[str, Any], error: BaseException | None) -> None:
        super().__init__(f"attempt {number} ended by retry()")
        self.attempt = attempt
        self.changed = changed  # parameters of the next attempt
        self.error = error  # the error that the plan was handling at that moment


def leaves_uncleaned(failure: BaseException) -> bool:
    """Return whether a failure is or contains a failed cleanup of a cancelled branch."""
    leaves = failure.leaves if isinstance(failure, BranchesFailed) else (failure,)
    return any(isinstance(leaf, NotCleanedUp) for leaf in leaves)


class Tracebacks(PycramError):
    """The cause of a :class:`BranchesFailed`, so that tracebacks print all of its failures. Never raised."""

    def __init__(self, failures: Sequence[BaseException]) -> None:
        super().__init__(failures)
        self.failures = tuple(failures)

    def __str__(self) -> str:
        lines = []
        for number, failure in enumerate(self.failures, 1):
            lines.append(f"{number} of {len(self.failures)}")
            lines += ["  | " + line for line in format_traceback(failure, frames=_MAX_FRAMES).splitlines()]
        return "\n".join(lines)


def _leaves(failures: Iterable[PlanFailure]) -> Iterator[PlanFailure]:
    for failure in failures:
        if isinstance(failure, BranchesFailed):
            yield from failure.leaves
        else:
            yield failure


@functools.lru_cache(maxsize=256)
def _combined_type(kinds: tuple[type[PlanFailure], ...]) -> type[BranchesFailed]:
    """Return a type that combines BranchesFailed with the common types of all kinds, except PlanFailure."""
    common: list[type] = []
    for kind in kinds[0].__mro__ if kinds else ():
        shared = issubclass(kind, PlanFailure) and kind is not PlanFailure and all(issubclass(k, kind) for k in kinds)
        if shared and not any(issubclass(known, kind) for known in common):
            common.append(kind)
    if not common:
        return BranchesFailed
    try:
        combined = type("BranchesFailed", (BranchesFailed, *common), {"__module__": BranchesFailed.__module__})
        BaseException.__new__(combined)
    except TypeError:  # Python can't combine these types
        return BranchesFailed
    return combined


export("pycram.failures", BranchesFailed, NotCleanedUp, OutlivesTimeout, RunsEarly)
