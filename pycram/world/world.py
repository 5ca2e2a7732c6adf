"""Worlds: a physics simulation with objects and events (thesis 4.2, table 4.1).

The world that was opened last is current; when it ends, the previous world is current again. Simulated time passes, at
240 steps a second, only in :meth:`BulletWorld.simulate`, :meth:`BulletWorld.settle`, waits of plans and real time.
"""

from __future__ import annotations

import itertools
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Self, cast

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, UnknownName, WorldClosed
from pycram.foundation.refusals import refusing, refusing_methods
from pycram.physics.engine import Engine
from pycram.physics.window import checked_display, outlives_script
from pycram.scheduling.cancellation import uninterruptible
from pycram.world import driving, saved_state, simulation
from pycram.world.attachment import end
from pycram.world.beliefs import WorldBeliefs
from pycram.world.driving import Trajectories
from pycram.world.event import Event
from pycram.world.object import MaybeNone, Object
from pycram.world.overlaps import overlaps
from pycram.world.saved_state import SavedState
from pycram.world.simulation import RealtimeClock, Restless, Waits
from pycram.world.trajectory import Trajectory
from pycram.world.transaction import ReadOnlyAttributes, TransactionManager, WorldLock, update
from recorder import html, records
from recorder.tracing import context, journal
from recorder.tracing.call_stack import call_site
from recorder.tracing.context import current_name
from recorder.tracing.journal import Journal

__all__ = ["BulletWorld", "Object"]

_MAX_SECONDS: Final = 366 * 86400.0  # maximum simulated duration in s; a longer call is probably a mistake

_lock = threading.Lock()
_numbers = itertools.count(1)
_names: set[str] = set()


def number_anew() -> None:
    """Start the names of worlds from "world_1" again, in a forked process that runs a program from its start."""
    global _numbers  # noqa: PLW0603  the process has only one counter
    _numbers = itertools.count(1)


def _reserve_name(name: str | None) -> str:
    """Reserve a world's name until the world ends; None for the next free name of "world_1", "world_2", ..."""
    with _lock:
        if name is None:
            name = next(free for number in _numbers if (free := f"world_{number}") not in _names)
        elif checks.text("name", name) in _names:
            raise BadArgument("name", name, "a name that no open world has")
        _names.add(name)
        return name


def make_current(world: BulletWorld) -> None:
    """Make a world current; raise WorldClosed if the world has ended."""
    with _lock:
        if world.closed:
            raise WorldClosed(world.name, "become current")
        context.make_current(world)


def _remove(world: BulletWorld) -> None:
    with _lock:
        _names.discard(world.name)
        context.remove_world(world)


def open_worlds() -> tuple[BulletWorld, ...]:
    """Return the open worlds in the order in which they were last made current."""
    return cast("tuple[BulletWorld, ...]", context.open_worlds())


def current_world() -> BulletWorld | None:
    """Return the current world of this branch or thread; None if there is no world."""
    return cast("BulletWorld | None", context.current_world())


class CurrentWorld(type):
    """Metaclass that has the current world and its robot as attributes of the class, as in the thesis."""

    @property
    def current_bullet_world(cls) -> BulletWorld | MaybeNone:
        """The current world, which is the default for all functions that need a world; None if no world is open."""
        return current_world()

    @current_bullet_world.setter
    @refusing(name="current_bullet_world = ...")
    def current_bullet_world(cls, world: BulletWorld) -> None:
        if not isinstance(world, cls):
            raise BadArgument("current_bullet_world", world, "a world")
        make_current(world)

    @property
    def robot(cls) -> Object | MaybeNone:
        """The robot of the current world."""
        world = current_world()
        return world.robot if world is not None else None

    @robot.setter
    @refusing(name="robot = ...")
    def robot(cls, robot: Object | None) -> None:
        if robot is not None and not isinstance(robot, Object):
            raise BadArgument("robot", robot, 'an object of type "robot"')
        world = robot.world if robot is not None else current_world()
        if world is None:
            raise NoWorld
        world.set_robot(robot)


