"""Worlds: a physics simulation, the objects in it, and its events (thesis 4.2, table 4.1).

Any number of worlds may be open. The one that was opened last is current; when it ends, the one before it is current
again. Physics runs in :meth:`BulletWorld.simulate` and in real time only, 240 steps a second.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, UnknownName, WorldClosed
from pycram.physics.engine import Engine
from pycram.physics.window import check_display
from pycram.scheduling.cancellation import uninterruptible
from pycram.world import carried, current
from pycram.world.attachment import end
from pycram.world.current import CurrentWorld
from pycram.world.event import Event
from pycram.world.object import Object
from pycram.world.realtime import RealtimeClock
from pycram.world.transaction import Reading, TransactionManager, read
from recorder import records, threads
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType
    from typing import Self

    from pycram.world.lock import WorldLock
    from pycram.world.transaction import Change
    from recorder.tracing.journal import Journal

__all__ = ["BulletWorld", "Object"]

_SAMPLE_STEPS: Final = records.STEPS_PER_SECOND // 30
_LONGEST: Final = 366 * 86400.0  # s; what is longer is a mistake
_MOVED: Final = 1e-4  # rad or m by which a joint of the environment has to move in a simulated stretch to be news


class BulletWorld(metaclass=CurrentWorld):
    """A world.

    Args:
        type: "DIRECT" (headless) or "GUI" (a window).
        name: how records call it; "world_1", "world_2", ... by default.

    Raises:
        BadArgument: another type.
        DisplayError: no window can open, or one is open already.
    """

    mode: str
    name: str

    def __init__(self, type: str = "DIRECT", name: str | None = None) -> None:  # noqa: A002  the original's name
        if type not in ("DIRECT", "GUI"):
            raise BadArgument("type", type, '"DIRECT" or "GUI"')
        if type == "GUI":
            check_display(open_windows=[world.name for world in current.opened() if world.mode == "GUI"])
        self.mode = type
        self.name = current.take_name(name)
        self.sim_step = 0
        self.gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.closed = False
        self._ending = False
        self.transactions = TransactionManager(self)
        self._objects: dict[str, Object] = {}
        self._robot: Object | None = None
        self._clock: RealtimeClock | None = None
        self._closers: list[Callable[[], None]] = []
        self.alarms: set[Callable[[], None]] = set()  # called, without a lock, when simulated time has passed
        self._attachment = Event("attachment", self.name, self._envelope, ("carrier", "body"))
        self._detachment = Event("detachment", self.name, self._envelope, ("carrier", "body"))
        self._manipulation = Event("manipulation", self.name, self._envelope, ("object",))
        with ExitStack() as undoing:
            undoing.callback(current.leave, self.name)
            self.engine = Engine(window=type == "GUI")
            undoing.callback(self.engine.close)
            undoing.callback(journal.unregister, self)
            with self.transactions.change(records.Mutation(open_world=records.OpenWorld(mode=type))):
                journal.register(self)
            undoing.pop_all()
        current.enter(self)

    def __repr__(self) -> str:
        return f"BulletWorld({self.mode!r}, name={self.name!r})"

    def __record__(self) -> object:
        """How it stands in records."""
        return {"world": self.name}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.exit()

    def _envelope(self) -> tuple[str, int]:
        return self.name, self.sim_step

    # --- what is in it ---------------------------------------------------------------------------------------------

    @property
    def lock(self) -> WorldLock:
        """Held while something reads or changes this world consistently; handlers of events run when it is free."""
        return self.transactions.lock

    @property
    def objects(self) -> list[Object]:
        """All objects, in the order in which they were loaded."""
        return list(self._objects.values())

    @staticmethod
    def current_robot() -> Object:
        """The robot of the current world, for what can't go on without one.

        Raises:
            NoWorld: there is no world, or no robot in it.
        """
        world = BulletWorld.current_bullet_world
        if world is None:
            raise NoWorld
        if world.robot is None:
            raise NoWorld("robot")
        return world.robot

    @property
    def robot(self) -> Object | None:
        """The robot that plans control in this world."""
        return self._robot

    @robot.setter
    def robot(self, robot: Object | None) -> None:
        self.set_robot(robot)

    def set_robot(self, robot: Object | None) -> None:
        """Says which object plans control.

        Raises:
            BadArgument: it isn't a robot of this world.
        """
        if robot is not None and (not isinstance(robot, Object) or not robot.is_robot or robot.world is not self):
            raise BadArgument("robot", robot, f'an object of type "robot" in {self.name}')
        command = records.SetRobot(body=robot.name if robot else "")
        with self.transactions.change(records.Mutation(set_robot=command)):
            self._robot = robot

    def get_objects_by_name(self, name: str) -> list[Object]:
        """The objects of that name: one, or none."""
        return [body for body in self.objects if body.name == name]

    def get_objects_by_type(self, type: str) -> list[Object]:  # noqa: A002  the original's name
        """The objects of that type."""
        return [body for body in self.objects if body.type == type]

    def get_object_by_id(self, id: int) -> Object:  # noqa: A002  the original's name
        """The object with that PyBullet id.

        Raises:
            UnknownName: there is none.
        """
        for body in self.objects:
            if body.id == id:
                return body
        raise UnknownName("object with id", id, self.name, (f"{body.id} ({body.name})" for body in self.objects))

    def get_object(self, name: str) -> Object:
        """The object of that name.

        Raises:
            BadArgument: not a name.
            UnknownName: there is none.
        """
        if checks.text("name", name) not in self._objects:
            raise UnknownName("object", name, self.name, self._objects)
        return self._objects[name]

    def add(self, body: Object) -> None:
        """Loads an object's model; called by its constructor."""
        command = records.Mutation(load_body=records.LoadBody(body=body.name))
        with self.transactions.change(command) as change:
            if body.name in self._objects:
                raise BadArgument("name", body.name, f"a name that nothing in {self.name} has")
            handle = self.engine.load(body.model.path, body.original_pose, fixed=body.fixed, robot=body.is_robot)
            body.handle = handle
            torso = body.description.torso if body.description else None
            if torso is not None:
                self.engine.set_joints(handle, {torso.joint: torso.default})
            body.original_joints = dict(zip(body.joints, self.engine.joints(handle)[0], strict=True))
            if body.color is not None:
                self.engine.set_color(handle, body.color)
            self._objects[body.name] = body
            if journal.recording():
                journal.attach(body.model.files)
                command.load_body.CopyFrom(body.load_record)
            change.touch(body)

    def take_out(self, body: Object) -> None:
        """Removes an object; called by its ``remove``.

        Raises:
            WorldClosed: it isn't there any more.
        """
        command = records.Mutation(remove_body=records.RemoveBody(body=body.name))
        with self.transactions.change(command) as change:
            handle = body.handle
            for attachment in list(body.attachments.values()):
                end(attachment, change)
            self.engine.remove(handle)
            body.handle = None
            del self._objects[body.name]
            if self._robot is body:
                self._robot = None
            change.removed.append(body.name)

    # --- events ----------------------------------------------------------------------------------------------------

    def get_attachment_event(self) -> Event:
        """Fired with (carrier, body) when an object is attached to another."""
        return self._attachment

    def get_detachment_event(self) -> Event:
        """Fired with (carrier, body) when an attachment ends."""
        return self._detachment

    def get_manipulation_event(self) -> Event:
        """Fired with (object) when something changed the joints or the pose of an environment's object."""
        return self._manipulation

    # --- physics ---------------------------------------------------------------------------------------------------

    @property
    def realtime(self) -> bool:
        """Whether it is simulated at the pace of the clock."""
        return self._clock is not None

    def set_gravity(self, gravity: Sequence[float]) -> None:
        """Sets the gravity.

        Args:
            gravity: [x, y, z] in m/s^2.

        Raises:
            BadArgument: not 3 finite numbers.
        """
        vector = checks.vector("gravity", gravity)
        with self.transactions.change(records.Mutation(set_gravity=records.SetGravity(gravity=vector))):
            self.engine.set_gravity(vector)
            self.gravity = vector

    def set_realtime(self, real_time: bool) -> None:
        """Starts or stops simulating at the pace of the clock, in a thread of its own.

        Args:
            real_time: on or off.

        Raises:
            BadArgument: neither.
            Exception: when it is stopped, the first error that a handler of an event raised in that thread.
        """
        enabled = checks.switch("real_time", real_time)
        stopped = None
        with self.transactions.change(records.Mutation(set_realtime=records.SetRealtime(enabled=enabled))):
            if enabled and self._clock is None:
                self._clock = RealtimeClock(self)
                self._clock.start()
            elif not enabled:
                stopped, self._clock = self._clock, None
        if stopped is not None:
            stopped.stop()  # outside of the lock, which its last stretch may be waiting for

    def simulate(self, seconds: float) -> None:
        """Lets time run.

        Args:
            seconds: simulated time; ``round(seconds * 240)`` steps.

        Raises:
            BadArgument: not a number from 0 to a year's seconds.
        """
        duration = checks.number("seconds", seconds)
        if not 0 <= duration <= _LONGEST:
            raise BadArgument("seconds", seconds, f"a number from 0 to {_LONGEST:g}")
        self.simulate_steps(round(duration * records.STEPS_PER_SECOND))

    def simulate_steps(self, steps: int) -> None:
        """Lets time run.

        Args:
            steps: how many, of 1/240 s each.

        Raises:
            BadArgument: not a whole number from 0 up.
            WorldClosed: another thread has ended the world meanwhile.
        """
        steps = checks.count("steps", steps)
        with self.transactions.change(records.Mutation(simulate=records.Simulate(steps=steps))) as change:
            environment = {body: self.engine.joints(body.handle)[0] for body in self.objects if body.is_environment}
            self._step(steps, change)
            change.touch(*self.objects)
            change.events.append(self._ring)
            for body, before in environment.items():
                after = self.engine.joints(body.handle)[0]
                if any(not math.isclose(a, b, abs_tol=_MOVED) for a, b in zip(before, after, strict=True)):
                    change.events.append(partial(self._manipulation.prepare, body))
        if self._ending and change.command.simulate.steps < steps:
            raise WorldClosed(self.name, "simulate on")

    def _step(self, steps: int, change: Change) -> None:
        """Steps in stretches; an interrupt or the world's end ends it after one, and what was done is the change."""
        recording = journal.recording()
        last: dict[str, Reading] = {body.name: read(body) for body in self.objects} if recording else {}
        done = 0
        while done < steps and not (change.hold.noted or self._ending):
            stretch = min(_SAMPLE_STEPS - self.sim_step % _SAMPLE_STEPS, steps - done)
            self.engine.step(stretch)
            for body in self.objects:
                if body.fixed:  # what hangs on it in chains has given way a little: solvers do
                    carried.follow(body, change)
            self.sim_step += stretch
            done += stretch
            if done == steps:  # the end itself is the effect
                break
            if self.transactions.observer is not None:
                self.transactions.observer.passed()
            if recording:
                sample = self.transactions.sample(self.sim_step, last)
                if sample is not None:
                    change.samples.append(sample)
        change.command.simulate.steps = done

    def _ring(self) -> Callable[[], None]:
        alarms = tuple(self.alarms)

        def ring() -> None:
            for alarm in alarms:
                alarm()

        return ring

    def reset(self) -> None:
        """Puts every object back to where it was loaded, with its joints; attachments end, time and colours stay."""
        with self.transactions.change(records.Mutation(reset=records.Reset())) as change:
            for body in self.objects:
                for attachment in list(body.attachments.values()):
                    end(attachment, change)
            for body in self.objects:
                self.engine.set_joints(body.handle, body.original_joints)
                self.engine.set_pose(body.handle, body.original_pose)
                change.touch(body)
                if body.is_environment:
                    change.events.append(partial(self._manipulation.prepare, body))

    # --- recording and end -----------------------------------------------------------------------------------------

    def record_keyframe(self, journal: Journal) -> None:
        """Tells a journal the whole state, for recordings that start when the world exists already."""
        with self.lock:
            if self.closed:
                return
            for body in self.objects:
                journal.attach(body.model.files)
            frame = self.transactions.keyframe()
            frame.world, frame.sim_step = self.name, self.sim_step
            frame.thread = threads.name()
            journal.append(frame)

    def at_exit(self, close: Callable[[], None]) -> None:
        """Ends something together with the world.

        Args:
            close: called once, with the world's lock held.

        Raises:
            BadArgument: it can't be called.
        """
        if not callable(close):
            raise BadArgument("close", close, "something that can be called")
        self._closers.append(close)

    @uninterruptible()
    def exit(self) -> None:
        """Ends the world at once, its window and its threads; a second call does nothing.

        Raises:
            Exception: the first error of what :meth:`at_exit` was given or of handlers in real time; all has ended.
        """
        self._ending = True  # a simulation that runs in another thread makes way
        with self.lock:
            if self.closed:
                return
            self.transactions.query = ""  # a query that dies in an exception can't keep its world from ending
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
            with self.transactions.change(records.Mutation(close_world=records.CloseWorld())):
                self._end()

    def _end(self) -> None:
        """Ends all but the record of it, once."""
        if self.closed:
            return
        self.closed = True
        journal.unregister(self)
        for body in self.objects:
            body.handle = None
        self._robot = None
        self.engine.close()
        current.leave(self.name)
