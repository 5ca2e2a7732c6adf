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

    from replay.origins.origin import Origins
    from replay.retrace.plan_process import Guidance

SCENE = """\
from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import moving, pick_up, place
world = BulletWorld(name="lab")
world.set_gravity([0, 0, -9.8])
floor = Object("floor", "environment", "plane.urdf")
robot = world.robot = Object("pr2", "robot", "pr2.urdf")
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
def why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], tuple[Origins, list[str]]]:
    """Runs a plan that fails; returns the origins and the first 20 lines of `why --origins`."""

    def start(process: PlanProcess, module: str, guidance: Guidance, folder: str, _: object, **facts: object) -> Forked:
        request = {"plan": str(process.program), "arguments": [], "guidance": guidance.as_json()}
        return Forked(module, {**request, "parent": os.getpid(), "folder": folder, **facts})

    def explained(plan: str) -> tuple[Origins, list[str]]:
        with replay.open(recorded(tmp_path, plan)) as log:
            why = log.why()
            found = origins(log, why)
            return found, list(why_report.lines(why, "x.mcap", found.lines()))[:20]

    monkeypatch.setattr(PlanProcess, "start", start)
    return explained


def test_the_lines_that_made_a_number_come_first(why: Callable[[str], tuple[Origins, list[str]]]) -> None:
    found, printed = why(
        """
        COUNTER, RIM = 0.86, 8
        SPOTS = [[1.4, 0.6], [1.4, 0.9]]
        def spot(number, height=COUNTER):
            x, y = SPOTS[number - 1]
            z = height + RIM
            return [x, y, z]
        milk = Object("milk", "milk", "milk.stl", [0.6, 0.2, 0.1])
        for number in range(2):
            if number == 0:
                milk.set_position(spot(number))
            perform(pick_up(object=milk, arm="left"))
        """,
    )
    assert any("z = height + RIM  # z = 8.86" in line for line in printed), printed
    assert any("number - 1 = -1 = [1.4, 0.9]" in line for line in printed), printed
    assert found.failed.text == 'perform(pick_up(object=milk, arm="left"))'


@pytest.mark.usefixtures("why")
def test_the_verb_gives_origins_as_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path, "thing = floor\nperform(pick_up(object=thing))")
    capsys.readouterr()
    assert main(["why", "--origins", "--json", log]) == 0
    (value,) = json.loads(capsys.readouterr().out)["origins"]["failed"]["parts"]
    assert (value["kind"], value["name"], value["text"]) == ("value", "thing", "thing = floor")
