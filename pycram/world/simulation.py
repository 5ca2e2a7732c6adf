"""Simulation of a world: steps of 1/240 s, with samples for the recording 30 times a simulated second."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import ChangeRefused, WorldClosed
from pycram.scheduling.cancellation import current_scope, join, raise_if_cancelled, uninterruptible
from pycram.scheduling.schedule import Condition, Waiter, scheduler
from pycram.world import attachment
from pycram.world.overlaps import DEEP, depth
from pycram.world.transaction import state_delta, take_snapshot, update
from recorder import geometry, records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pycram.physics.body import Snapshot
    from pycram.scheduling.cancellation import CancelScope
    from pycram.world.object import Object
    from pycram.world.transaction import Transaction
    from pycram.world.world import BulletWorld


_SAMPLE_STEPS: Final = records.STEPS_PER_SECOND // 30
_SAMPLE_TOLERANCE: Final = 1e-5  # m, rad: smaller movements between two samples aren't visible
_MANIPULATION_TOLERANCE: Final = 1e-4  # rad or m by which a joint of the environment has to move to fire the event


def simulate(world: BulletWorld, steps: int, transaction: Transaction, until: Callable[[], bool] | None = None) -> bool:
    """Step a world's engine as part of a transaction.

    Ctrl-C or the world's exit end it early, between two samples; the record then has the steps that were done.

    Args:
        world: The world.
        steps: How many.
        transaction: The transaction.
        until: Called after each 1/30 s of simulated time, and at the end; ends it when true.

    Returns:
        Whether all steps were done, or those that were needed.
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
    """Return how many steps were done, and whether no more were needed."""
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
        _note_drags(world, transaction)
        for body in world.objects:
            if body.fixed:  # solvers let what is attached to it in chains give way a little
                attachment.move_attached(body, transaction)
        update(world, sim_step=world.sim_step + chunk)
        done += chunk
        if world.sim_step % _SAMPLE_STEPS == 0:
            world.waits.sample()
        ended = until is not None and until()
        if ended or done == steps:  # the effect itself has the last state
            break
        if observer is not None:
            observer.time_passed()
        if recording:
            sample = _sample(world, last)
            if sample.bodies:
                transaction.samples.append(sample)
    return done, ended


def _note_drags(world: BulletWorld, transaction: Transaction) -> None:
    """Record what somebody drags in the window meanwhile: no command did it."""
    drags = transaction.command.drags
    bodies = {body.handle: body.name for body in world.objects}
    for handle, link in world.engine.dragged(bodies):
        if not any((drag.body, drag.link) == (bodies[handle], link) for drag in drags):
            drags.append(records.Drag(body=bodies[handle], link=link, sim_step=world.sim_step))


def _sample(world: BulletWorld, last: dict[str, Snapshot]) -> records.Sample:
    """Record the objects that moved visibly since the last sample, and update their last snapshots."""
    sample = records.Sample(sim_step=world.sim_step)
    for body in world.objects:
        now = take_snapshot(body)
        delta = state_delta(body, now, last.get(body.name), _SAMPLE_TOLERANCE)
        if delta is not None:
            last[body.name] = now
            sample.bodies.append(delta)
    return sample


SLOW: Final = 2e-3
"""m/s below which something may be at rest."""
SLOW_TURN: Final = 2e-2
"""rad/s of the same."""
INTERVALS: Final = 4
"""In a row, in which it has to be slow."""
_GAIN: Final = 1.15  # from the first to the last of them: a 2 m high shelf that begins to tip gains more, creep less
_NOISE: Final = 0.1  # of what is slow: speeds of solvers' noise go up and down


def at_rest(speeds: Sequence[float]) -> bool:
    """Return whether something is at rest that was so fast, as shares of what is slow, in consecutive intervals."""
    return speeds[-1] <= max(speeds[0] * _GAIN, _NOISE) and max(speeds) < 1.0


