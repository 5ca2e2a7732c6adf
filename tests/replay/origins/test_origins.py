"""Where the values of a failure come from."""

from __future__ import annotations

import json
import os
import signal
import sys
from importlib import import_module
from textwrap import dedent
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.bullet_world import BulletWorld
from pycram.running import RunSpec, run
from replay.cli.main import main
from replay.explain import why_report
from replay.origins.origins import origins
from replay.retrace.plan_process import PlanProcess

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.retrace.plan_process import Guidance

SCENE = """\
from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import moving, pick_up, place
world = BulletWorld(name="lab")
world.set_gravity([0, 0, -9.8])
floor = Object("floor", "environment", "plane.urdf")
robot = world.robot = Object("pr2", "robot", "pr2.urdf")
milk = Object("milk", "milk", "milk.stl", [0.6, 0.2, 0.1])
"""


def recorded(folder: Path, plan: str) -> str:
    """Run a plan that fails; return its recording."""
    file = folder / f"{folder.name}.py"  # a name of its own, so this is the first recording of that name
    file.write_text(SCENE + dedent(plan))
    assert run(RunSpec(file), folder / "x.mcap") == 1
    while BulletWorld.current_bullet_world is not None:
        BulletWorld.current_bullet_world.exit()
    return str(folder / "x.mcap")


class Forked:
    """A fork of this process that does what a new process would do: nothing is imported again."""

    def __init__(self, module: str, request: dict[str, object]) -> None:
        self.pid = os.fork()
        if not self.pid:
            try:
                sys.argv = ["-c", json.dumps(request)]
                import_module(module).main()
            finally:
                os._exit(1)
        self.ended = False

    def wait(self) -> None:
        if not self.ended:
            os.waitpid(self.pid, 0)
            self.ended = True

    def kill(self) -> None:
        if not self.ended:
            os.kill(self.pid, signal.SIGKILL)


@pytest.fixture
def why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[str]]:
    """Runs a plan that fails; returns the first 20 lines of `why --origins`."""

    def start(process: PlanProcess, module: str, guidance: Guidance, folder: str, _: object, **facts: object) -> Forked:
        request = {"plan": str(process.program), "arguments": [], "guidance": guidance.as_json()}
        return Forked(module, {**request, "parent": os.getpid(), "folder": folder, **facts})

    def explained(plan: str) -> list[str]:
        with replay.open(recorded(tmp_path, plan)) as log:
            why = log.why()
            return list(why_report.lines(why, "x.mcap", origins(log, why).lines()))[:20]

    monkeypatch.setattr(PlanProcess, "start", start)
    return explained


