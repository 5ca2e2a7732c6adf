"""An editor debugs a recording by the Debug Adapter Protocol: it sees what the prompt shows, forwards and back."""

from __future__ import annotations

import random
import re
import signal
import socket
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import replay
from replay.debug.guided_plan import GuidedPlan
from replay.debug.session import NoFurther, Session
from replay.retrace.plan_process import PlanProcess
from tests.measures import seeded
from tests.replay.debug.editor import PATIENCE, Editor
from tests.replay.debug.plans import TEXT, line
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

pytestmark = pytest.mark.slow

DEMOS = Path(__file__).parents[3] / "demos"


@pytest.fixture
def editor() -> Iterator[Editor]:
    with Editor() as made:
        yield made


@pytest.fixture(scope="session")
def demo_logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("demos")
    logs = {name: folder / f"{name}.mcap" for name in ("set_the_table", "fails_to_reach")}
    for name, log in logs.items():
        command = [sys.executable, "-m", "pycram", "demo", name, "--seed", "1", "--log", str(log)]
        assert subprocess.run(command, capture_output=True, check=False).returncode == (name == "fails_to_reach")
    return logs


def step_of(stopped: dict[str, str]) -> int:
    found = re.match(r"step (\d+)", stopped["description"])
    assert found is not None, stopped
    return int(found[1])


def test_it_stops_at_the_failure_with_frames_tasks_and_why(editor: Editor, demo_logs: dict[str, Path]) -> None:
    stopped = editor.launch(recording=str(demo_logs["fails_to_reach"]))
    assert (stopped["reason"], stopped["text"]) == ("exception", "Unreachable")
    frames = editor.frames()
    assert [each["name"] for each in frames[:3]] == ["try_to_take", "main", "<module>"]
    assert all(Path(each["source"]["path"]).is_file() for each in frames[:3])
    tasks = [each for each in frames if each.get("presentationHint") == "label"]
    assert [each["name"].partition("(")[0] for each in tasks] == ["pick-up", "attempt 4", "failure-handling"]
    assert editor.variables("Parameters", frame=tasks[0]["id"])["arm"]["value"] == "right"
    told = editor.ask("exceptionInfo", threadId=1)
    assert told["exceptionId"] == "Unreachable"
    assert "milk was 1.10 m from the robot" in told["description"]
    assert "Traceback" in told["details"]["stackTrace"]
    assert editor.leave() == 0


def test_variables_of_the_plan_and_the_world_unfold(editor: Editor, plan_log: Path) -> None:
    editor.launch(recording=str(plan_log), step="0")
    place = {
        "source": {"path": str(plan_log.parent / "plan.py")},
        "breakpoints": [{"line": line("body.set_position([0, 0, height])")}],
    }
    (made,) = editor.ask("setBreakpoints", **place)["breakpoints"]
    assert made["verified"]
    stopped = editor.move("continue")
    assert (stopped["reason"], stopped["hitBreakpointIds"]) == ("breakpoint", [made["id"]])
    assert editor.variables("Locals")["lifted"]["value"] == "1"
    heights = editor.variables("Locals", "heights")
    assert {name: each["value"] for name, each in heights.items()} == {"[0]": "0.5", "[1]": "0.7", "[2]": "0.9"}
    assert editor.ask("evaluate", expression=heights["[1]"]["evaluateName"], frameId=0)["result"] == "0.7"
    assert editor.variables("World", "milk")["z"]["value"] == "0.5"
    assert not editor.respond("evaluate", expression="nothing", frameId=0)["success"]
    assert editor.ask("completions", text="1 + lifte", column=10, frameId=0)["targets"][0]["label"] == "lifted"
    assert editor.leave() == 0


def test_data_breakpoints_stop_forwards_and_back(editor: Editor, plan_log: Path) -> None:
    editor.launch(recording=str(plan_log), step="last")
    scopes = editor.ask("scopes", frameId=0)["scopes"]
    world = next(each["variablesReference"] for each in scopes if each["name"] == "World")
    milk = editor.listed(world)["milk"]["variablesReference"]
    editor.listed(milk)
    found = editor.ask("dataBreakpointInfo", variablesReference=milk, name="z")
    assert found["dataId"] == "milk.z"
    (made,) = editor.ask("setDataBreakpoints", breakpoints=[{"dataId": found["dataId"]}])["breakpoints"]
    assert made["verified"]
    heights = []
    for _ in range(2):
        stopped = editor.move("reverseContinue")
        assert (stopped["reason"], stopped["hitBreakpointIds"]) == ("data breakpoint", [made["id"]])
        heights.append(editor.variables("World", "milk")["z"]["value"])
    assert heights == ["0.9", "0.7"]
    assert editor.move("continue")["reason"] == "data breakpoint"
    assert editor.variables("World", "milk")["z"]["value"] == heights[0]
    assert editor.leave() == 0


