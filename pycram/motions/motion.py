"""A motion from its request to its end: it queues for resources, is resolved, and is carried out.

The motions that a motion is made of queue among themselves, for the resources that it holds. So no motion waits for one
that waits for it. A motion in another world, performed to look ahead, queues there as any other does.
"""

from __future__ import annotations

import threading
import weakref
from contextvars import ContextVar
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pycram.foundation.names import qualified_name
from pycram.motions.environments import current_environment
from pycram.motions.requests import performing
from pycram.motions.resources import ResourceQueue, Ticket, forget_tickets
from pycram.scheduling.cancellation import Binding, checkpoint
from recorder.records import Decision
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pycram.motions.designator import Designator
    from pycram.motions.environments import Chosen, Module
    from pycram.world.world import BulletWorld

_queues: weakref.WeakKeyDictionary[BulletWorld, ResourceQueue] = weakref.WeakKeyDictionary()
_lock = threading.Lock()
#: For the motions that one is made of: the queues for what is held of the robots of worlds, by world.
_parts: ContextVar[Mapping[BulletWorld, ResourceQueue]] = ContextVar("pycram_parts", default=MappingProxyType({}))
#: The designator that is carried out in this context, and how that was decided.
_decided: ContextVar[tuple[Designator | None, Decision | None]] = ContextVar("pycram_decided", default=(None, None))


class Motion:
    """A designator to be carried out in a world.

    Args:
        choose: Returns the process module of a designator that can be resolved.

    Attributes:
        name: The designator's type.
        span: Its node of the task tree.
    """

    def __init__(self, designator: Designator, world: BulletWorld, choose: Callable[[Designator], Chosen]) -> None:
        self.name = str(dict(designator.description).get("type", type(designator).__name__))
        slots = {key: value for key, value in designator.description if key != "type"}
        self._designator = designator
        self._choose = choose
        self._world = world
        with performing(designator):
            resources = designator.resources()
        self._ticket = Ticket(_parts.get().get(world) or _queue_of(world), resources, self.name)
        self.span = Span("motion", self.name, parameters=slots)

    def enqueue(self) -> None:
        """Take its place in the queue for resources."""
        self._ticket.enqueue()

    def leave(self) -> None:
        """Give its place up, if it has one."""
        self._ticket.leave()

    def carry_out(self) -> Any:
        """Wait for its turn, resolve it, run its process module within the span, and return the module's result."""
        try:
            self._await_slots()
            with self._ticket.turn():
                checkpoint()
                with performing(self._designator):
                    module = self._resolve()
                    with self._holding(), Binding(_decided, (self._designator, self.span.decision)):
                        return module.execute(self._designator)
        finally:
            self.leave()

    def _await_slots(self) -> None:
        """Wait for futures among its slots while it holds no resources: their branches may need some."""
        for branch in self._designator.branches():
            branch.result()

    def _resolve(self) -> Module:
        """Find solution and process module, and request the resources that these need."""
        with self._holding():  # resolvers may perform motions
            self.span.decision = decision = Decision(environment=current_environment())
            try:
                self.span.solution = self._designator.reference()
                chosen = self._choose(self._designator)
            finally:
                found = self._designator.resolution()
                decision.resolver, decision.solution = found.resolver, found.index
                decision.known, decision.complete = found.known, found.complete
            module = chosen.module
            decision.module, decision.chooser = qualified_name(type(module)), chosen.chooser
            decision.registered_for = chosen.registered_for
            resources = module.resources(self._designator)
        self._ticket.correct(resources)
        return module

    def _holding(self) -> Binding[Mapping[BulletWorld, ResourceQueue]]:
        """Make motions performed in this world in the ``with`` block parts of this one, within its resources."""
        return Binding(_parts, {**_parts.get(), self._world: ResourceQueue(self._ticket.resources)})


def decision_of(designator: Designator) -> Decision | None:
    """Return how the motion was decided that carries a designator out in this context; None if none does."""
    carried_out, decision = _decided.get()
    return decision if carried_out is designator else None


def forget_motions() -> None:
    """Forget all motions that run or wait, in a forked child; what this context does is part of none."""
    _queues.clear()
    _parts.set(MappingProxyType({}))
    forget_tickets()


def _queue_of(world: BulletWorld) -> ResourceQueue:
    with _lock:
        return _queues.setdefault(world, ResourceQueue())
