"""A plan is debugged from its recording: frames and variables at a step, forwards and back, breakpoints and watches."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder.records import Mutation, Run, Task
from replay.cli.main import main
from replay.debug.guided_plan import GuidedPlan
from replay.debug.session import NoQuantity, Session, value_changes
from replay.retrace.plan_process import PlanProcess
from tests.replay.debug.plans import TEXT, line
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.recording import Recording

    Debug = Callable[..., list[str]]

pytestmark = pytest.mark.slow


def moves(log: Recording, body: str) -> list[int]:
    return [each.seq for each in log.records(Mutation) if each.move_body.body == body]


def at(text: str) -> int:
    """The step that the prompt tells."""
    return int(re.findall(r"^step (\d+) of", text, re.MULTILINE)[-1])


def test_frames_and_variables_are_those_of_the_plan_at_the_step(plan_log: Path, debug: Debug) -> None:
    with replay.open(plan_log) as log:
        second = moves(log, "milk")[1]
    _, where, local, args, summed, listed, up, outer, whatis, wrong, number, quote = debug(
        plan_log,
        "where",
        "locals",
        "a",
        "lifted + sum(h for h in heights if h > height)",
        "list",
        "up",
        "p lifted",
        "whatis milk",
        "down 2",
        "up there",
        "state 'milk",
        step=str(second),
    )
    called, move = line("total = lift(milk, [0.5, 0.7, 0.9])"), line("body.set_position([0, 0, height])")
    assert [each.split("/")[-1] for each in where.splitlines()] == [
        f"plan.py({called})<module>()",
        "-> total = lift(milk, [0.5, 0.7, 0.9])",
        f"plan.py({move})lift()",
        "-> body.set_position([0, 0, height])",
    ]
    assert local.splitlines() == [
        "body = Object('milk', 'milk')",
        "heights = [0.5, 0.7, 0.9]",
        "lifted = 2",
        "height = 0.7",
    ]
    assert args.splitlines() == local.splitlines()[:2]
    assert summed == "2.9\n"
    assert f"{move} " in listed
    assert f"->          {TEXT.splitlines()[move - 1].strip()}" in listed
    assert f"({called})<module>()" in up
    assert outer == "*** NameError: name 'lifted' is not defined\n"
    assert whatis == "<class 'pycram.world.object.Object'>\n"
    assert wrong == "*** Newest frame\n"
    assert number == "*** there: expected a number of frames\n"
    assert quote == "*** 'milk: No closing quotation\n"


def test_a_branch_has_the_frames_of_the_code_that_waits_for_it(plan_log: Path, debug: Debug) -> None:
    with replay.open(plan_log) as log:
        step = moves(log, "cup")[0]
    told, where = debug(plan_log, "w", step=str(step))
    assert "[par-2 lift_cup]" in told
    assert [each.rpartition(")")[0].rpartition(")")[2] for each in where.splitlines()[::2]] == [
        "<module>(",
        "lift_cup(",
        "lift(",
    ]


@pytest.mark.parametrize("checkpoints", [True, False], ids=["by checkpoints", "by retracing"])
def test_back_is_the_same_picture_as_on_the_way_there(plan_log: Path, *, checkpoints: bool) -> None:
    def picture(session: Session, step: int) -> str:
        session.go(step)
        ask = session.plan.ask
        frames = ask("where")
        inside = [ask("variables", frame=number, arguments=False) for number in range(len(frames))]
        world = "[random.getstate()[1][:3], [body.get_position() for body in world.objects]]"
        outside = frames and ask("evaluate", frame=len(frames) - 1, expression=world, pretty=False)
        return re.sub(r"0x\w+", "somewhere", f"{frames} {inside} {outside}")

    with replay.open(plan_log) as log, GuidedPlan(PlanProcess(log), checkpoints=checkpoints) as plan:
        session = Session(log, plan)
        steps = range(len(log)) if checkpoints else range(2, len(log), len(log) // 2)
        forwards = [picture(session, step) for step in steps]
        back = [picture(session, step) for step in reversed(steps)]
        assert back[::-1] == forwards
        assert any("NameError" not in each for each in forwards)
        assert (plan.copies.runs == 1) == checkpoints


def test_commands_lead_to_steps_of_the_task_tree(plan_log: Path, debug: Debug) -> None:
    with replay.open(plan_log) as log:
        block = next(each for each in log.records(Task) if each.name == "par" and each.phase == Task.STARTED)
        end = next(each.seq for each in log.records(Task, block.seq) if each.task == block.task and each.phase == 2)
        branch = next(each.seq for each in log.records(Task) if each.name == "paint")
    _, step, rstep, over, back, into, out, on = debug(
        plan_log, "s", "rs", "n", "rn", f"g {branch + 1}", "r", "until last", step=str(block.seq)
    )
    assert (at(step), at(rstep)) == (block.seq + 1, block.seq)
    assert (at(over), at(back)) == (end, block.seq)
    assert at(into) == branch + 1
    with replay.open(plan_log) as log:
        assert (log[at(out)].phase, log[at(out)].name) == (Task.FINISHED, "paint")
        assert at(on) == len(log) - 1
    assert on.splitlines()[-1].startswith("the recording ends here; the plan failed: PlanFailure: at last")
    assert "end False" in on.splitlines(), "what the plan has printed on the way is shown"


def test_breakpoints_stop_on_the_way_and_back(plan_log: Path, debug: Debug) -> None:
    move = line("body.set_position([0, 0, height])")
    with replay.open(plan_log) as log:
        lifts = [*moves(log, "milk"), *moves(log, "cup")]
        rung = next(each.seq for each in log if getattr(each, "name", "") == "rung" and hasattr(each, "handlers"))
        failed = [each.seq for each in log if "failure" in each.DESCRIPTOR.fields_by_name and each.HasField("failure")]
    answers = debug(
        plan_log,
        f"b plan.py:{move}",
        "b event rung",
        "tbreak attempt 1",
        "b failure",
        "b",
        *["c"] * (len(lifts) + 3),
        "rc",
        "rc",
        "cl 1 2",
        "rc",
        "disable 4",
        "c",
        "b nowhere",
        "b event bell",
        "b 4711",
        f"b plan.py:{move - 1}",
    )
    _, first, _, _, _, listed, *rest = answers
    assert first == f"Breakpoint 1: plan.py:{move}: steps {', '.join(map(str, sorted(lifts)))}\n"
    assert "(once)" in listed
    hits, back = rest[: len(lifts) + 3], rest[len(lifts) + 3 :]
    assert [at(each) for each in hits[: len(lifts) + 1]] == [*sorted(lifts), rung]
    assert "task attempt 1" in hits[-2]
    assert at(hits[-1]) == failed[0]
    assert [at(each) for each in back[:2]] == [rung, max(lifts)]
    assert at(back[3]) == 0, "none is left before"
    assert "recording ends here" in back[5]
    assert "there is no such step or task" in back[6]
    assert "did you mean" in back[7] or "there are rung" in back[7]
    assert "there is no step 4711" in back[8]
    assert f"plan.py:{move}" in back[9]
    assert f"line {move - 1} made no record" in back[9]


@pytest.mark.costly
def test_watches_find_where_a_state_or_a_variable_changed(plan_log: Path, debug: Debug) -> None:
    with replay.open(plan_log) as log:
        up = moves(log, "milk")
        last = len(log) - 1
    answers = debug(
        plan_log,
        "watch milk.z > 0.6",
        "rc",
        "cl",
        "rwatch milk.z",
        f"g {up[2]}",
        "watch lifted",
        "rc",
        "rc",
        "c",
        "rwatch nothing.like_it",
        "rwatch world",
        step=str(up[2]),
    )
    _, watched, over, _, changed, _, variable, one, two, three, neither, never = answers
    assert watched.startswith("Watch 1: milk.z > 0.6: steps ")
    assert (at(over), over.splitlines()[0]) == (up[1], "watch milk.z > 0.6: False -> True")
    assert (at(changed), changed.splitlines()[0]) == (up[0], "watch milk.z: 0.2 -> 0.5")
    assert variable == "Watch 2: lifted: its changes are found when the plan runs\n"
    assert (at(one), one.splitlines()[0]) == (up[1], "watch lifted: 1 -> 2")
    assert at(two) == 0, "it was 1 at its first record: it has not changed before"
    assert (at(three), three.splitlines()[-3][:4]) == (up[1], "step")
    assert neither.startswith("*** nothing.like_it")
    assert never == "*** world didn't change before this step\n"
    assert last > up[2]


def test_a_watch_is_about_the_world_opened_last_that_has_the_object(tmp_path: Path) -> None:
    file = tmp_path / "worlds.mcap"
    with recorder.record(file), BulletWorld(name="big lab") as lab, BulletWorld(name="kitchen") as kitchen:
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1], world=lab)  # step 3
        milks = [Object("milk", "milk", "milk.stl", [0, 0, 1], world=world) for world in (lab, kitchen)]  # 4 and 5
        for body in (cup, *milks):
            body.set_position([0, 0, 2])
    with replay.open(file) as log:
        steps = {
            text: [each.step for each in value_changes(log, text)] for text in ("cup.z", "milk.z", "big_lab.milk.z")
        }
        with pytest.raises(NoQuantity, match="kitchen"):
            value_changes(log, "kitchen")
    assert [each[:2] for each in (steps["cup.z"], steps["big_lab.milk.z"])] == [[3, 6], [4, 7]]
    assert steps["milk.z"][:2] == [4, 8], "from step 5 on the kitchen's, which is where the lab's is"


def test_a_watch_misses_nothing_where_copies_wait(plan_log: Path) -> None:
    with replay.open(plan_log) as log, GuidedPlan(PlanProcess(log)) as plan:
        session = Session(log, plan)
        up = moves(log, "milk")
        for step in range(len(log) - 1, up[0] - 1, -1):
            session.go(step)
        assert len(plan.copies.checkpoints()) > 2
        session.set_watch("lifted", 0)
        assert [session.forward().arrival.step for _ in up[1:]] == up[1:]
        assert [session.back().arrival.step for _ in up[1:]] == [up[1], 0]


def test_what_an_expression_changes_is_undone(plan_log: Path, debug: Debug) -> None:
    with replay.open(plan_log) as log:
        step, last = moves(log, "milk")[0], len(log) - 1
    _, moved, position, statement, assigned, value, on = debug(
        plan_log, "body.set_position([9, 9, 9]) or heights.clear()", "p body.get_position()[0], heights",
        "!heights = []", "heights = []", "!list(heights)", "c", step=str(step),
    )  # fmt: skip
    assert moved == "None\n"
    assert position == "(0.0, [0.5, 0.7, 0.9])\n"
    assert statement == assigned
    assert "can't be executed" in statement
    assert value == "[0.5, 0.7, 0.9]\n"
    assert at(on) == last


def test_an_expression_that_ends_its_process_ends_not_the_plan(plan_log: Path, debug: Debug) -> None:
    _, left, killed, nothing, value = debug(
        plan_log, "p __import__('os')._exit(3)", "__import__('os').kill(__import__('os').getpid(), 9)", "p", "p total",
        step="last",
    )  # fmt: skip
    assert left.endswith("the copy of the plan that computed it ended with exit code 3\n")
    assert killed.endswith("the copy of the plan that computed it was ended by SIGKILL\n")
    assert "SyntaxError" in nothing
    assert value == "3\n"


def test_the_future_of_a_branch_that_runs_is_shown_and_not_waited_for(tmp_path: Path, debug: Debug) -> None:
    file = tmp_path / "plan.py"
    file.write_text("""from pycram.fluent import Fluent
