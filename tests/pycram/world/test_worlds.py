"""Several worlds at once: which is current, for whom, how they are named and what they leave behind."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, WorldClosed
from pycram.language import par
from pycram.process_module import ProcessModule
from pycram.scheduling.cancellation import checkpoint
from recorder.records import Task
from recorder.tracing.span import span

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink


def test_worlds_are_isolated_from_each_other() -> None:
    with BulletWorld() as first, BulletWorld() as second:
        first.set_gravity([0, 0, -9.8])
        here = Object("cup", "cup", "cup.stl", [0, 0, 1], world=first)
        there = Object("cup", "cup", "cup.stl", [5, 0, 1], world=second)
        robot = Object("pr2", "robot", "pr2.urdf", world=second)
        second.robot = robot
        robot.attach(there, "r_gripper_tool_frame")
        first.simulate(0.5)
        assert there.get_position() == pytest.approx([5, 0, 1])
        assert here.get_position()[2] < 0
        here.set_position([0, 0, 3])
        robot.set_position([1, 0, 0])
        assert here.get_position() == pytest.approx([0, 0, 3])
        assert there.get_position() == pytest.approx([6, 0, 1])
        assert first.robot is None


def test_the_current_world_is_always_an_open_one() -> None:
    first, second, third = BulletWorld(), BulletWorld(), BulletWorld()
    assert BulletWorld.current_bullet_world is third
    second.exit()
    third.exit()
    third.exit()
    assert BulletWorld.current_bullet_world is first
    with pytest.raises(ZeroDivisionError), BulletWorld():
        _ = 1 / 0
    assert BulletWorld.current_bullet_world is first
    first.exit()
    assert BulletWorld.current_bullet_world is None
    with pytest.raises(WorldClosed, match="simulate"):
        first.simulate(1)


def test_names_of_open_worlds_are_unique_across_threads() -> None:
    with BulletWorld() as first:
        number = int(first.name.removeprefix("world_"))
    with BulletWorld(name=f"world_{number + 1}"), BulletWorld() as second:
        assert second.name == f"world_{number + 2}"
    start = threading.Barrier(8)
    opened: list[BulletWorld] = []
    refused: list[BadArgument] = []

    def open_one() -> None:
        start.wait()
        try:
            opened.append(BulletWorld(name="the only one"))
        except BadArgument as error:
            refused.append(error)

    threads = [threading.Thread(target=open_one) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(opened) == 1
    assert len(refused) == 7
    opened[0].exit()
    BulletWorld(name="the only one").exit()


def test_a_world_ends_even_if_its_exit_functions_fail() -> None:
    ended: list[str] = []

    def fail() -> None:
        raise ZeroDivisionError

    world = BulletWorld()
    world.at_exit(lambda: ended.append("first"))
    world.at_exit(fail)
    world.at_exit(lambda: ended.append("last"))
    with pytest.raises(ZeroDivisionError):
        world.exit()
    assert sorted(ended) == ["first", "last"]
    assert world.closed
    assert BulletWorld.current_bullet_world is not world
    world.exit()


@pytest.mark.costly
def test_60_worlds_leak_nothing(tmp_path: Path) -> None:
    program = """
import gc, threading
import psutil
from pycram.bullet_world import BulletWorld, Object
process = psutil.Process()

def use():
    with BulletWorld() as world:
        Object("milk", "milk", "milk.stl", [0, 0, 1])
        Object("bowl", "bowl", "bowl.stl", [0.3, 0, 1])
        world.simulate(0.05)

def memory():  # its own, also what is swapped out; not libraries, whose pages the system drops and reads again
    lines = dict(line.split(":") for line in open("/proc/self/status"))
    return sum(int(lines[name].split()[0]) * 1024 for name in ("RssAnon", "VmSwap"))

def measure():
    gc.collect()
    return threading.active_count(), process.num_threads(), process.num_fds(), memory(), len(gc.get_objects())

for _ in range(20):
    use()
before = measure()
for _ in range(60):
    use()
print(*[after - then for then, after in zip(before, measure())])
"""
    environment = os.environ | {"PYCRAM_CACHE": str(tmp_path)}  # no other process takes entries away
    ended = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True, timeout=600
    )
    python_threads, threads, files, memory, objects = map(int, ended.stdout.split())
    assert (python_threads, threads, files) == (0, 0, 0)
    assert memory < 3e6
    assert objects < 60, "not one a world"


def furnished(name: str) -> BulletWorld:
    made = BulletWorld(name=name)
    made.robot = Object("pr2", "robot", "pr2.urdf")
    return made


def move(x: float, y: float) -> None:
    ProcessModule.perform(MotionDesignator([("type", "moving"), ("target", [x, y, 0])]))


def test_each_thread_has_its_own_current_world() -> None:
    worlds = [furnished("east"), furnished("west")]
    goals = {"east": 5.0, "west": -5.0}
    together = threading.Barrier(2)

    def plan(mine: BulletWorld) -> None:
        BulletWorld.current_bullet_world = mine
        for step in range(10):
            together.wait(20)
            move(goals[mine.name], step * 0.1)

    threads = [threading.Thread(target=plan, args=(mine,)) for mine in worlds]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for mine in worlds:
        assert mine.robot is not None
        assert mine.robot.get_position() == [goals[mine.name], 0.9, 0.0]
        mine.exit()


def test_branches_inherit_the_current_world(sink: MemorySink) -> None:
    here, there = furnished("here"), furnished("there")
    BulletWorld.current_bullet_world = here
    with par:
        ProcessModule.perform(MotionDesignator({"type": "move-arm-joints", "left-arm": "park", "right-arm": "park"}))
        move(3, 3)
        BulletWorld.current_bullet_world = there
    assert here.robot is not None
    assert there.robot is not None
    assert here.robot.get_position() == [3, 3, 0]
    assert there.robot.get_position() == [0, 0, 0]
    motions = [task for task in sink.of(Task) if task.kind == "motion"]
    assert {task.world for task in motions} == {"here"}
    here.exit()
    there.exit()


def test_a_world_that_a_branch_opens_is_current_in_that_branch_only(sink: MemorySink) -> None:
    def names() -> tuple[str, ...]:
        with span("motion", "look"):
            world = BulletWorld.current_bullet_world
        return "" if world is None else world.name, sink.of(Task)[-1].world

    def opens() -> list[tuple[str, ...]]:
        opened.append(BulletWorld(name="opened in a branch"))
        checkpoint()
        return [names(), *par(names)]

    opened: list[BulletWorld] = []
    with BulletWorld(name="around"):
        BulletWorld(name="chosen, and ended").exit()
        with par as s:
            inside = s(opens)
            beside = s(names)
        assert inside.result() == [("opened in a branch",) * 2] * 2
        assert beside.result() == names() == ("around", "around")
        opened.pop().exit()
    with par as s:  # all that were chosen here have ended
        s(opens)
        beside = s(names)
    assert beside.result() == names() == ("", "")
    thread = threading.Thread(target=lambda: opened.append(BulletWorld.current_bullet_world))
    thread.start()  # which has chosen none
    thread.join()
    assert opened[1] is opened[0]
    BulletWorld.current_bullet_world = opened[0]
    assert names() == ("opened in a branch",) * 2
    opened[0].exit()