@refusing_methods("world")
class BulletWorld(ReadOnlyAttributes, metaclass=CurrentWorld):
    """A world. As a context manager, the world ends with the ``with`` block.

    All methods raise BadArgument for impossible values. Methods that change the world raise WorldClosed after its end,
    and ChangeRefused while a reasoning query runs.

    Args:
        type: "DIRECT" (without a window) or "GUI" (with a window).
        name: Name of the world in records, unique among open worlds; None for "world_1", "world_2", ...

    Raises:
        DisplayError: No window can open, or another window is open.
    """

    mode: str
    name: str
    _SUBJECT = "world"
    _CHANGED_BY = MappingProxyType(
        {
            "": "only methods of the world and of its objects change it",
            "gravity": "use set_gravity(gravity)",
            "sim_step": "use simulate(seconds)",
            "realtime": "use set_realtime(real_time)",
            "mode": 'open another world with BulletWorld("GUI") or BulletWorld("DIRECT")',
            "objects": "use Object(...) to load an object, and remove()",
            "robots": "use Object(...) to load a robot, and remove()",
            "closed": "use exit()",
            "exiting": "use exit()",
        }
    )

    def __init__(self, type: str = "DIRECT", name: str | None = None) -> None:  # noqa: A002  the original's name
        if type not in ("DIRECT", "GUI"):
            raise BadArgument("type", type, '"DIRECT" or "GUI"')
        self.mode = type
        self.name = _reserve_name(name)
        self.sim_step = 0
        self.gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.closed = False
        self.exiting = False
        self.transactions = TransactionManager(self)
        self.trajectories = Trajectories(self)
        self.beliefs = WorldBeliefs(self)
        self.waits = Waits()
        self.robots: tuple[Object, ...] = ()  # all robots; the first was loaded first
        self._objects: dict[str, Object] = {}
        self._robot: Object | None = None
        self._clock: RealtimeClock | None = None
        self._closers: list[Callable[[], None]] = []
        #: Functions that are called without a lock after simulated time has passed, in this order. The value for a
        #: function is the step at which a waiting plan stops simulating to call the function; None for each sample.
        self.time_listeners: dict[Callable[[], None], int | None] = {}
        self._attachment = Event("attachment", self.name, self._envelope, ("carrier", "body"))
        self._detachment = Event("detachment", self.name, self._envelope, ("carrier", "body"))
        self._manipulation = Event("manipulation", self.name, self._envelope, ("object",))
        with ExitStack() as undo:
            undo.callback(_remove, self)
            windows = [world.name for world in open_worlds() if world.mode == "GUI"]
            with checked_display(windows) if type == "GUI" else nullcontext():
                self.engine = Engine(window=type == "GUI")
            undo.callback(self.engine.close)
            undo.callback(journal.unregister, self)
            with self.transactions.begin(records.Mutation(open_world=records.OpenWorld(mode=type))):
                journal.register(self)
            undo.pop_all()
        self._seal(BulletWorld)
        make_current(self)
        if type == "GUI":
            outlives_script(self.engine, self.name)

    def __repr__(self) -> str:
        return f"BulletWorld({self.mode!r}, name={self.name!r})"

    def _repr_html_(self) -> str:
        if self.closed:
            return html.page(f"{self.name}: ended")
        rows = []
        for each in self.objects:
            position, orientation = map(html.vector, each.get_position_and_orientation())
            attached = ", ".join(other.name for other in each.attachments)
            rows.append((each.name, each.type, position, orientation, attached))
        title = f"{self.name}: {self.sim_step / records.STEPS_PER_SECOND:.3f} s simulated"
        columns = ("object", "type", "position, m", "orientation, xyzw", "attached to")
        return html.page(title, html.table(columns, rows))

    def __record__(self) -> object:
        """Return the world's reference in records."""
        return {"world": self.name}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.exit()

    def _envelope(self) -> tuple[str, int]:
        return self.name, self.sim_step

    # --- objects -----------------------------------------------------------------------------------------------------

    @property
    def lock(self) -> WorldLock:
        """The lock for consistent reading or changing of the world; event handlers run after its release."""
        return self.transactions.lock

    @property
    def objects(self) -> list[Object]:
        """All objects, in the order in which they were loaded."""
        return list(self._objects.values())

    @staticmethod
    def current_robot() -> Object:
        """Return the robot of the current world; raise NoWorld if there is no robot."""
        world = BulletWorld.current_bullet_world
        if world is None:
            raise NoWorld
        if world.robot is None:
            raise NoWorld("robot")
        return world.robot

    if TYPE_CHECKING:  # a declaration, because a property would hide that of the metaclass
        robot: Object | MaybeNone
    else:

        @property
        def robot(self) -> Object | None:
            """The robot that plans control in this world."""
            return self._robot

        @robot.setter
        @refusing("world", name="robot = ...")
        def robot(self, robot: Object | None) -> None:
            self.set_robot(robot)

    def set_robot(self, robot: Object | None) -> None:
        """Set the robot that plans control in this world; None for no robot."""
        if robot is not None and (not isinstance(robot, Object) or not robot.is_robot or robot.world is not self):
            raise BadArgument("robot", robot, f'an object of type "robot" in {self.name}')
        with self.transactions.begin(records.Mutation(set_robot=records.SetRobot(body=robot.name if robot else ""))):
            self._robot = robot

    def get_objects_by_name(self, name: str) -> list[Object]:
        """Return the objects with a name: one object or none."""
        return [body for body in self.objects if body.name == name]

    def get_objects_by_type(self, type: str) -> list[Object]:  # noqa: A002  the original's name
        """Return the objects of a type."""
        return [body for body in self.objects if body.type == type]

    def get_object_by_id(self, id: int) -> Object:  # noqa: A002  the original's name
        """Return the object with a PyBullet id; raise UnknownName if no object has it."""
        for body in self.objects:
            if body.id == id:
                return body
        raise UnknownName("object with id", id, self.name, (f"{body.id} ({body.name})" for body in self.objects))

    def get_object(self, name: str) -> Object:
        """Return the object with a name; raise UnknownName if there is none."""
        if checks.text("name", name) not in self._objects:
            raise UnknownName("object", name, self.name, self._objects)
        return self._objects[name]

    def add(self, body: Object) -> None:
        """Load an object's model; the object's constructor calls this."""
        command = records.Mutation(load_body=records.LoadBody(body=body.name))
        with self.transactions.begin(command) as transaction:
            if body.name in self._objects:
                raise BadArgument("name", body.name, f"a name that no object in {self.name} has")
            loading = body.model.loading
            handle = self.engine.load(
                body.model.path,
                body.original_pose,
                fixed=body.fixed,
                robot=body.is_robot,
                loading=loading,
                start=loading.start(body.urdf),
            )
            update(body, _handle=handle)
            torso = body.description.torso if body.description else None
            if torso is not None:
                raised = {torso.joint: torso.default}
                self.engine.set_joints(handle, raised | (body.urdf.followers(raised) if loading.mimic else {}))
            start = dict(zip(body.joints, self.engine.joints(handle)[0], strict=True))
            update(body, original_joints=MappingProxyType(start))
            if body.color is not None:
                self.engine.set_color(handle, body.color)
            self._objects[body.name] = body
            if body.is_robot:
                update(self, robots=(*self.robots, body))
            update(body, overlaps=tuple(overlaps(body)))
            if journal.recording():
                journal.attach(body.model.files)
                command.load_body.CopyFrom(body.load_record)
            transaction.mark_modified(body)

    def remove(self, body: Object) -> None:
        """Remove an object; raise WorldClosed if it was removed before."""
        with self.transactions.begin(records.Mutation(remove_body=records.RemoveBody(body=body.name))) as transaction:
            handle = body.handle
            self.trajectories.end_all(body)
            for attachment in list(body.attachments.values()):
                end(attachment, transaction)
            self.engine.remove(handle)
            update(body, _handle=None)
            del self._objects[body.name]
            update(self, robots=tuple(robot for robot in self.robots if robot is not body))
            if self._robot is body:
                self._robot = None
            transaction.removed.append(body.name)

    # --- events ------------------------------------------------------------------------------------------------------

    def get_attachment_event(self) -> Event:
        """Return the event that fires with (carrier, body) when an object is attached to another object."""
        return self._attachment

    def get_detachment_event(self) -> Event:
        """Return the event that fires with (carrier, body) when an attachment ends."""
        return self._detachment

    def get_manipulation_event(self) -> Event:
        """Return the event that fires with (object) when an object of the environment, or one of its joints, moves."""
        return self._manipulation

    # --- physics -----------------------------------------------------------------------------------------------------

    @property
    def realtime(self) -> bool:
        """Whether the world is simulated at the pace of the wall clock."""
        return self._clock is not None

    def set_gravity(self, gravity: Sequence[float]) -> None:
        """Set gravity to [x, y, z] in m/s^2."""
        vector = checks.vector("gravity", gravity)
        with self.transactions.begin(records.Mutation(set_gravity=records.SetGravity(gravity=vector))):
            self.engine.set_gravity(vector)
            update(self, gravity=vector)

    def set_realtime(self, real_time: bool) -> None:
        """Start or stop a thread that simulates the world at the pace of the wall clock.

        Raises:
            Exception: The first error of an event handler in the thread of real time, when real time stops.
        """
        enabled = checks.switch("real_time", real_time)
        stopped = None
        with self.transactions.begin(records.Mutation(set_realtime=records.SetRealtime(enabled=enabled))):
            if enabled and self._clock is None:
                self._clock = RealtimeClock(self)
                self._clock.start()
            elif not enabled:
                stopped, self._clock = self._clock, None
        self.waits.wake()  # another thread simulates now
        if stopped is not None:
            stopped.stop()  # stopped without the lock, because the thread may be waiting for it

    def simulate(self, seconds: float) -> None:
        """Simulate ``round(seconds * 240)`` steps, at most a year."""
        self.simulate_steps(round(checks.in_range("seconds", seconds, 0, _MAX_SECONDS) * records.STEPS_PER_SECOND))

    def simulate_steps(self, steps: int) -> None:
        """Simulate steps of 1/240 s; raise WorldClosed if another thread ends the world during the simulation."""
        steps = checks.count("steps", steps)
        with self.transactions.begin(records.Mutation(simulate=records.Simulate(steps=steps))) as transaction:
            completed = simulation.simulate(self, steps, transaction)
        if self.exiting and not completed:
            raise WorldClosed(self.name, "continue its simulation")

    def settle(self, timeout: float = 5.0) -> bool:
        """Simulate until all objects are at rest (:class:`~pycram.world.simulation.RestDetector`).

        Free objects that overlap by more than 5 mm are first lifted apart. If objects still move at the end, the
        warning :class:`~pycram.world.simulation.Restless` has their names and speeds.

        Args:
            timeout: Limit in simulated seconds, at most a year.

        Returns:
            True if all objects are at rest.

        Raises:
            WorldClosed: Another thread ends the world during the simulation.
        """
        steps = round(checks.in_range("timeout", timeout, 0, _MAX_SECONDS) * records.STEPS_PER_SECOND)
        with self.lock:
            simulation.separate(self)
            restless, completed = simulation.settle(self, steps)
        if self.exiting and not completed:
            raise WorldClosed(self.name, "continue its simulation")
        if restless:
            warnings.warn_explicit(Restless(steps / records.STEPS_PER_SECOND, restless), Restless, *call_site())
        return not restless

    def begin_trajectory(self, body: Object, trajectory: Trajectory, search: records.PathSearch | None = None) -> int:
        """Make a body follow a trajectory in all simulations; return the trajectory's number.

        :func:`pycram.world.driving.follow` also waits for the trajectory's end.

        Args:
            body: An object of this world; a base moves only if the body is a robot or of the environment.
            trajectory: A trajectory that starts at the body's present position.

        Raises:
            BadArgument: The body can't follow the trajectory, or isn't at its start.
            FollowsTrajectory: A joint of the trajectory, or the base, follows another trajectory.
        """
        return driving.begin(self, body, trajectory, search).number

    def stop_trajectory(self, number: int) -> None:
        """Slow a trajectory down along its path until it ends, within 0.15 s of simulated time.

        Raises:
            UnknownName: No body follows a trajectory with this number.
        """
        driving.stop(self, checks.count("number", number))

    def prepare_time_listeners(self) -> Callable[[], None]:
        """Return a function that calls the present time listeners."""
        listeners = tuple(self.time_listeners)

        def notify() -> None:
            for listener in listeners:
                listener()

        return notify

    def reset(self) -> None:
        """Set all objects to their poses and joint positions at loading; attachments and trajectories end.

        Simulated time and colours don't change.
        """
        with self.transactions.begin(records.Mutation(reset=records.Reset())) as transaction:
            self.trajectories.end_all()
            for body in self.objects:
                for attachment in list(body.attachments.values()):
                    end(attachment, transaction)
            for body in self.objects:
                self.engine.set_joints(body.handle, body.original_joints)
                self.engine.set_pose(body.handle, body.original_pose)
                transaction.mark_modified(body)
                if body.is_environment:
                    transaction.fire(self._manipulation, body)

    def save(self) -> SavedState:
        """Return the present state of the world for :meth:`restore` (:mod:`pycram.world.saved_state`)."""
        return saved_state.save(self)

    def restore(self, saved: SavedState) -> None:
        """Restore a saved state as one change; all trajectories end. Simulated time and colours don't change.

        Raises:
            ObjectsChanged: Objects were loaded or removed since the state was saved.
        """
        saved_state.restore(self, saved)

    # --- recording and end -------------------------------------------------------------------------------------------

    def record_keyframe(self, journal: Journal) -> None:
        """Append a keyframe to the journal of a recording that starts after the world was opened."""
        with self.lock:
            if self.closed:
                return
            for body in self.objects:
                journal.attach(body.model.files)
            frame = self.transactions.keyframe()
            del frame.beliefs[:]
            frame.beliefs.extend(self.beliefs.records(journal))
            frame.world, frame.sim_step = self.name, self.sim_step
            frame.thread = current_name()
            journal.append(frame)

    def at_exit(self, close: Callable[[], None]) -> None:
        """Register a function that is called, under the world's lock, when the world ends."""
        if not callable(close):
            raise BadArgument("close", close, "a function")
        self._closers.append(close)

    @uninterruptible()
    def exit(self) -> None:
        """End the world with its window and its threads; a second call does nothing.

        Raises:
            Exception: The first error of an :meth:`at_exit` function or of a handler in real time, after the end.
        """
        update(self, exiting=True)  # a simulation of another thread stops early when this is set
        with self.lock:
            if self.closed:
                return
            self.transactions.query = ""  # a query that failed must not prevent the end of the world
        with ExitStack() as ending:
            ending.callback(self._close)
            if self._clock is not None:
                self.set_realtime(False)

    def _close(self) -> None:
        with self.lock, ExitStack() as ending:
            if self.closed:
                return
            for end in (self._end, *self._closers):
                ending.callback(end)
            with self.transactions.begin(records.Mutation(close_world=records.CloseWorld())):
                self._end()

    def _end(self) -> None:
        """End the world without a record; a second call does nothing."""
        if self.closed:
            return
        update(self, closed=True)
        journal.unregister(self)
        for body in self.objects:
            update(body, _handle=None)
        self._robot = None
        self.trajectories.end_all()
        self.waits.wake()
        self.engine.close()
        _remove(self)