from pycram.language import par
level = Fluent(None, "level")
with par as s:
    waits = s(level.wait_for)
    s(level.set_value, 1)
""")
    log = record(file)
    with replay.open(log) as recording:
        begins = next(each.seq for each in recording.records(Task) if each.kind == "branch")
    _, local, waited = debug(log, "locals", "p waits.result()", step=str(begins))
    assert "waits = <result of Branch(" in local
    assert waited.startswith("*** DeadlockedBranches: ")


SHARED = {
    "a file that is read bit by bit": """
with open(__file__.replace("plan.py", "way.txt")) as way:
    for number, line in enumerate(way):
        if not number % 200:
            cup.set_position([0, 0, float(line)])
""",
    "a process that is waited for": """
child = os.fork()
if not child:
    os._exit(3)
for z in range(4):
    cup.set_position([0, 0, z])
cup.set_position([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 0, 0])
""",
    "projections, several at once": """
outcomes = project_all([(cup.set_position, [0, 0, z]) for z in range(4)], until="all")
cup.set_position([sum(each.succeeded for each in outcomes), 0, 0])
""",
}


@pytest.mark.parametrize("text", SHARED.values(), ids=SHARED)
def test_what_copies_would_share_is_the_same_on_each_way_there(tmp_path: Path, text: str) -> None:
    file = tmp_path / "plan.py"
    scene = """import os