def test_tasks_lines_and_commands_are_targets(editor: Editor, demo_logs: dict[str, Path]) -> None:
    editor.launch(recording=str(demo_logs["fails_to_reach"]), step="0")
    made, unknown = editor.ask("setFunctionBreakpoints", breakpoints=[{"name": "pick-up"}, {"name": "fly"}])[
        "breakpoints"
    ]
    assert (made["verified"], unknown["verified"]) == (True, False)
    assert "fly" in unknown["message"]
    stopped = editor.move("continue")
    assert stopped["reason"] == "function breakpoint"
    assert editor.frames()[0]["name"] == "try_to_take"
    source = {"path": str(DEMOS / "fails_to_reach.py")}
    line_of = editor.frames()[0]["line"]
    targets = editor.ask("gotoTargets", source=source, line=line_of)["targets"]
    assert step_of(editor.move("goto", targetId=targets[-1]["id"])) == targets[-1]["id"]
    said = editor.ask("evaluate", expression="goto 88", context="repl")["result"]
    assert "step 88 of" in said
    assert step_of(editor.until("stopped")) == 88
    assert "Why: causes on record" in editor.ask("evaluate", expression="why", context="repl")["result"]
    assert editor.leave() == 0


def test_a_plan_is_recorded_first_and_debugged_at_its_failure(editor: Editor, tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(TEXT)
    stopped = editor.launch(program=str(plan), args=["--seed", "5"], log=str(tmp_path / "kept.mcap"))
    assert (stopped["reason"], stopped["text"]) == ("exception", "PlanFailure")
    assert (tmp_path / "kept.mcap").is_file()
    assert editor.leave() == 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({}, "give 'recording' (a file), or 'program'"),
        ({"recording": "/nowhere.mcap"}, "/nowhere.mcap"),
        ({"program": "/nowhere.py"}, "there is no such plan"),
    ],
)
def test_a_launch_that_cannot_be_is_refused(editor: Editor, arguments: dict[str, str], says: str) -> None:
    editor.ask("initialize", adapterID="pycram")
    response = editor.respond("launch", **arguments)
    assert not response["success"]
    assert says in response["message"]
    assert not editor.respond("stackTrace", threadId=1)["success"]
    assert editor.leave() == 0


HANGS = """\
from pycram.bullet_world import BulletWorld
world = BulletWorld()
world.set_gravity([0, 0, -9.8])
if not {made}:
    raise SystemExit
while True:
    pass
"""


@pytest.fixture
def hanging(tmp_path: Path) -> Path:
    """The recording of a plan that ends, which has become one that hangs."""
    plan = tmp_path / "plan.py"
    plan.write_text(HANGS.format(made=False))
    log = record(plan)
    plan.write_text(HANGS.format(made=True))
    return log


def offspring(parent: int) -> set[int]:
    """The ids of a process's children, and of theirs."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True).stdout.split()
    parents = dict(zip(map(int, listed[::2]), map(int, listed[1::2]), strict=True))
    found, before = {parent}, 0
    while before < len(found):
        before = len(found)
        found |= {child for child, its in parents.items() if its in found}
    return found - {parent}


def wait_until(condition: Callable[[], object]) -> None:
    """Wait for a condition that must come."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("leaving", ["disconnect", "closed", "killed"])
def test_an_editor_that_leaves_while_the_plan_runs_leaves_no_process(
    editor: Editor, hanging: Path, leaving: str
) -> None:
    editor.ask("initialize", adapterID="pycram")
    editor.ask("launch", recording=str(hanging), step="last")
    editor.until("initialized")
    editor.ask("configurationDone")
    assert editor.process is not None
    adapter = editor.process
    wait_until(lambda: offspring(adapter.pid))
    children = offspring(adapter.pid)
    if leaving == "disconnect":
        editor.send("disconnect", {})
    elif leaving == "closed":
        editor.writing.close()
    else:
        adapter.send_signal(signal.SIGKILL)
    adapter.wait()
    wait_until(lambda: not any(Path(f"/proc/{child}/exe").exists() for child in children))


