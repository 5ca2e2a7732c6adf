"""A small plan that imagines, goes back, and waits for the clock, and that is forked: what plans do with their own time.

``pycram run tests/replay/golden/forks/plan.py --seed 7 --log run.mcap``, then ``pycram-replay fork run.mcap --at
task:waiting@end -o tests/replay/golden/forks/VERSION.mcap``; of the fork's projections the first is kept, too.
"""

from __future__ import annotations

from pathlib import Path

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import in_thread, par, timeout
from pycram.projection import project, project_all
from recorder.tracing.span import span

CARTON = str(Path(__file__).parent.parent / "carton.stl")


def put(body: Object, x: float) -> list[float]:
    body.set_position([x, 0, 0.15])
    body.world.simulate(0.05)
    if x < 0:
        raise PlanFailure(f"{body.name} isn't to stand at {x}")
    return body.get_position()


def main() -> None:
    world = BulletWorld(name="table")
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", CARTON, [0, 0, 0.1])
    cereal = Object("cereal", "cereal", CARTON, [1, 0, 0.13])
    milk.attach(cereal)
    saved = world.save()
    with span("motion", "waiting"):
        Fluent(None, "never").wait_for(timeout=0.01)
        in_thread(len, "abc")
        try:
            with timeout(0):
                put(milk, 0.1)
        except PlanFailure as failure:
            print(failure)
    imagined = project(put, milk, 0.2)
    world.restore(imagined.state)
    project_all([(put, milk, -1), (put, milk, 0.3), (put, milk, 0.4)])
    with par as block:
        block(put, milk, 0.5)
        block(cereal.set_color, [1, 0, 0, 1])
    world.restore(saved)


if __name__ == "__main__":
    main()