from pycram.bullet_world import BulletWorld, Object
from pycram.projection import project_all
cup = Object("cup", "cup", "cup.stl", world=BulletWorld())
"""
    file.write_text(scene + text)
    (tmp_path / "way.txt").write_text("".join(f"{number / 1000:.12f}\n" for number in range(2000)))
    with replay.open(record(file)) as log, GuidedPlan(PlanProcess(log)) as plan:
        last = len(log) - 1
        for step in range(last + 1):
            plan.go(step)
            assert plan.go(last).reason == "step", plan.parted


def test_a_plan_that_parts_from_its_recording_stops_there(plan_log: Path, tmp_path: Path, debug: Debug) -> None:
    other = tmp_path / "plan.py"
    setting = "level.set_value(total + os.path.isfile(__file__))"
    other.write_text(TEXT.replace("level.set_value(total)", setting).replace("import random", "import os, random"))
    with replay.open(plan_log) as log:
        changed = next(each.seq for each in log if getattr(each, "after_json", "") == "3")
    _, parted, variable, further, back = debug(
        plan_log, "c", "p total", "s", f"g {changed - 2}", options=("--plan", str(other))
    )
    assert f"*** the plan differs from its recording after step {changed - 1}: " in parted
    number = line("level.set_value(total)")
    assert f"plan.py:{number} where step {changed} has" in parted
    assert f"; plan.py:{number} reads a file: os.path.isfile()" in parted
    assert variable == "3\n"
    assert further.startswith(f"*** the plan reaches only step {changed - 1}: ")
    assert at(back) == changed - 2


def test_the_recording_answers_at_the_step_and_a_fork_goes_on(plan_log: Path, tmp_path: Path, debug: Debug) -> None:
    with replay.open(plan_log) as log:
        step = moves(log, "milk")[1]
    _, state, tree, blame, asked, _, wrong = debug(
        plan_log, "state milk", "tree --depth 1", "blame milk", "ask stable(milk)",
        f"fork {tmp_path / 'on.mcap'}", "state jug", step=str(step),
    )  # fmt: skip
    assert "0.7000" in state
    assert "par" not in tree
    assert f"step {step}" in blame
    assert asked.startswith("stable(milk): ")
    assert wrong.startswith("*** there is no object 'jug'")
    with replay.open(plan_log) as log, replay.open(tmp_path / "on.mcap") as fork:
        assert len(fork) == len(log)
        assert fork[0].origin.step == step


@pytest.fixture(scope="module")
def forked(plan_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fork after the milk has moved twice."""
    with replay.open(plan_log) as log:
        step = moves(log, "milk")[1]
    file = tmp_path_factory.mktemp("forked") / "forked.mcap"
    given = ["--set", "milk.position=2,2,2", "--set", "level=9", "--answer", "contact(...)=true", "--seed", "7"]
    assert main(["fork", str(plan_log), "--at", str(step), *given, "-o", str(file)]) == 1  # as the plan
    return file


