"""Simulated time of a world: steps of 1/240 s, waits, objects at rest, and real time.

Every simulation is one transaction; its record has 30 samples for each simulated second.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.failures import ChangeRefused, WorldClosed
from pycram.physics.body import Snapshot
from pycram.scheduling.cancellation import CancelScope, current_scope, join, raise_if_cancelled, uninterruptible
from pycram.scheduling.schedule import Condition, Waiter, scheduler
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.overlaps import DEEP, sunk
from pycram.world.transaction import Transaction, state_delta, take_snapshot, update
from recorder import geometry, records
from recorder.tracing import journal

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

SLOW: Final = 2e-3  # maximum speed in m/s of an object at rest
SLOW_TURN: Final = 2e-2  # maximum angular speed in rad/s of an object at rest
INTERVALS: Final = 4  # number of successive intervals in which an object must be slow before it is at rest
_GAIN: Final = 1.15  # largest gain of speed over these intervals; a 2 m high shelf that starts to tip gains more
_STRAY: Final = 0.25  # duration in s; an object at rest may move as far as the slow speed leads in this time
_TREMBLES: Final = 3 * records.STEPS_PER_SECOND  # number of steps after which a trembling object is at rest
_TO_AND_FRO: Final = 4.0  # minimum ratio of the path length of a trembling object to its displacement
_NOISE: Final = 0.1  # smaller changes of speed, as shares of the slow speed, are noise of the solver

_MAX_LISTED: Final = 5  # largest number of objects in a warning

_SAMPLE_STEPS: Final = records.STEPS_PER_SECOND // 30
_SAMPLE_TOLERANCE: Final = 1e-5  # minimum movement in m or rad of objects in a sample
_MANIPULATION_TOLERANCE: Final = 1e-4  # minimum movement in rad or m of a furniture joint that fires an event
_MAX_WAIT_STEPS: Final = 10 * records.STEPS_PER_SECOND  # maximum number of steps in one record of a wait

_PERIOD: Final = 1 / 30  # seconds of real time in one record
_MAX_LAG: Final = 0.1  # largest lag in s that real time makes up for; a slow machine could never catch up with more


def simulate(world: BulletWorld, steps: int, transaction: Transaction, until: Callable[[], bool] | None = None) -> bool:
    """Simulate steps of 1/240 s in a transaction. Return False if Ctrl-C or the end of the world stops the simulation.

    The simulation stops between two samples, and the record has the number of simulated steps. ``until`` is called
    after each 1/30 s of simulated time and at the end; True ends the simulation.
    """
    engine = world.engine
    joints = {body: engine.joints(body.handle)[0] for body in world.objects if body.is_environment}
    driven = list(world.trajectories.active.values())
    for followed in driven:
        followed.begin_stretch()
    done, ended = _step(world, steps, transaction, until)
    transaction.command.simulate.steps = done
    transaction.command.simulate.driven.extend(followed.driven() for followed in driven)
    transaction.mark_modified(*world.objects)
    transaction.callbacks.append(world.prepare_time_listeners)
    for body, before in joints.items():
        after = engine.joints(body.handle)[0]
        if any(not math.isclose(a, b, abs_tol=_MANIPULATION_TOLERANCE) for a, b in zip(before, after, strict=True)):
            transaction.fire(world.get_manipulation_event(), body)
    return ended or done == steps


def _step(
    world: BulletWorld, steps: int, transaction: Transaction, until: Callable[[], bool] | None
) -> tuple[int, bool]:
    """Return the number of simulated steps, and whether ``until`` ended the simulation."""
    recording = journal.recording()
    last = {body.name: take_snapshot(body) for body in world.objects} if recording else {}
    observer = world.transactions.observer
    done, ended = 0, False
    while done < steps and not (transaction.interrupts.noted or world.exiting):
        chunk = min(_SAMPLE_STEPS - world.sim_step % _SAMPLE_STEPS, steps - done)
        if world.trajectories.active:
            world.trajectories.step(chunk, transaction)
        else:
            world.engine.step(chunk)
        _record_drags(world, transaction)
        for body in world.objects:
            if body.fixed:  # the solver moves chains of attached objects a little
                attachment.move_attached(body, transaction)
        update(world, sim_step=world.sim_step + chunk)
        done += chunk
        if world.sim_step % _SAMPLE_STEPS == 0:
            world.waits.sample()
        ended = until is not None and until()
        if ended or done == steps:  # the transaction's effect contains the last state
            break
        if observer is not None:
            observer.time_passed()
        if recording:
            sample = _sample(world, last)
            if sample.bodies:
                transaction.samples.append(sample)
    return done, ended


def _record_drags(world: BulletWorld, transaction: Transaction) -> None:
    """Record the objects that a user drags in the window, because no command moves them."""
    drags = transaction.command.drags
    bodies = {body.handle: body.name for body in world.objects}
    for handle, link in world.engine.dragged(bodies):
        if not any((drag.body, drag.link) == (bodies[handle], link) for drag in drags):
            drags.append(records.Drag(body=bodies[handle], link=link, sim_step=world.sim_step))


def _sample(world: BulletWorld, last: dict[str, Snapshot]) -> records.Sample:
    """Return a sample of the objects that moved visibly since the last sample, and put their states into ``last``."""
    sample = records.Sample(sim_step=world.sim_step)
    for body in world.objects:
        now = take_snapshot(body)
        delta = state_delta(body, now, last.get(body.name), _SAMPLE_TOLERANCE)
        if delta is not None:
            last[body.name] = now
            sample.bodies.append(delta)
    return sample


class Wait:
    """A wait for a predicate in a world's simulated time."""

    def __init__(self, predicate: Callable[[], bool]) -> None:
        self._predicate = predicate
        self.error: Exception | None = None  # an error of the predicate
        self.held = False  # whether the predicate was true in a sample or raised an error
        self.waiter: Waiter | None = None  # the waiting branch; None before it waits

    def sample(self) -> bool:
        """Call the predicate, and return whether the wait is over."""
        try:
            self.held = self.held or self._predicate()
        except Exception as error:  # noqa: BLE001  the error is raised in the waiting branch, not in the simulation
            self.held, self.error = True, error
        return self.held


