"""Whether an object stays where it is when time runs (thesis 4.4.1).

The thesis simulates 2 s and compares positions to the millimetre. Solvers let things that lie still creep by that much,
so that its own demo failed. Here an object is unstable if within 2 s it would move more than 1 cm or turn more than 5
degrees: creep stays an order of magnitude below, a fall goes far beyond. The answer is certain earlier when the limit
is passed, or when all that could matter has come to rest: slower than 2 mm/s and 0.02 rad/s, which could not add up to
the limit in the time left, and not gaining speed, as something that begins to tip does.

What is simulated is a twin, never the world: PyBullet's saved states, even if restored at once, change the last bits of
what contacts do next. Robots, which cost most of a step, are in it only if one touches or carries the object or
something that it rests with.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.engine import STEPS_PER_SECOND
from pycram.reasoning.twin import twin
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.body import Body
    from pycram.engine import Engine
    from pycram.objects import Object
    from recorder.geometry import Pose

HORIZON: Final = 2 * STEPS_PER_SECOND  # steps
MOVED: Final = 0.01  # m
TURNED: Final = math.radians(5)
_SLOW: Final = 2e-3  # m/s
_SLOW_TURN: Final = 2e-2  # rad/s
_CHECK: Final = 6  # steps between looks
_QUIET_LOOKS: Final = 3  # at rest for so many looks in a row
_NEAR: Final = 0.05  # m; what is nearer may come to touch while things settle


def simulate(body: Object) -> tuple[bool, Mapping[str, object]]:
    """Finds out whether an object stays.

    Args:
        body: the object.

    Returns:
        The answer; how far (m) and by how much (rad) it moved, after how many steps, in how many that were simulated.
    """
    group = _group(body)
    robots = any(other.is_robot for other in group)
    copy = twin(body.world, "physics with robots" if robots else "physics")
    bodies = copy.sync((other for other in body.world.objects if robots or not other.is_robot), holding=True)
    movable = [bodies[other.name] for other in group if not other.fixed]
    try:
        return _watch(copy.engine, bodies[body.name], movable)
    finally:
        copy.disturbed(*bodies)


def _group(body: Object) -> list[Object]:
    """The object and what could make it move: what is near, and what is near to that, but not beyond what is fixed."""
    world = body.world
    engine = world.engine
    group, queue = [body], [body]
    while queue:
        current = queue.pop()
        if current.fixed:
            continue
        for other in world.objects:
            if other in group:
                continue
            if other in current.attachments or engine.touches(current.handle, other.handle, _NEAR):
                group.append(other)
                queue.append(other)
    return group


def _watch(engine: Engine, body: Body, movable: list[Body]) -> tuple[bool, Mapping[str, object]]:
    start = engine.pose(body)
    speed_before = math.inf
    quiet = 0
    steps = 0
    moved = turned = 0.0
    while steps < HORIZON:
        engine.step(_CHECK)
        steps += _CHECK
        moved, turned = _change(start, engine.pose(body))
        if moved > MOVED or turned > TURNED:
            return False, {"moved": moved, "turned": turned, "moved_after_steps": steps, "simulated_steps": steps}
        speeds = [_speeds(engine, other) for other in movable]
        linear = max((speed for speed, _ in speeds), default=0.0)
        angular = max((turn for _, turn in speeds), default=0.0)
        speed = linear + angular
        # speeds of solvers' noise go up and down: below a tenth of the limit they are no gain
        gaining = speed > speed_before and speed > 0.1 * (_SLOW + _SLOW_TURN)
        quiet = quiet + 1 if linear < _SLOW and angular < _SLOW_TURN and not gaining else 0
        speed_before = speed
        if quiet >= _QUIET_LOOKS:
            break
    return True, {"moved": moved, "turned": turned, "simulated_steps": steps}


def _change(before: Pose, after: Pose) -> tuple[float, float]:
    return math.dist(before[0], after[0]), geometry.angle(before[1], after[1])


def _speeds(engine: Engine, body: Body) -> tuple[float, float]:
    velocity = engine.velocity(body)
    return math.hypot(*velocity[:3]), math.hypot(*velocity[3:])
