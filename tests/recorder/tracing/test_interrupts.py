"""Ctrl-C at any moment, and forks: the log stays complete, and matches the world."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder.records import Event
from recorder.tracing import journal
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable

REPO = Path(__file__).parents[3]
INTERRUPTS = 40

PLAN = """
import itertools, json, sys
import recorder
from pycram.bullet_world import BulletWorld, Object

def report():
    state = {body.name: body.get_position_and_orientation() for body in world.objects}
    held = cup in box.attachments
    reported = {"length": recording.length, "sim_step": world.sim_step, "bodies": state, "held": held}
    print(json.dumps(reported), flush=True)

with recorder.record(sys.argv[1]) as recording, BulletWorld() as world:
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    box, cup = Object("box", "box", "breakfast_cereal.stl", [0, 0, 1]), Object("cup", "cup", "cup.stl", [0.5, 0, 1])
    for _ in range(int(sys.argv[2])):
        try:
            print("ready", flush=True)
            if cup in box.attachments:
                box.detach(cup)
            for count in itertools.count():
                box.set_position([count % 7, 0, 1])
                box.attach(cup)
                world.simulate(0.05)
                box.detach(cup)
                cup.set_position([0.5, count % 5, 1])
        except KeyboardInterrupt:
            report()
"""


@pytest.mark.slow
def test_interrupts_never_part_the_world_from_its_log(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    (tmp_path / "plan.py").write_text(PLAN)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "plan.py"), str(file), str(INTERRUPTS)],
        env={**os.environ, "PYTHONPATH": str(REPO)},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        chance = random.Random(1)
        reported = []
        for _ in range(INTERRUPTS):
            assert process.stdout.readline() == "ready\n"
            sum(range(chance.randrange(400_000)))  # some time, so that it hits anywhere
            process.send_signal(signal.SIGINT)
            reported.append(json.loads(process.stdout.readline()))
        assert process.wait(60) == 0
    with replay.open(file) as log:
        assert log.complete
        assert [record.seq for record in log] == list(range(len(log)))
        for live in reported:
            world = log.state_at(live["length"] - 1).world()
            assert world.sim_step == live["sim_step"]
            assert bool(world.attachments) == live["held"]
            for name, (position, orientation) in live["bodies"].items():
                assert list(world.body(name).position) == position
                assert list(world.body(name).orientation) == orientation


def in_child(action: Callable[[], None]) -> int:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            action()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_a_forked_child_leaves_the_recording_to_its_parent(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"

    def child() -> None:
        journal.emit(Event(name="of the child"))
        assert not journal.recording()

    with recorder.record(file):
        journal.emit(Event(name="before"))
        assert in_child(child) == 0
        journal.emit(Event(name="after"))
    with replay.open(file) as log:
        assert log.complete
        assert [record.name for record in log.records(Event)] == ["before", "after"]


def test_a_forked_child_may_leave_the_block(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file):

        def child() -> None:
            with recorder.record(tmp_path / "child.mcap"):
                journal.emit(Event(name="of the child"))

        assert in_child(child) == 0
        journal.emit(Event(name="of the parent"))
    for path, name in ((file, "of the parent"), (tmp_path / "child.mcap", "of the child")):
        with replay.open(path) as log:
            assert log.complete
            assert [record.name for record in log.records(Event)] == [name]


def test_a_child_that_another_thread_forks_while_ctrl_c_is_held_back_hears_it() -> None:
    def hold_back() -> None:
        with Uninterrupted() as section:
            signal.raise_signal(signal.SIGINT)
            assert section.noted

    def child() -> None:
        with pytest.raises(KeyboardInterrupt):
            hold_back()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler

    codes: list[int] = []
    with Uninterrupted():
        thread = threading.Thread(target=lambda: codes.append(in_child(child)))
        thread.start()
        thread.join()
    assert codes == [0]
