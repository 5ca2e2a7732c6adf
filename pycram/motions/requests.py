"""Solutions that a plan requests of a designator itself, outside of ``perform``: each request is on record.

What a motion does to carry its designator out is part of the motion, whose task says how it was decided.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import TYPE_CHECKING

from pycram.reasoning.choosing import Question
from pycram.scheduling.cancellation import Binding
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.motions.designator import Designator

#: The designators that are carried out in this context: a motion may be made of motions.
_performed: ContextVar[tuple[Designator, ...]] = ContextVar("pycram_performed", default=())


def performing(designator: Designator) -> Binding[tuple[Designator, ...]]:
    """Make what is asked of a designator in the ``with`` block part of carrying it out."""
    return Binding(_performed, (*_performed.get(), designator))


def recorded(name: str, designator: Designator, index: int | None = None) -> AbstractContextManager[Question]:
    """Put a request that the block answers on record, unless its designator is being carried out.

    One that fails with a UsageError is a refusal, which its caller records; another has its failure in the record.

    Args:
        name: "reference" or "next_solution".
        designator: what is to be resolved.
        index: of the requested solution; the designator's own by default.
    """
    request = Question(name, {"designator": designator})
    if any(each is designator for each in _performed.get()) or not journal.recording():
        return nullcontext(request)
    return _on_record(request, designator, index)


@contextmanager
def _on_record(request: Question, designator: Designator, index: int | None) -> Iterator[Question]:
    with performing(designator), request.recorded(journal.current_world):  # with what its resolvers ask of it
        try:
            yield request
        finally:
            found = designator.resolution(index)
            resolver = {"resolver": found.resolver} if found.resolver else {}
            request.evidence = {**resolver, "index": found.index, "known": found.known, "complete": found.complete}