def settle(world: BulletWorld, steps: int) -> tuple[list[Object], bool]:
    """Simulate until everything is at rest, as one transaction.

    Args:
        world: The world.
        steps: After how many it gives up.

    Returns:
        What isn't at rest, and whether the simulation was carried out: another thread may end the world meanwhile.
    """
    command = records.Simulate(steps=steps, settled=False)
    with world.transactions.begin(records.Mutation(simulate=command)) as transaction:
        detector = RestDetector(world)
        completed = simulate(world, steps, transaction, detector.sample)
        transaction.command.simulate.settled = not detector.restless
    return detector.restless, completed


def separate(world: BulletWorld) -> None:
    """Lift free objects out of each other, what was loaded later up: engines jam or throw them."""
    free = [body for body in world.objects if not body.fixed and not body.attachments]
    for _ in free:
        pair = next((pair for pair in itertools.combinations(free, 2) if depth(*pair) > DEEP), None)
        if pair is None:
            return
        earlier, later = pair
        x, y, z = later.get_position()
        later.set_position([x, y, z + earlier.get_AABB()[1][2] - later.get_AABB()[0][2]])


class RestDetector:
    """Tells when everything in a world has come to rest.

    Attributes:
        restless: what hasn't, at the last sample.
    """

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._last: tuple[int, Mapping[Object, Snapshot]] = self._look()
        self._speeds: deque[Mapping[Object, float]] = deque(maxlen=INTERVALS)
        self.restless = list(self._last[1])

    def sample(self) -> bool:
        """Look where everything is, after each 1/30 s of simulation, and return whether all is at rest."""
        step, before = self._last
        self._last = now, after = self._look()
        if now > step:
            seconds = (now - step) / records.STEPS_PER_SECOND
            known = [body for body in after if body in before]  # others take and load things while somebody waits
            self._speeds.append({body: _moved(body, before[body], after[body]) / seconds for body in known})
        self.restless = [body for body in after if not self._rests(body)]
        return len(self._speeds) == INTERVALS and not self.restless

    def _rests(self, body: Object) -> bool:
        speeds = [known[body] for known in self._speeds if body in known]
        return len(speeds) == INTERVALS and at_rest(speeds)

    def _look(self) -> tuple[int, Mapping[Object, Snapshot]]:
        return self._world.sim_step, {body: take_snapshot(body) for body in self._world.objects if _counts(body)}


def _counts(body: Object) -> bool:
    """Return whether an object has to come to rest by itself."""
    root = attachment.root_of(body)
    return not root.is_robot and (not root.fixed or (root is body and bool(body.joints)))


def _moved(body: Object, before: Snapshot, after: Snapshot) -> float:
    """Return how far an object, or the fastest of its joints, has moved: 1 is what is slow in a second."""
    moved = math.dist(before.pose[0], after.pose[0]) / SLOW
    turned = geometry.angle(before.pose[1], after.pose[1]) / SLOW_TURN
    joints = zip(body.handle.joints.values(), before.positions, after.positions, strict=True)
    slid = (abs(b - a) / (SLOW if joint.kind == "prismatic" else SLOW_TURN) for joint, a, b in joints)
    return max(moved, turned, *slid)


class Wait:
    """One wait.

    Args:
        predicate: What is waited for.

    Attributes:
        held: Whether it held at one of the moments at which it was called, or raised an error.
        waiter: The branch that waits; None before it does.
    """

    def __init__(self, predicate: Callable[[], bool]) -> None:
        self._predicate = predicate
        self._error: Exception | None = None
        self.held = False
        self.waiter: Waiter | None = None

    def sample(self) -> bool:
        """Call the predicate, and return whether the wait is over."""
        try:
            self.held = self.held or self._predicate()
        except Exception as error:  # noqa: BLE001  it is raised where somebody waits, not in the simulation
            self.held, self._error = True, error
        return self.held

    def raise_error(self) -> None:
        """Raise what the predicate has raised, if it has."""
        if self._error is not None:
            raise self._error


