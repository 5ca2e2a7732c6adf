"""Coming to rest: when nothing that is free in a world moves any more.

At rest is what was slower than 2 mm/s and 0.02 rad/s, at four samples 1/30 s apart, and didn't gain speed meanwhile: a
tall thing that begins to tip is slow at first. Robots and what they hold don't count, nor does anything attached to a
thing with a fixed base; joints of furniture do.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

SLOW: Final = 2e-3  # m/s
SLOW_TURN: Final = 2e-2  # rad/s
_SAMPLES: Final = 4  # in a row
_GAIN: Final = 1.15  # from the first to the last of them
_NOISE: Final = 0.1  # of what is slow: speeds of solvers' noise go up and down


class RestDetector:
    """Tells when everything in a world has come to rest.

    Attributes:
        at_rest: whether it has, at the last sample.
    """

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._samples: deque[Mapping[Object, float]] = deque(maxlen=_SAMPLES)
        self.at_rest = False

    def sample(self) -> bool:
        """Look at all speeds, after each 1/30 s of simulation, and return whether everything is at rest."""
        self._samples.append({body: speed(body) for body in self._world.objects if counts(body)})
        first, last = self._samples[0], self._samples[-1]
        self.at_rest = (
            len(self._samples) == _SAMPLES
            and all(value < 1.0 for speeds in self._samples for value in speeds.values())
            and all(now <= max(first[body] * _GAIN, _NOISE) for body, now in last.items())
        )
        return self.at_rest


def counts(body: Object) -> bool:
    """Return whether an object has to come to rest by itself."""
    root = body
    while root.carrier is not None:
        root = root.carrier
    return not root.is_robot and (not root.fixed or (root is body and bool(body.joints)))


def speed(body: Object) -> float:
    """Return how fast an object, or the fastest of its joints, moves: 1 is the limit of what counts as slow."""
    engine = body.world.engine
    velocity = engine.velocity(body.handle)
    fastest = max(math.hypot(*velocity[:3]) / SLOW, math.hypot(*velocity[3:]) / SLOW_TURN)
    for joint, value in zip(body.handle.joints.values(), engine.joints(body.handle)[1], strict=True):
        fastest = max(fastest, abs(value) / (SLOW if joint.kind == "prismatic" else SLOW_TURN))
    return fastest


def moving(world: BulletWorld) -> list[Object]:
    """Return what has to come to rest by itself and isn't slow now."""
    return [body for body in world.objects if counts(body) and speed(body) >= 1.0]