def test_a_plan_that_hangs_is_paused(editor: Editor, hanging: Path) -> None:
    editor.ask("initialize", adapterID="pycram")
    editor.ask("launch", recording=str(hanging), step="1")
    editor.until("initialized")
    editor.ask("configurationDone")
    editor.until("stopped")
    editor.ask("continue", threadId=1)
    editor.ask("pause", threadId=1)
    assert editor.until("stopped")["reason"] == "pause"
    assert editor.frames()[0]["line"] >= 6
    assert editor.leave() == 0


def test_an_editor_connects_to_a_port(plan_log: Path) -> None:
    command = [sys.executable, "-m", "replay", "debug", str(plan_log), "--dap", "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as adapter, ExitStack() as open_:
        assert adapter.stderr is not None
        port = int(re.findall(r"port (\d+)", adapter.stderr.readline())[0])
        connected = open_.enter_context(socket.create_connection(("127.0.0.1", port)))
        reading, writing = (open_.enter_context(connected.makefile(mode)) for mode in ("rb", "wb"))
        editor = Editor(streams=(writing, reading))
        assert editor.launch()["reason"] == "exception"
        editor.ask("disconnect")
        assert adapter.wait() == 0


MOVES = ("stepIn", "next", "stepBack", "stepOut", "continue", "reverseContinue", "goto")


@seeded("stops of an editor beside the debugger's own", range(200), 20)
def test_random_stops_show_what_the_debugger_shows(seeds: range, demo_logs: dict[str, Path], plan_log: Path) -> None:
    """Frames, values and steps are the same on both sides, forwards and back."""
    logs = [demo_logs["fails_to_reach"], plan_log, demo_logs["set_the_table"]]
    took: list[float] = []
    dice = random.Random(seeds[0])
    chosen = logs[seeds[0] // len(seeds) % len(logs)]
    with ExitStack() as stack:
        editor = stack.enter_context(Editor())
        log = stack.enter_context(replay.open(chosen))
        session = Session(log, stack.enter_context(GuidedPlan(PlanProcess(log))))
        editor.launch(recording=str(chosen), step="0")
        session.go(0)
        editor.ask("setExceptionBreakpoints", filters=["failure"])
        if session.timeline.failures:
            session.set_break("failure")
        for _ in seeds:
            stop_alike(dice.choice(MOVES), dice, editor, session, took)
        assert editor.leave() == 0
    print(
        f"\nstepBack: slowest {max(took, default=0) * 1e3:.0f} ms, median {statistics.median(took or [0]) * 1e3:.0f} ms"
    )


def values(variables: Iterable[dict[str, Any]]) -> dict[str, str]:
    """Values by name; addresses differ from process to process."""
    return {each["name"]: re.sub("0x[0-9a-f]+", "0x", each["value"]) for each in variables}


def stop_alike(move: str, dice: random.Random, editor: Editor, session: Session, took: list[float]) -> None:
    timeline, now = session.timeline, session.step
    target = dice.randrange(session.plan.last)
    moves = {
        "stepIn": lambda: session.forward(now + 1),
        "next": lambda: session.forward(timeline.following(now)),
        "stepBack": lambda: session.back(timeline.preceding(now)),
        "stepOut": lambda: session.forward(timeline.end(now)),
        "continue": session.forward,
        "reverseContinue": session.back,
        "goto": lambda: session.go(target),
    }
    try:
        moves[move]()
    except NoFurther as error:
        ended = str(error)
    else:
        ended = ""
    if ended:
        assert editor.move(move)["description"] == ended
        return
    began = time.perf_counter()
    stopped = editor.move(move, **({"targetId": target} if move == "goto" else {}))
    if move == "stepBack":
        took.append(time.perf_counter() - began)
    assert step_of(stopped) == session.step, move
    frames = [each for each in editor.frames() if "presentationHint" not in each]
    own = session.plan.ask("where")
    assert [(each["source"]["path"], each["line"], each["name"]) for each in frames] == [
        (each["file"], each["line"], each["function"]) for each in own
    ]
    for number in range(len(own)):
        shown = editor.variables("Locals", frame=number)
        listed = session.plan.ask("variables", frame=number, arguments=False)
        assert values(shown.values()) == values(listed)
    worlds = [each for each in session.log.state_at(session.step).worlds.values() if each.open]
    if len(worlds) == 1 and frames:
        assert list(editor.variables("World")) == list(worlds[0].bodies)