class Waits(list[Wait]):
    """The waits of all threads in one world; the wait that began first is first."""

    def sample(self) -> None:
        """Call all predicates once, and wake the branches whose waits are over; the caller holds the world's lock."""
        for wait in list(self):
            if not wait.held and wait.sample() and wait.waiter is not None:
                wait.waiter.wake()

    @property
    def held(self) -> bool:
        """Return whether a wait is over."""
        return any(wait.held for wait in list(self))

    def wake(self) -> None:
        """Wake all waiting branches, because another thread or branch simulates from now on."""
        for wait in list(self):
            if wait.waiter is not None:
                wait.waiter.wake()


def wait(world: BulletWorld, predicate: Callable[[], bool]) -> None:
    """Wait until a predicate holds while simulated time passes. The wait is a checkpoint, also in uninterruptible code.

    Time passes only if no branch of the thread is ready. If all branches wait, the branch that has waited longest
    simulates in one transaction. The simulation ends when another branch is ready, a wait is over, a followed fluent
    changes or a time listener is registered. In real time, another thread simulates.

    Args:
        predicate: Called once before the wait, then each 1/30 s of simulated time under the world's lock. The predicate
            must neither change the world nor wait.

    Raises:
        Cancelled: The branch is cancelled, and the predicate doesn't hold.
        WorldClosed: The world ends during the wait.
        LockHeld: The caller holds a lock.
    """
    waiting = Wait(predicate)
    with world.lock:
        over = waiting.sample()
    if not over:
        scope = current_scope()
        sources = () if scope is None else scope.sources
        awaited = f"simulated time of {world.name}", "", ()
        with Waiter(sources, patience=lambda: not world.realtime, reason=lambda: awaited) as waiter:
            waiting.waiter = waiter
            world.waits.append(waiting)
            try:
                while not waiting.held:
                    raise_if_cancelled()
                    if world.closed:
                        raise WorldClosed(world.name, "wait in simulated time")
                    if waiter.sleep():
                        _simulate_until_needed(world, scope, lambda: bool(world.time_listeners))
            finally:
                world.waits.remove(waiting)
    if waiting.error is not None:
        raise waiting.error


