"""Process modules: the code that carries a motion out on one robot, in one execution environment (thesis 4.7-4.9).

``ProcessModule.perform(designator)`` makes a motion of the designator (:mod:`pycram.motions.motion`) for the module
that serves the robot in the current environment (:mod:`pycram.motions.environments`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from pycram.foundation.failures import BadArgument, NoWorld, PlanFailure
from pycram.foundation.names import qualified_name
from pycram.foundation.refusals import refusing
from pycram.language.block import current_block
from pycram.language.branch import run
from pycram.motions.designator import Designator, DesignatorError, unfinished
from pycram.motions.environments import Chosen, current_environment, module_for
from pycram.motions.motion import Motion, decision_of, forget_motions
from pycram.motions.requests import performing
from pycram.motions.resolvers import Resolvers
from pycram.motions.resources import ResourceQueue, Resources, Ticket
from pycram.scheduling.cancellation import Binding, checkpoint, uninterruptible
from pycram.world.world import BulletWorld
from recorder.tracing.span import span

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Self

Result: TypeAlias = Any
Chooser: TypeAlias = Callable[[Designator], "ProcessModule | None"]

_ONE_AT_A_TIME = Resources(moves=frozenset({"module"}))
_TOGETHER = Resources()

#: Queues of the modules that a running module performs motions with; concurrent modules have separate ones.
_inner_queues: ContextVar[dict[ProcessModule, ResourceQueue] | None] = ContextVar("pycram_modules", default=None)


class ProcessModule(ABC):
    """Carries out one kind of motion, one designator at a time, in order of arrival.

    Motions that it performs are parts of that motion, within its resources.

    Attributes:
        one_at_a_time: False for one that keeps nothing of a designator: two arms may move by the same module.
    """

    one_at_a_time = True

    failures: ClassVar[tuple[type[PlanFailure], ...]] = ()
    """What it may raise, in any environment; of PyCRAM's modules the reference lists them."""

    failures_in_time: ClassVar[tuple[type[PlanFailure], ...]] = ()
    """What else it may raise where motions take simulated time."""

    resolvers: ClassVar[Resolvers[Chooser]] = Resolvers("process modules")
    """Functions that return a module for a designator, or None; called before the registered modules are looked up.

    Like resolvers, they are called when the motion's turn has come; motions that they perform are part of it."""

    _queue: ResourceQueue

    def __new__(cls, *_: object, **__: object) -> Self:
        """Make one; not in ``__init__``, which subclasses may have without calling this class's."""
        made = super().__new__(cls)
        made._queue = ResourceQueue()
        return made

    @abstractmethod
    def _execute(self, designator: Designator) -> Result:
        """Carry a designator out, with the parameters of its ``reference()``; return what the plan gets.

        Raises:
            PlanFailure: The world said no; the world is consistent then.
        """

    def resources(self, designator: Designator) -> Resources | None:
        """Return what carrying a designator out needs of the robot; None for the whole robot.

        Called when it is resolved, before anything moves. The resources of PyCRAM's own motions are known by the
        solution's ``cmd``. A module for another ``cmd`` gets the whole robot, unless it returns here what it needs, for
        itself and for all motions that it performs::

            def resources(self, designator):
                return Resources(moves={"left-arm"}, at_rest={"base"})
        """
        return designator.resources()

    def execute(self, designator: Designator) -> Result:
        """Carry a designator out, after all earlier ones if need be; a failure frees the module for the next."""
        inner = _inner_queues.get()
        queue = self._queue if inner is None else inner.setdefault(self, ResourceQueue())
        turn = Ticket(queue, _ONE_AT_A_TIME if self.one_at_a_time else _TOGETHER).turn()
        with turn, Binding(_inner_queues, {}), performing(designator):
            checkpoint()
            solution: Mapping[str, object] = designator.reference()
            task = span("process-module", type(self).__name__, solution)
            task.decision = decision_of(designator)
            with task, uninterruptible():
                task.solution = solution
                task.result = result = run(self._execute, designator)
                return result

    @staticmethod
    def perform(designator: Designator) -> Result:
        """Perform a motion (thesis 4.9); return its process module's result.

        In the body of a block whose branches are concurrent, or are tried in order, return a future of that.

        Raises:
            DesignatorError: It isn't a designator, or can't be resolved.
            NoProcessModule: No process module takes it.
            PlanFailure: The world said no.
        """
        motion = _motion(designator)
        block = current_block()
        if block is None:
            with motion.span:
                motion.span.result = result = motion.carry_out()
                return result
        # queued already here if it can wait only for earlier motions
        ordered = block.immediate and not unfinished(designator)
        try:
            if ordered:
                motion.enqueue()
            return block.start(motion.name, motion.carry_out, ordered=ordered, dropped=motion.leave, span=motion.span)
        except BaseException:
            motion.leave()
            raise


def forget_claims() -> None:
    """Claim nothing of any robot or module any more: in a forked child, no motion but this branch's goes on."""
    forget_motions()
    _inner_queues.set({})


@refusing(name="perform")
def _motion(designator: Designator) -> Motion:
    if not isinstance(designator, Designator):
        raise DesignatorError(f"perform takes a designator, not {designator!r}", value=designator)
    if designator.performed_by:
        kind = type(designator).__name__
        problem = f"a {kind} is performed by {designator.performed_by}, not by ProcessModule.perform"
        raise DesignatorError(problem, value=designator)
    return Motion(designator, _world(), choose)


def choose(designator: Designator) -> Chosen:
    """Return the process module for a designator that can be resolved (thesis 4.8).

    Raises:
        NoProcessModule: There is none.
        NoWorld: The current world has no robot.
        BadArgument: A user's function returned something else.
    """
    for chooser in ProcessModule.resolvers:
        module = chooser(designator)
        if module is not None and not isinstance(module, ProcessModule):
            raise BadArgument(f"what {qualified_name(chooser)} chose", module, "a process module, or None")
        if module is not None:
            return Chosen(module, current_environment(), chooser=qualified_name(chooser))
    return module_for(str(designator.reference().get("cmd", "")), _world())


def _world() -> BulletWorld:
    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    return world