@pytest.mark.parametrize("checkpoints", [True, pytest.param(False, marks=pytest.mark.costly)])
def test_a_fork_is_debugged_with_its_changes(forked: Path, debug: Debug, *, checkpoints: bool) -> None:
    with replay.open(forked) as log:
        start, last = log[0], len(log) - 1
        assert isinstance(start, Run)
        step = start.origin.step
        assert log[step + 1].by_fork
    _, end, back, on, again = debug(
        forked, f"g {last}", f"g {step}", "s", f"g {last}", options=() if checkpoints else ("--no-checkpoints",)
    )
    assert [at(each) for each in (end, back, on, again)] == [last, step, step + 1, last]
    assert "by the fork" in on


def test_a_breakpoint_in_one_of_several_files_of_a_name_is_in_the_named_one(tmp_path: Path, debug: Debug) -> None:
    for folder, lines in (("one", ""), ("two", "\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "lifting.py").write_text(f"{lines}def lift(body):\n    body.set_position([0, 0, 1])\n")
    plan = tmp_path / "plan.py"
    plan.write_text(
        "import one.lifting, two.lifting\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        "world = BulletWorld()\n"
        "milk = Object('milk', 'milk', 'milk.stl')\n"
        "one.lifting.lift(milk)\n"
        "two.lifting.lift(milk)\n"
    )
    _, either, first, second = debug(record(plan), "b lifting.py:2", "b one/lifting.py:2", "b two/lifting.py:3")
    assert either.startswith("*** lifting.py:2: several of the plan's files have this name: ")
    assert first == "Breakpoint 1: lifting.py:2: step 3\n"
    assert second == "Breakpoint 2: lifting.py:3: step 4\n"


@pytest.mark.costly
def test_a_failed_run_is_debugged_at_once(tmp_path: Path) -> None:
    plan = tmp_path / "fails.py"
    plan.write_text("import sys\ndef f(reason):\n    raise ValueError(reason)\nf(sys.argv[2])\n")
    command = [sys.executable, "-m", "pycram", "run", plan, "--log", tmp_path / "x.mcap", "--debug-on-failure"]
    command += ["--", "--secret", "so"]  # which the recording lacks
    ended = subprocess.run(
        command, input="args\nup\n", capture_output=True, text=True, check=False, timeout=120, cwd=tmp_path
    )
    assert ended.returncode == 1
    assert "(debug) args\nreason = 'so'\n" in ended.stdout
    assert "> fails.py(4)<module>()" in ended.stdout


def test_what_can_t_be_is_told_before_it_is_tried(
    plan_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "moved.mcap"
    copy.write_bytes(plan_log.read_bytes())
    assert main(["debug", str(copy), "--plan", str(tmp_path / "none.py")]) == 2
    assert "there is no such plan" in capsys.readouterr().err
    program = tmp_path / "program.py"
    program.write_text(f'import recorder\nwith recorder.record("{tmp_path / "program.mcap"}"):\n    print(1)\n')
    subprocess.run([sys.executable, program], check=True, capture_output=True, timeout=60)
    program.write_text("print(1)\n")
    assert main(["debug", str(tmp_path / "program.mcap")]) == 2
    assert "this isn't the plan of the recording: the plan ended where step 0 has" in capsys.readouterr().err
    assert main(["debug", str(copy), "4711"]) == 2
    assert "there is no step 4711" in capsys.readouterr().err
