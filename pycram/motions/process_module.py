"""Process modules: the code that carries a motion out on one robot, in one execution environment (thesis 4.7-4.9).

``ProcessModule.perform(designator)`` resolves the designator, chooses the module and runs it. The plan names neither
robot nor module: which modules there are is said by :func:`register`, by robot and environment.
"""

from __future__ import annotations

import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from pycram.claims import Claims, ResourceQueue
from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, UsageError
from pycram.foundation.names import export, qualified_name
from pycram.language.actions import run
from pycram.language.body import current_block
from pycram.motions.designator import Designator, DesignatorError, unfinished
from pycram.motions.resolvers import Resolvers
from pycram.scheduling.binding import Binding
from pycram.scheduling.cancellation import checkpoint, uninterruptible
from pycram.scheduling.future import branches_in
from pycram.world.world import BulletWorld
from recorder.tracing.span import Span, span

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.claims import Ticket
    from pycram.world.object import Object

Result: TypeAlias = Any
Chooser: TypeAlias = Callable[[Designator], "ProcessModule | None"]
Modules: TypeAlias = Mapping[str, "ProcessModule"]

SIMULATED = "simulated"
_MODULE = Claims(moves=frozenset({"module"}))

_environment: ContextVar[str] = ContextVar("pycram_environment", default=SIMULATED)
_registered: dict[tuple[str, str], Modules] = {}
_by_default: dict[str, Callable[[], Modules]] = {}
_of_world: weakref.WeakKeyDictionary[BulletWorld, tuple[ResourceQueue, dict[tuple[str, str], Modules]]] = (
    weakref.WeakKeyDictionary()
)
_lock = threading.Lock()

# Motions that one motion is made of queue among themselves, for what that one holds, and so do the process modules that
# one module makes use of. Who is queued waits on his own level only, so none waits for one that waits for him.
_parts: ContextVar[ResourceQueue | None] = ContextVar("pycram_parts", default=None)
_modules: ContextVar[dict[ProcessModule, ResourceQueue] | None] = ContextVar("pycram_modules", default=None)


class NoProcessModule(UsageError):
    """No process module takes a designator.

    Attributes:
        cmd: what is to be done.
        robot: the robot.
        environment: the execution environment.
        known: what its modules do.
    """

    def __init__(self, cmd: str, robot: str, environment: str, known: list[str]) -> None:
        super().__init__(
            f"no process module of {robot} in the {environment} environment takes {cmd!r}; "
            f"it has modules for {', '.join(known) or 'nothing'}; add one with register() or ProcessModule.resolvers"
        )
        self.cmd = cmd
        self.robot = robot
        self.environment = environment
        self.known = known


export("pycram.process_module", NoProcessModule)


@contextmanager
def execution_environment(name: str) -> Iterator[None]:
    """Chooses the process modules of an environment for what its block performs.

    Args:
        name: "simulated" (the default everywhere), or one that modules are registered for.
    """
    token = _environment.set(name)
    try:
        yield
    finally:
        _environment.reset(token)


def register(robot: str, environment: str, modules: Modules) -> None:
    """Says which process modules serve a robot in an environment; replaces what was said before.

    Args:
        robot: the robot's name in its URDF.
        environment: the execution environment.
        modules: by the ``cmd`` of the solutions that they take.

    Raises:
        BadArgument: something else than process modules.
    """
    known = isinstance(modules, Mapping) and all(isinstance(module, ProcessModule) for module in modules.values())
    if not known:
        raise BadArgument("modules", modules, "process modules by cmd, such as {'looking': Looking()}")
    with _lock:
        _registered[checks.text("robot", robot), checks.text("environment", environment)] = dict(modules)


def serve(environment: str, modules: Callable[[], Modules]) -> None:
    """Says which process modules serve, in an environment, every robot that has a description and none of its own.

    Args:
        environment: the execution environment.
        modules: makes a new set, by the ``cmd`` of the solutions that they take; called once for each robot.
    """
    with _lock:
        _by_default[environment] = modules