class Waits:
    """Those in one world, of all threads, in order of arrival."""

    def __init__(self) -> None:
        self._waits: dict[Wait, None] = {}

    def add(self, wait: Wait) -> None:
        """Sample it from now on."""
        self._waits[wait] = None

    def remove(self, wait: Wait) -> None:
        """Sample it no more."""
        self._waits.pop(wait, None)

    def sample(self) -> None:
        """Call all predicates once, and wake the branches whose waits are over; the world's lock is held."""
        for wait in list(self._waits):
            if not wait.held and wait.sample() and wait.waiter is not None:
                wait.waiter.wake()

    @property
    def held(self) -> bool:
        """Whether one of them is over."""
        return any(wait.held for wait in list(self._waits))

    def wake(self) -> None:
        """Have all look who simulates."""
        for wait in list(self._waits):
            if wait.waiter is not None:
                wait.waiter.wake()

    def forget(self) -> None:
        """Forget all, in a forked child that goes on without those branches."""
        self._waits.clear()


_MAX_STEPS: Final = 10 * records.STEPS_PER_SECOND  # of one record


def wait(world: BulletWorld, predicate: Callable[[], bool]) -> None:
    """Wait until a predicate holds, while simulated time passes; a checkpoint, also in uninterruptible code.

    Args:
        world: The world whose time passes.
        predicate: Called once now, and then once each 1/30 s of simulated time with the world's lock held: it reads
            the world, and neither changes it nor waits.

    Raises:
        Cancelled: The branch is cancelled, and the predicate doesn't hold.
        WorldClosed: The world ends meanwhile.
        LockHeld: The caller holds a lock.
    """
    waiting = Wait(predicate)
    with world.lock:
        over = waiting.sample()
    if not over:
        _pass(world, waiting)
    waiting.raise_error()


def _pass(world: BulletWorld, waiting: Wait) -> None:
    scope = current_scope()
    sources = () if scope is None else scope.sources
    with Waiter(sources, patience=lambda: not world.realtime) as waiter:
        waiting.waiter = waiter
        world.waits.add(waiting)
        try:
            while not waiting.held:
                raise_if_cancelled()
                if world.closed:
                    raise WorldClosed(world.name, "wait in its time")
                if waiter.sleep():
                    _simulate(world, scope)
        finally:
            world.waits.remove(waiting)


@uninterruptible()
def _simulate(world: BulletWorld, scope: CancelScope | None) -> None:
    """Simulate until somebody has something to do."""
    command = records.Simulate(steps=_MAX_STEPS)
    with world.transactions.begin(records.Mutation(simulate=command)) as transaction:
        simulate(world, _MAX_STEPS, transaction, partial(_is_enough, world, scope))


def _is_enough(world: BulletWorld, scope: CancelScope | None) -> bool:
    """Whether somebody has something to do now, or may have."""
    observer = world.transactions.observer
    return (
        world.waits.held
        or scheduler().is_awaited()
        or (scope is not None and scope.is_cancelled)
        or bool(world.time_listeners)
        or (observer is not None and observer.has_news())
        or world.lock.is_contended
    )


_PERIOD: Final = 1 / 30  # s; each period's simulation is one record
_MAX_LAG: Final = 0.1  # s that are caught up; more is dropped, as a slow machine can never catch up


class RealtimeClock:
    """A thread that simulates one world."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._over = False
        self._ended = Condition()
        # the world's exit() ends it; it is a daemon for plans that don't call exit()
        self._thread = threading.Thread(target=self._run, name=f"{world.name} realtime", daemon=True)

    def start(self) -> None:
        """Start simulating."""
        self._thread.start()

    def stop(self) -> None:
        """Stop and wait for the present simulation to end; never call it with the world's lock held.

        Raises:
            Exception: The first error that a handler of an event raised in the clock's thread.
        """
        self._stop.set()
        if self._thread is not threading.current_thread():
            join(self._ended, lambda: self._over)  # a handler of its last stretch may wait for another branch
            self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            self._simulate()
        finally:
            self._over = True
            self._ended.notify_all()

    def _simulate(self) -> None:
        due = time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due = max(due + _PERIOD, time.monotonic() - _MAX_LAG)
            try:
                self._world.simulate(_PERIOD)
            except WorldClosed:
                return
            except ChangeRefused:  # a query runs at the moment
                continue
            except Exception as error:  # noqa: BLE001  of a handler: time goes on
                self._keep(error)

    def _keep(self, error: Exception) -> None:
        """Report the first error at once, and keep it for the caller of :meth:`stop`."""
        if self._error is None:
            self._error = error
            threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, self._thread)))