class WorldClock:
    """The simulated time of a world as a clock of the scheduler, for waits that only passing time can end.

    With ``last``, the clock stands still while a wall-clock deadline or a worker can end a wait of the thread, and
    follows the wall clock while a thread or a signal handler of the plan can end a wait.
    """

    def __init__(self, world: BulletWorld, *, last: bool) -> None:
        self._world = world
        self._last = last
        self._began: tuple[float, int] | None = None  # wall-clock time in s, and step, at the clock's start
        self._end = math.inf  # the last step to which simulated time may pass now

    def may_pass(self) -> bool:
        """Return whether time may pass now; in real time, another thread simulates."""
        world, own = self._world, scheduler()
        if world.realtime or world.closed or (self._last and own.awaits_strike()):
            return False
        self._end = math.inf
        if self._last and own.can_be_woken():
            now = time.monotonic()
            self._began = self._began or (now, world.sim_step)
            self._end = self._began[1] + (now - self._began[0]) * records.STEPS_PER_SECOND
        return world.sim_step + _SAMPLE_STEPS <= self._end

    def let_pass(self) -> None:
        """Simulate until a branch or another thread is ready."""
        world = self._world

        def is_over() -> bool:
            now = world.sim_step
            return now >= self._end or any(due is None or due <= now for due in list(world.time_listeners.values()))

        _simulate_until_needed(world, current_scope(), is_over)


@uninterruptible()
def _simulate_until_needed(world: BulletWorld, scope: CancelScope | None, is_over: Callable[[], bool]) -> None:
    with world.transactions.begin(records.Mutation(simulate=records.Simulate(steps=_MAX_WAIT_STEPS))) as transaction:
        simulate(world, _MAX_WAIT_STEPS, transaction, lambda: is_over() or _is_needed(world, scope))


def _is_needed(world: BulletWorld, scope: CancelScope | None) -> bool:
    observer = world.transactions.observer
    return (
        world.waits.held
        or scheduler().is_awaited()
        or (scope is not None and scope.is_cancelled)
        or (observer is not None and observer.has_news())
        or bool(world.lock.contenders)
    )


class Restless(UserWarning):
    """Objects weren't at rest when :meth:`.BulletWorld.settle` ended; ``seconds`` is the duration of the simulation."""

    def __init__(self, seconds: float, speeds: Mapping[Object, Speed]) -> None:
        self.speeds = {body.name: speed for body, speed in sorted(speeds.items(), key=itemgetter(1), reverse=True)}
        listed = [f"{name} ({speed})" for name, speed in itertools.islice(self.speeds.items(), _MAX_LISTED)]
        more = f" and {len(speeds) - _MAX_LISTED} more" if len(speeds) > _MAX_LISTED else ""
        super().__init__(f"not at rest after {seconds:.3g} s of simulation: {', '.join(listed)}{more}")


def settle(world: BulletWorld, steps: int) -> tuple[dict[Object, Speed], bool]:
    """Simulate until all is at rest, in one transaction; return restless objects, and whether all steps were done."""
    command = records.Simulate(steps=steps, settled=False)
    with world.transactions.begin(records.Mutation(simulate=command)) as transaction:
        detector = RestDetector(world)
        completed = simulate(world, steps, transaction, detector.sample)
        transaction.command.simulate.settled = not detector.restless
    return detector.restless, completed