class ProcessModule(ABC):
    """Carries out one kind of motion, one designator at a time, in order of arrival.

    It may perform other motions to do so: these are parts of its own, within what that claims.
    """

    resolvers: ClassVar[Resolvers[Chooser]] = Resolvers("process modules")
    """Functions that choose a module for a designator, or None; asked before the registered ones.

    Like resolvers, they are asked when the motion's turn has come. What they perform is part of it."""

    def __init__(self) -> None:
        self._arrivals = ResourceQueue()

    @abstractmethod
    def _execute(self, designator: Designator) -> Result:
        """Carries a designator out.

        Args:
            designator: what to do; its ``reference()`` has the parameters.

        Returns:
            What the plan gets from ``perform``.

        Raises:
            PlanFailure: the world said no; the world is consistent then.
        """

    def claims(self, designator: Designator) -> Claims | None:
        """What carrying a designator out needs of the robot; asked when it is resolved, before anything moves.

        The claims of PyCRAM's own motions are known by the solution's ``cmd``. A module for another ``cmd`` gets the
        whole robot, unless it says here what it needs, for itself and for all motions that it performs::

            def claims(self, designator):
                return Claims(moves={"left-arm"}, at_rest={"base"})

        Args:
            designator: what to do.

        Returns:
            The claims; None: nobody knows, all that there is.
        """
        return designator.claims()

    def execute(self, designator: Designator) -> Result:
        """Carries a designator out when all that came before are done; a failure frees the module for the next.

        Args:
            designator: what to do.
        """
        queues = _modules.get()
        arrivals = self._arrivals if queues is None else queues.setdefault(self, ResourceQueue())
        with arrivals.ticket(_MODULE).turn(), Binding(_modules, {}):
            checkpoint()
            solution = designator.reference()
            with span("process-module", type(self).__name__, solution) as task, uninterruptible():
                task.solution = solution
                task.result = result = run(self._execute, designator)
                return result

    @staticmethod
    def perform(designator: Designator) -> Result:
        """Performs a motion (thesis 4.9).

        Args:
            designator: what to do.

        Returns:
            What its process module returns; in the body of a block that runs side by side, or tries in order, a handle
            that serves as that.

        Raises:
            DesignatorError: it isn't a designator, or can't be resolved.
            NoProcessModule: no process module takes it.
            PlanFailure: the world said no.
        """
        if not isinstance(designator, Designator):
            raise DesignatorError(f"perform takes a designator, not {designator!r}", value=designator)
        motion = _Motion(designator, _parts.get() or _state(_world())[0])
        block = current_block()
        if block is None:
            with motion.span:
                motion.span.result = result = motion.carry_out()
                return result
        # its place in the queue is taken here if nothing but earlier ones can then keep it waiting
        ordered = block.immediate and not unfinished(designator)
        try:
            if ordered:
                motion.arrive()
            return block.start(motion.name, motion.carry_out, ordered=ordered, dropped=motion.leave, span=motion.span)
        except BaseException:
            motion.leave()
            raise


def _world() -> BulletWorld:
    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    return world


def _state(world: BulletWorld) -> tuple[ResourceQueue, dict[tuple[str, str], Modules]]:
    with _lock:
        return _of_world.setdefault(world, (ResourceQueue(), {}))


class _Motion:
    """A designator that is to be carried out.

    Attributes:
        name: its type.
        span: its node of the task tree.
    """

    def __init__(self, designator: Designator, queue: ResourceQueue) -> None:
        self.name = str(dict(designator.description).get("type", type(designator).__name__))
        self._designator = designator
        self._queue = queue
        self._claims = designator.claims()
        self._ticket: Ticket | None = None
        slots = {key: value for key, value in designator.description if key != "type"}
        self.span = Span("motion", self.name, parameters=slots)

    def arrive(self) -> Ticket:
        """Takes its place among those that wait for parts of the robot."""
        self._ticket = self._queue.ticket(self._claims, self.name)
        self._ticket.arrive()
        return self._ticket

    def leave(self) -> None:
        """Gives its place up, if it has one."""
        if self._ticket is not None:
            self._ticket.leave()

    def carry_out(self) -> Result:
        """Waits for its turn and does it, as the task that its span is."""
        designator = self._designator
        try:
            for branch in branches_in([value for _, value in designator.description]):
                branch.result()  # waits for what may wait itself, while it holds nothing of the robot
            ticket = self._ticket or self.arrive()
            with ticket.turn():
                checkpoint()
                with Binding(_parts, ResourceQueue(ticket.claims)):  # for what resolvers perform
                    self.span.solution = designator.reference()
                    module = choose(designator)
                    claims = module.claims(designator)
                ticket.change(claims)
                with Binding(_parts, ResourceQueue(ticket.claims)):
                    return module.execute(designator)
        finally:
            self.leave()


def choose(designator: Designator) -> ProcessModule:
    """The process module for a designator (thesis 4.8).

    Args:
        designator: one that can be resolved.

    Raises:
        NoProcessModule: there is none.
        NoWorld: the current world has no robot.
        BadArgument: a user's function has chosen something else.
    """
    for chooser in ProcessModule.resolvers:
        module = chooser(designator)
        if module is not None and not isinstance(module, ProcessModule):
            raise BadArgument(f"what {qualified_name(chooser)} chose", module, "a process module, or None")
        if module is not None:
            return module
    cmd = str(designator.reference().get("cmd", ""))
    world = _world()
    if world.robot is None:
        raise NoWorld("robot")
    modules = modules_of(world, world.robot)
    if cmd not in modules:
        raise NoProcessModule(cmd, world.robot.urdf.name, _environment.get(), sorted(modules))
    return modules[cmd]


def modules_of(world: BulletWorld, robot: Object) -> Modules:
    """The modules that serve a robot in the present environment.

    Args:
        world: its world.
        robot: the robot.
    """
    environment = _environment.get()
    registered = _registered.get((robot.urdf.name, environment))
    if registered is not None:
        return registered
    make = _by_default.get(environment)
    if make is None or robot.description is None:
        return {}
    made = _state(world)[1]
    with _lock:
        if (robot.name, environment) not in made:
            made[robot.name, environment] = make()
        return made[robot.name, environment]
