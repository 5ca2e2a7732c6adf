"""A plan that is copied as the debugger does it: each copy waits, and its child goes on. Prints what they cost, as JSON.

``python -m tests.benchmarks.waiting_copies 20``: a process of its own, as a plan is, with nothing of the tests in it.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "demos"))

import set_the_table

from pycram.bullet_world import BulletWorld
from pycram.projection.child import die_with
from recorder.tracing import forking, journal

_UNDER_WAY = 3  # copies that aren't counted: what is done for the first time takes more


def megabytes(process: int) -> float:
    """Memory of a process; of what it shares with others its part."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1024 / 1e6


def go_on(count: int, answer: int) -> None:
    """Do a bit of physics between copies; write what they cost to a pipe.

    Args:
        count: of copies.
        answer: the pipe's descriptor.
    """
    world = BulletWorld.current_bullet_world
    milk = world.get_object("milk")
    processes, costs, before = [os.getppid(), os.getpid()], [], 0.0
    for number in range(-_UNDER_WAY, count):
        if not number:
            costs.clear()
            before = sum(map(megabytes, processes))
        parent, start = os.getpid(), time.process_time()
        reading, writing = os.pipe()
        child = forking.fork_continuation()
        if child:
            os.write(writing, str(time.process_time() - start).encode())
            os.close(writing)
            os.waitpid(child, 0)
            os._exit(0)
        die_with(parent)
        os.close(writing)
        costs.append(float(os.read(reading, 100)))
        os.close(reading)
        processes.append(os.getpid())
        milk.set_position([1.45, 1, 1 + number / 100])
        world.simulate(0.1)
    each = (sum(map(megabytes, processes)) - before) / count
    os.write(answer, json.dumps({"ms": statistics.median(costs) * 1e3, "MB": each}).encode())


def main() -> None:
    set_the_table.build_scene()
    journal.open_journal(journal.Journal([journal.NullSink()]))  # the debugger keeps no records either
    reading, writing = os.pipe()
    first = os.fork()
    if not first:
        go_on(int(sys.argv[1]), writing)
        os._exit(0)
    os.close(writing)
    os.waitpid(first, 0)
    print(os.read(reading, 1000).decode())
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