def separate(world: BulletWorld) -> None:
    """Lift free objects out of surfaces and free objects that they overlap; the engine would jam or throw them.

    Of two free objects, the object that was loaded later is lifted. Only pairs with overlapping boxes are checked.
    """
    for body, _, rise in sunk(world):
        x, y, z = body.get_position()
        body.set_position([x, y, z + rise])
    free = [body for body in world.objects if not body.fixed and not body.attachments]
    boxes = np.array([body.get_AABB() for body in free]).reshape(-1, 2, 3)
    possible = np.triu(_overlap(boxes[:, None], boxes), 1)  # pairs that may overlap; the first was loaded earlier
    lifts = 0
    while lifts < len(free) and possible.any():
        first, second = np.unravel_index(possible.argmax(), possible.shape)
        earlier, later = free[first], free[second]
        deepest = world.engine.deepest(earlier.handle, later.handle)
        if deepest is None or -deepest.distance <= DEEP:
            possible[first, second] = False
            continue
        x, y, z = later.get_position()
        later.set_position([x, y, z + earlier.get_AABB()[1][2] - later.get_AABB()[0][2]])
        lifts += 1
        boxes[second] = later.get_AABB()
        touched = _overlap(boxes, boxes[second])
        possible[:second, second], possible[second, second + 1 :] = touched[:second], touched[second + 1 :]


def _overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return an array: whether boxes (..., 2, 3) overlap."""
    return np.asarray(np.logical_and.reduce((a[..., 0, :] <= b[..., 1, :]) & (b[..., 0, :] <= a[..., 1, :]), axis=-1))


def at_rest(speeds: Sequence[float]) -> bool:
    """Return whether an object is at rest; speeds of successive intervals are multiples of the slow speed."""
    return speeds[-1] <= max(speeds[0] * _GAIN, _NOISE) and max(speeds) < 1.0


class Speed(NamedTuple):
    """The greatest speed of an object: of its base, of its rotation, or of a joint."""

    ratio: float  # the speed as a multiple of the slow speed
    joint: str = ""  # name of the joint; "" for the base
    unit: str = "m/s"  # m/s or rad/s

    def __str__(self) -> str:
        fast = f"{self.ratio * SLOW * 1e3:.2g} mm/s" if self.unit == "m/s" else f"{self.ratio * SLOW_TURN:.2g} rad/s"
        return f"{self.joint} {fast}".lstrip()


class RestDetector:
    """Detects when all objects of a world are at rest.

    An object is at rest if it was slower than 2 mm/s and 0.02 rad/s in each of the last four intervals of 1/30 s, and
    didn't gain speed. A tall object that starts to tip is slow at first. Solvers let some of many objects tremble at
    any moment. An object therefore stays at rest while it is that slow, and within 0.5 mm and 5 mrad of the pose at
    which it came to rest. Solvers let thin objects between other objects tremble forever. An object that moves to and
    fro for 3 s, within 2 mm and 0.02 rad, is therefore also at rest. Robots, and objects attached to robots or to a
    fixed base, are ignored; joints of furniture count, unless the furniture is in ``ignored``.
    """

    def __init__(self, world: BulletWorld, ignored: Collection[Object] = ()) -> None:
        self._world = world
        self._ignored = ignored
        self._last: tuple[int, Mapping[Object, Snapshot]] = self._snapshots()
        self._speeds: deque[Mapping[Object, Speed]] = deque(maxlen=INTERVALS)
        self._rested: dict[Object, Snapshot] = {}  # states in which objects came to rest
        # For objects that aren't at rest: a state; the step since which the object has been near this state; and the
        # length of the object's path since then, as seconds at the slow speed.
        self._near: dict[Object, tuple[Snapshot, int, float]] = {}
        #: The objects that weren't at rest in the last sample.
        self.restless: dict[Object, Speed] = dict.fromkeys(self._last[1], Speed(0.0))

    def ignore(self, bodies: Collection[Object], *, stopped: bool) -> None:
        """Ignore other bodies from now on; ``stopped``: bodies that are no longer ignored count as at rest."""
        step, last = self._last
        if stopped:
            rested = {body: take_snapshot(body) for body in self._ignored if body not in bodies}
            self._last = step, {**last, **rested}
            self._rested |= rested
        self._ignored = bodies

    def sample(self) -> bool:
        """Compare all poses after 1/30 s of simulation, and return whether all objects are at rest."""
        step, before = self._last
        self._last = now, after = self._snapshots()
        if now > step:
            seconds = (now - step) / records.STEPS_PER_SECOND
            known = [body for body in after if body in before]  # other branches may attach and load objects
            self._speeds.append({body: _speed(body, before[body], after[body], seconds) for body in known})
        self._rested = {
            body: rested
            for body, state in after.items()
            if (rested := (state is before.get(body) and self._rested.get(body)) or self._rest(body, state))
        }
        last = self._speeds[-1] if self._speeds else {}
        self.restless = {body: last.get(body, Speed(0.0)) for body in after if body not in self._rested}
        return len(self._speeds) == INTERVALS and not self.restless

    def _rest(self, body: Object, state: Snapshot) -> Snapshot | None:
        """Return the state in which an object came to rest; None if it isn't at rest."""
        speeds = [known[body].ratio for known in self._speeds if body in known]
        if len(speeds) == INTERVALS and at_rest(speeds):
            return state
        rested = self._rested.get(body)
        if rested is not None and speeds and speeds[-1] < 1.0 and _speed(body, rested, state, 1.0).ratio <= _STRAY:
            return rested
        return state if speeds and self._trembles(body, state, speeds[-1]) else None

    def _trembles(self, body: Object, state: Snapshot, speed: float) -> bool:
        """Return whether an object has moved to and fro long enough; ``speed`` is a multiple of the slow speed."""
        now = self._world.sim_step
        start, since, way = self._near.get(body, (state, now, 0.0))
        way += speed * _SAMPLE_STEPS / records.STEPS_PER_SECOND
        distance = _speed(body, start, state, 1.0).ratio
        if distance > 1.0:
            start, since, way = state, now, 0.0
        self._near[body] = start, since, way
        return now - since >= _TREMBLES and way > _TO_AND_FRO * distance

    def _snapshots(self) -> tuple[int, Mapping[Object, Snapshot]]:
        roots = [(body, attachment.root_of(body)) for body in self._world.objects]
        moving = [
            body
            for body, root in roots
            if body not in self._ignored
            and not root.is_robot
            and (not root.fixed or (root is body and bool(body.joints)))
        ]
        return self._world.sim_step, {body: take_snapshot(body) for body in moving}


