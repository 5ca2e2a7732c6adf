"""Solutions that a plan requests of a designator itself, outside of ``perform``: each request is on record.

What a motion does to carry its designator out is part of the motion, whose task says how it was decided.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pycram.foundation.error_families import UsageError
from pycram.scheduling.cancellation import Binding
from recorder import records
from recorder.tracing import journal, span

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.motions.designator import Designator

#: The designators that are carried out in this context: a motion may be made of motions.
_performed: ContextVar[tuple[Designator, ...]] = ContextVar("pycram_performed", default=())


@dataclass(slots=True)
class Request:
    """A request for a solution; its answer is set while it is served."""

    answer: Any = None


def performing(designator: Designator) -> Binding[tuple[Designator, ...]]:
    """Make what is asked of a designator in the ``with`` block part of carrying it out."""
    return Binding(_performed, (*_performed.get(), designator))


@contextmanager
def recorded(name: str, designator: Designator, index: int | None = None) -> Iterator[Request]:
    """Put a request that the block serves on record, unless its designator is being carried out.

    One that fails with a UsageError is a refusal, which its caller records; another has its failure in the record.

    Args:
        name: "reference" or "next_solution".
        designator: what is to be resolved.
        index: of the requested solution; the designator's own by default.
    """
    request = Request()
    if any(each is designator for each in _performed.get()) or not journal.recording():
        yield request
        return
    start = time.perf_counter_ns()
    error: BaseException | None = None
    with performing(designator):  # what its resolvers ask of it
        try:
            yield request
        except BaseException as raised:
            error = raised
            raise
        finally:
            if not isinstance(error, UsageError):
                _emit(name, designator, index, request.answer, error, time.perf_counter_ns() - start)


def _emit(
    name: str, designator: Designator, index: int | None, answer: Any, error: BaseException | None, duration: int
) -> None:
    found = designator.resolution(index)
    evidence: dict[str, object] = {"resolver": found.resolver} if found.resolver else {}
    evidence |= {"index": found.index, "known": found.known, "complete": found.complete}
    record = records.Query(
        name=name,
        arguments=records.arguments({"designator": designator}),
        answer_json=records.to_json(answer),
        evidence=records.arguments(evidence),
        duration_ns=duration,
        failure=records.failure(error) if error is not None else None,
    )
    world, sim_step = journal.current_world()
    span.emit(record, world=world, sim_step=sim_step)
