"""Coming to rest: when nothing that is free in a world moves any more.

At rest is what moved by less than 2 mm/s and 0.02 rad/s in each of the last four thirtieths of a second, and didn't
gain speed meanwhile: a tall thing that begins to tip is slow at first. Poses are compared, not velocities: solvers let
some things tremble to and fro that stay where they are. Robots and what they hold don't count, nor does anything
attached to a thing with a fixed base; joints of furniture do.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import TYPE_CHECKING, Final

from pycram.world import carried, simulation
from pycram.world.overlaps import DEEP, depth
from pycram.world.snapshot import take_snapshot
from recorder import geometry, records

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.physics.body import Snapshot
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

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
        completed = simulation.simulate(world, steps, transaction, detector.sample)
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
    root = carried.root_of(body)
    return not root.is_robot and (not root.fixed or (root is body and bool(body.joints)))


def _moved(body: Object, before: Snapshot, after: Snapshot) -> float:
    """Return how far an object, or the fastest of its joints, has moved: 1 is what is slow in a second."""
    moved = math.dist(before.pose[0], after.pose[0]) / SLOW
    turned = geometry.angle(before.pose[1], after.pose[1]) / SLOW_TURN
    joints = zip(body.handle.joints.values(), before.positions, after.positions, strict=True)
    slid = (abs(b - a) / (SLOW if joint.kind == "prismatic" else SLOW_TURN) for joint, a, b in joints)
    return max(moved, turned, *slid)