def _speed(body: Object, before: Snapshot, after: Snapshot, seconds: float) -> Speed:
    """Return the greatest speed of an object or its joints between two states."""
    if before is after:
        return Speed(0.0)
    moved = Speed(math.dist(before.pose[0], after.pose[0]) / SLOW / seconds)
    turned = Speed(geometry.angle(before.pose[1], after.pose[1]) / SLOW_TURN / seconds, "", "rad/s")
    fastest = max(moved, turned)
    for joint, a, b in zip(body.handle.joints.values(), before.positions, after.positions, strict=True):
        slow, unit = (SLOW, "m/s") if joint.kind == "prismatic" else (SLOW_TURN, "rad/s")
        fastest = max(fastest, Speed(abs(b - a) / slow / seconds, joint.name, unit))
    return fastest


class RealtimeClock:
    """A thread that simulates a world at the pace of the wall clock."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._over = False
        self._ended = Condition()
        # The world's exit() stops the thread. The thread is a daemon, because plans may omit exit().
        self._thread = threading.Thread(target=self._run, name=f"{world.name} realtime", daemon=True)

    def start(self) -> None:
        """Start simulating."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, and raise its first error of an event handler. The caller must not hold the world's lock."""
        self._stop.set()
        if self._thread is not threading.current_thread():
            join(self._ended, lambda: self._over)  # a handler of the last simulation may still wait for another branch
            self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        due = time.monotonic()
        try:
            while not self._stop.wait(max(0.0, due - time.monotonic())):
                due = max(due + _PERIOD, time.monotonic() - _MAX_LAG)
                try:
                    self._world.simulate(_PERIOD)
                except WorldClosed:
                    return
                except ChangeRefused:  # a query runs in this world now
                    continue
                except Exception as error:  # noqa: BLE001  stop() raises a handler's error; the simulation continues
                    if self._error is None:
                        self._error = error
                        arguments = (type(error), error, error.__traceback__, self._thread)
                        threading.excepthook(threading.ExceptHookArgs(arguments))
        finally:
            self._over = True
            self._ended.notify_all()