#: Plans that fail; `# here` is at the line of the fix. Each prints what the second text says of that line.
PLANS = {
    "a unit, behind a helper and a default": (
        """
        RIM = 8  # here
        def spot(x, y, height=0.86):
            z = height + RIM
            return [x, y, z]
        def bring(target, **rest):
            perform(moving(target=target, **rest))
        bring(spot(0.4, 0.2), orientation=[0, 0, 0, 1])
        """,
        "RIM = 8",
    ),
    "an index that wraps around": (
        """
        WAYS = ["left", "right", "middle"]  # here
        for number in range(2):
            perform(pick_up(object=milk, arm=WAYS[number - 1]))
        """,
        "number - 1 = -1 = 'middle'",
    ),
    "a default that keeps values of earlier calls": (
        """
        def route(stop, stops=[]):  # here
            stops.append(stop)
            return stops
        route(0.5)
        x, y = route(0.1), 0
        perform(moving(target=[*x, y, 0, 0]))
        """,
        "stops: kept from earlier calls",
    ),
    "a loop variable that is read late": (
        """
        ways = []
        for arm in ("left", "middle"):
            ways.append(lambda: arm)  # here
        perform(pick_up(object=milk, arm=ways[0]()))
        """,
        "arm: as the loop left it",
    ),
    "a zero that counts as missing": (
        """
        def height(given):
            return given or 40  # here
        perform(moving(target=[0.2, 0, height(0.0)]))
        """,
        "given is 0, which counts as missing here",
    ),
    "numbers that are sorted as text": (
        """
        rows = [{"x": "9"}, {"x": "10"}]
        rows.sort(key=lambda row: row["x"])  # here
        perform(moving(target=[float(rows[1]["x"]), 0, 0, 0]))
        """,
        "row['x'] is text, not a number: '10' comes before '9'",
    ),
    "a list that changes while a loop runs": (
        """
        places = [0.1, 0.2, 30.0, 0.3]
        def done(place):
            places.remove(place)
        for place in places:  # here
            done(place)
            last = place
        perform(moving(target=[last, 0, 0, 0]))
        """,
        "places changes while the loop runs, at line",
    ),
    "a division that rounds down": (
        """
        def share(length, parts):
            size = length // parts  # here
            return [0.5 / size, 0, 0]
        perform(moving(target=share(1, 2)))
        """,
        "length // parts rounds 0.5 down",
    ),
    "a position that was read before the object moved": (
        """
        box = Object("cereal", "cereal", "breakfast_cereal.stl", [0.7, 0.4, 0.1])
        x, y, z = box.get_position()  # here
        box.set_position([0.7, 0.9, 0.1])
        box.set_position([0.7, 0.91, 0.1])
        perform(moving(target=[x, y, z, 1]))
        """,
        "cereal has moved 0.510 m since then, farthest at step",
    ),
    "a field that was left out": (
        """
        from dataclasses import dataclass
        @dataclass
        class Job:
            thing: str
            arm: str = "middle"  # here
        class Work:
            def __init__(self, *jobs):
                self.jobs = list(jobs)
            def next(self):
                return self.jobs.pop(0)
        job = Work(Job("milk"), Job("cup", "left")).next()
        perform(pick_up(object=world.get_object(job.thing), arm=job.arm))
        """,
        "job.arm = 'middle'",
    ),
    "an entry that another name changed": (
        """
        SPOTS = {"home": [0, 0, 0], "shelf": [1, 0, 0]}
        spot = SPOTS["home"]
        spot[2] = "high"  # here
        perform(moving(target=SPOTS["home"]))
        """,
        "spot[2] =",
    ),
    "a branch": (
        """
        battery = 20
        if battery < 50:  # here
            arm = "middle"
        else:
            arm = "left"
        perform(pick_up(object=milk, arm=arm))
        """,
        "battery < 50 is True",
    ),
    "a name that hides another": (
        """
        arm = "left"
        def take(thing):
            arm = "middle"  # here
            perform(pick_up(object=thing, arm=arm))
        take(milk)
        """,
        "arm: hides arm of line",
    ),
    "a quaternion whose w comes first": (
        """
        UPRIGHT = [1, 0, 0, 0]  # here
        perform(moving(target=[0.1, 0, 0], orientation=UPRIGHT))
        """,
        "perhaps orientation [1, 0, 0, 0] has w first",
    ),
    "a position relative to the robot": (
        """
        from recorder import geometry
        robot.set_position([3, 0, 0])
        seen = geometry.transform(geometry.invert((robot.get_position(), [0, 0, 0, 1])), milk.get_position())  # here
        perform(place(object=milk, target=list(seen), arm="left"))
        """,
        "perhaps target [-2.4, 0.2, 0.1] is milk's position relative to pr2",
    ),
    "an angle in degrees": (
        """
        ANGLE = 60  # here
        robot.set_joint_position("l_elbow_flex_joint", -ANGLE)
        """,
        "perhaps 60 is in degrees (-1.047 rad): l_elbow_flex_joint goes from -2.321 to 0",
    ),
    "an early return": (
        """
        places, seen = [[0.1, 0, 0]], []
        def prepare(number):
            if number in seen:  # here
                return
            seen.append(number)
            places.append([0.2, 0, 0])
        for number in (1, 1, 1):
            prepare(number)
            perform(moving(target=places.pop()))
        """,
        "unlike at step",
    ),
    "an entry under another key": (
        """
        held = {}
        def take(thing, arm):
            held[thing.name] = arm  # here
        take(milk, "left")
        free = next(arm for arm in ("left", "right") if arm not in held)
        perform(moving(target=[free, 0, 0]))
        """,
        "held[thing.name] = arm",
    ),
    "a loop that doesn't run": (
        """
        for number in range(1, 0):  # here
            perform(pick_up(object=milk, arm="left"))
        perform(place(object=milk, target=[0.5, 0.2, 0.1], arm="left"))
        """,
        "the loop was empty",
    ),
}


@pytest.mark.parametrize("kind", PLANS)
def test_the_line_of_the_fix_is_among_the_first_lines(kind: str, why: Callable[[str], list[str]]) -> None:
    plan, said = PLANS[kind]
    printed = why(plan)
    assert any("# here" in line for line in printed), "\n".join(printed)
    assert any(said in line for line in printed), "\n".join(printed)


def test_a_statement_that_fails_has_no_values_of_its_last_iteration(why: Callable[[str], list[str]]) -> None:
    printed = why("""
        ARMS = {"milk": "left", "cup": "right"}
        for name in ("milk", "spoon"):
            arm = ARMS[name]
    """)
    assert any("# name = 'spoon'" in line for line in printed), "\n".join(printed)
    assert not any("'left'" in line.partition("#")[2] for line in printed), "\n".join(printed)


def test_values_of_an_earlier_iteration_have_their_step(why: Callable[[str], list[str]]) -> None:
    printed = why("""
        taken = []
        for name in ("milk", "spoon"):
            if name in taken or len(taken) > 0:
                perform(moving(target=[len(taken), name, 0]))
            milk.set_position([0.6, 0.3, 0.1])
            taken.append(name)
    """)
    (said,) = (line.partition("# ")[2].split("; ") for line in printed if "for name in" in line)
    assert sorted(each.rstrip("0123456789") for each in said) == ["name = 'milk' after step ", "name = 'spoon'"]


@pytest.mark.usefixtures("why")
def test_the_verb_gives_origins_as_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path, "thing = floor\nperform(pick_up(object=thing))")
    capsys.readouterr()
    assert main(["why", "--origins", "--json", log]) == 0
    call = json.loads(capsys.readouterr().out)["origins"]["failed"]
    assert (call["parts"][0]["kind"], call["parts"][0]["name"]) == ("value", "thing")
    assert (call["parts"][0]["text"], call["parts"][0]["parts"][0]["name"]) == ("thing = floor", "floor")
