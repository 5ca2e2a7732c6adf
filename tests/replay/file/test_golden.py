"""Recordings of every release stay readable: what each must give, whatever is added to the definition later.

``golden/VERSION.mcap`` was made by that release with ``pycram run tests/replay/golden/plan.py``,
``golden/demos/VERSION-DEMO.mcap`` with the demo, ``golden/reasons/VERSION.mcap``, ``golden/forks/VERSION.mcap``,
``golden/motions/VERSION.mcap`` and ``golden/motions/VERSION-program.mcap`` as the plans beside them say. A new release adds its own files; none is ever replaced.
``golden/demos/why.json`` has the explanations of the demos: steps, causes and types, but no wording.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import replay
from recorder.records import Check, Event, Fluent, Keyframe, Mutation, Output, Query, Refusal, Run, Subscription, Task
from replay.cli.main import main
from replay.history.tasks import tree
from replay.restore.verify import verify
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("*.mcap"))
GUIDE = Path(__file__).parents[3] / "docs" / "reference" / "command_line.md"
REASONS = sorted((Path(__file__).parents[1] / "golden" / "reasons").glob("*.mcap"))
FORKS = sorted((Path(__file__).parents[1] / "golden" / "forks").glob("*[0-9].[0-9].mcap"))
MOTIONS = sorted((Path(__file__).parents[1] / "golden" / "motions").glob("*[0-9].[0-9].mcap"))
CHECKS = sorted((Path(__file__).parents[1] / "golden" / "checks").glob("*.mcap"))
DEMOS = sorted((Path(__file__).parents[1] / "golden" / "demos").glob("*.mcap"))
EXPLANATIONS = json.loads((Path(__file__).parents[1] / "golden" / "demos" / "why.json").read_text())
COMMANDS = [
    "open_world",
    "set_gravity",
    *["load_body"] * 4,
    "simulate",
    "move_joints",
    "attach_body",
    "move_body",
    "detach_body",
    *["move_body"] * 112,
]


@pytest.fixture(params=GOLDEN, ids=lambda file: file.stem)
def log(request: pytest.FixtureRequest) -> Iterator[Recording]:
    with replay.open(request.param) as opened:
        yield opened


def test_golden_recordings_are_small() -> None:
    assert GOLDEN
    assert CHECKS
    assert REASONS
    assert FORKS
    assert MOTIONS
    assert all(file.stat().st_size < 100_000 for file in (*GOLDEN, *REASONS, *FORKS, *CHECKS))
    assert all(file.stat().st_size < 200_000 for file in MOTIONS)


def test_golden_recording_is_complete(log: Recording) -> None:
    assert log.complete
    assert log.check_file() == ""
    assert [record.seq for record in log] == list(range(len(log)))
    assert log.metadata["plan"] == "plan"
    assert log.metadata["pybullet"]


def test_golden_recording_has_records_of_every_kind(log: Recording) -> None:
    kinds = (Run, Task, Mutation, Event, Fluent, Query, Keyframe)
    assert [sum(1 for _ in log.records(kind)) for kind in kinds] == [2, 12, 123, 3, 1, 4, 1]
    assert [record.WhichOneof("command") for record in log.records(Mutation)] == COMMANDS
    assert [record_data(query)["answer"] for query in log.records(Query)] == [False, True, False, False]
    assert [record_data(fluent)["after"] for fluent in log.records(Fluent)] == [True]
    visible = list(log.records(Query))[1]
    assert record_data(visible)["evidence"]["hidden_by"].keys() == {"cereal"}


def test_golden_recording_gives_states(log: Recording) -> None:
    end = log.state_at("last").world("table")
    assert end.open
    assert end.gravity == (0, 0, -9.8)
    assert end.seconds == pytest.approx(0.2)
    assert list(end.bodies) == ["floor", "milk", "cereal", "cabinet"]
    assert end.body("milk").position == (0, 0, 0.5)
    assert end.body("cereal").position == pytest.approx((0.609, 0.2, 0.13), abs=1e-12)
    assert end.body("cabinet").joints == pytest.approx({"drawer_joint": 0.25}, abs=1e-12)
    carrying = log.state_at("task:carry@start").world("table")
    held = log.state_at(next(r.seq for r in log.records(Mutation) if r.HasField("attach_body")))
    assert not carrying.attachments
    assert held.world("table").carrier("milk").carrier == "cereal"
    drawer = held.link_pose(held.body("cabinet"), "drawer")
    assert drawer[0] == pytest.approx((2.25, 0, 0.6), abs=1e-9)


def test_golden_recording_gives_tasks_call_stacks_and_failures(log: Recording) -> None:
    paths = [node.path for _, node in tree(log).walk()]
    assert paths[0] == "carry"
    assert paths[-2:] == ["put", "put"]
    found = log.why()
    assert found.failure.message == "the milk can't be put anywhere"
    assert found.exceptions[0].lines[-1].text.startswith("raise btr.ReasoningError(")
    assert [each.task.parameters["height"] for each in found.attempts] == [1.0, 0.5]
    assert log.blame("milk", "task:carry@end").how == "carried"


def test_golden_recording_has_its_files(log: Recording) -> None:
    names = {name.partition("/")[2] for name in log.assets}
    assert {"plan.py", "carton.stl", "cabinet.urdf"} <= names
    for name, content in log.assets.items():
        assert hashlib.sha256(content).hexdigest() == name.partition("/")[0]


@pytest.mark.parametrize("verb", ["info", "log", "tree", "show 9", "state last", "diff 9 last", "blame milk", "why"])
def test_every_reading_verb_reads_the_golden_recording(
    log: Recording, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    name, *rest = verb.split()
    assert main([name, str(log.path), *rest]) == 0
    output = capsys.readouterr()
    assert output.out.strip()
    assert not output.err


@pytest.mark.parametrize("file", CHECKS, ids=lambda file: file.stem)
def test_recorded_properties_stay_readable_and_violated(file: Path) -> None:
    with replay.open(file) as log:
        violated = [record for record in log.records(Check) if record.phase == Check.VIOLATED]
        assert [(record.property, record.step, record.moment, record.by_run) for record in violated] == [
            ("milk.z < 1 until milk.x > 1", 7, 0, False),
            ("always milk.z > 0.3", 10, 56, True),
            ("eventually milk.x > 1 within 1 s", 10, 72, True),
        ]
        again = [each.verdict.violations[0] for each in log.check(*(record.property for record in violated))]
        assert [(each.moment.step, each.moment.sim_step) for each in again] == [(7, 0), (10, 56), (10, 72)]
        assert [each.margin for each in again] == [record.margin for record in violated]
        assert verify(log).sound


@pytest.mark.parametrize("file", REASONS, ids=lambda file: file.stem)
def test_recorded_reasons_stay_readable_and_explain_the_failure(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(file) as log:
        kinds = (Subscription, Refusal, Output, Query)
        assert [sum(1 for _ in log.records(kind)) for kind in kinds] == [2, 1, 2, 1]
        (choice,) = log.records(Query)
        assert [(each.reason, each.count, list(each.names)) for each in choice.candidates] == [
            ("OutOfReach", 2, ["middle", "upper"]),
            ("Misfit", 1, ["lower"]),
        ]
        assert choice.chosen == -1
        (moved,) = (change for change in log.records(Mutation) if change.HasField("move_body"))
        event = log[moved.cause]
        assert isinstance(event, Event)
        assert (event.name, [each.handler for each in event.handlers]) == ("bell", ["__main__.main.<locals>.deliver"])
        failed = next(node for _, node in tree(log).walk() if node.kind == "motion")
        assert failed.decision is not None
        assert failed.decision.resolver == "__main__.take"
        why = log.why()
        assert [(cause.kind, cause.steps) for cause in why.causes] == [
            ("refused", (14, 16, 19)),
            ("raised", (19,)),
            ("no-candidate", (18, 19)),
        ]
        assert any(values.get("designator") for values in why.variables.values())
        assert verify(log).sound
    for verb in ("log", "tree", "why", "blame cereal"):
        name, *rest = verb.split()
        assert main([name, str(file), *rest]) == 0
        assert not capsys.readouterr().err


@pytest.mark.parametrize("file", FORKS, ids=lambda file: file.stem)
def test_forks_stay_readable_with_what_they_imagined_and_restored(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with replay.open(file) as log:
        start = log[0]
        assert isinstance(start, Run)
        assert (start.origin.recording, start.origin.step, start.number) == ("run.mcap", 16, 1)
        assert start.origin.wall_time_ns
        ended = [task for task in log.records(Task) if task.phase == Task.FINISHED]
        assert [task.kind for task in ended if task.checkpoint] == ["wait", "in-thread", "timeout"]
        outcomes = [json.loads(task.result_json) for task in ended if task.kind == "projection"]
        assert [outcome["failure"] for outcome in outcomes] == [None, "PlanFailure: milk isn't to stand at -1", None]
        assert [outcome["duration"] for outcome in outcomes] == [0.05] * 3
        restored = [record for record in log.records(Mutation) if record.HasField("restore")]
        assert [(record.restore.sim_step, len(record.restore.attachments)) for record in restored] == [(12, 1), (0, 1)]
        at = log.state_at(restored[0].seq).world("table").body("milk").position
        assert list(at) == outcomes[0]["result"]
        assert log.state_at(restored[1].seq).world("table").body("cereal").position == pytest.approx((1, 0, 0.13))
        assert log.blame("milk", restored[0].seq).how == "restored"
        assert verify(log).sound
    with replay.open(file.with_suffix(".projection-1.mcap")) as imagined:
        assert next(task for task in imagined.records(Task)).began_ns
        assert list(imagined.state_at("last").world("table").body("milk").position) == outcomes[0]["result"]
    for verb in ("info", "log", "tree", "state last", "blame milk", "diff 16 last"):
        name, *rest = verb.split()
        assert main([name, str(file), *rest]) == 0
        assert not capsys.readouterr().err


@pytest.mark.parametrize("file", MOTIONS, ids=lambda file: file.stem)
def test_motions_that_take_time_stay_readable(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(file) as log:
        start = log[0]
        assert isinstance(start, Run)
        assert (start.environment, start.seed, start.by_program) == ("continuous", "7", False)
        begun = [record.begin_trajectory for record in log.records(Mutation) if record.HasField("begin_trajectory")]
        assert [each.number for each in begun] == [1, 2, 3, 4, 5, 6]
        assert [each.search.planner for each in begun] == ["given", "RRT-Connect", *["given"] * 3, "straight line"]
        assert begun[1].trajectory.times[-1] == pytest.approx(2.882, abs=1e-3)
        (frame,) = log.records(Keyframe)
        assert [(each.begin.number, each.stopped) for each in frame.following] == [(2, 0)]
        within = log.state_at(frame.seq + 1).world("table").following
        assert [(each.begin.number, each.began) for each in within.values()] == [(2, 240)]
        (stop,) = (record for record in log.records(Mutation) if record.HasField("stop_trajectory"))
        assert log.state_at(stop.seq).world("table").following[6].stopped == stop.sim_step
        ended = [each for record in log.records(Mutation) for each in record.simulate.driven if each.ended]
        assert [each.number for each in ended] == [1, 2, 3, 4, 5, 6]
        assert [each.time < of.trajectory.times[-1] for each, of in zip(ended, begun, strict=True)] == [
            *[False] * 5,
            True,
        ]
        end = log.state_at("last").world("table")
        assert not end.following
        assert end.carrier("milk").carrier == "arm"
        statuses = {task.name: task.status for task in log.records(Task) if task.kind == "motion" and task.status}
        assert statuses == {"pick-up": Task.SUCCEEDED, "move-arm-joints": Task.CANCELLED}
        assert log.blame("arm.elbow_joint", "last").how == "driven"
    for verb in ("info", "log", "tree", "show 37", "state 150", "state last", "blame milk", "diff 37 last"):
        name, *rest = verb.split()
        assert main([name, str(file), *rest]) == 0
        assert not capsys.readouterr().err


def test_show_prints_a_trajectory_in_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(MOTIONS[0]), "37"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "step 37: mutation: begin trajectory 2: 6 joints of arm, 2.882 s, RRT-Connect after 2104 checks"
    assert sum("more; --json prints all" in line for line in lines) == 2, "of positions and velocities"
    assert len(lines) < 100
    assert any(line.lstrip().startswith("0.0, 0.042") for line in lines), "few numbers are all there"
    assert main(["show", str(MOTIONS[0]), "37", "--json"]) == 0
    trajectory = json.loads(capsys.readouterr().out)["begin_trajectory"]["trajectory"]
    assert len(trajectory["positions"]) == 6 * len(trajectory["times"])


@pytest.mark.slow
@pytest.mark.parametrize("file", MOTIONS, ids=lambda file: file.stem)
def test_motions_of_releases_are_verified(file: Path) -> None:
    with replay.open(file) as log:
        found = verify(log)
        assert found.sound
        assert found.keyframes == 1


@pytest.mark.parametrize("file", MOTIONS, ids=lambda file: file.stem)
def test_recordings_that_programs_began_stay_readable(file: Path) -> None:
    with replay.open(file.with_name(f"{file.stem}-program.mcap")) as log:
        start = log[0]
        assert isinstance(start, Run)
        assert (start.called_as, start.by_program) == ("tests/replay/golden/motions/program.py", True)
        assert verify(log).sound


def test_the_readme_shows_what_is_recorded_of_a_refusal(capsys: pytest.CaptureFixture[str]) -> None:
    shown = GUIDE.read_text().partition("$ pycram-replay log shop.mcap")[2].partition("```")[0].splitlines()[1:]
    main(["log", str(REASONS[0]), "--kind", "refusal"])
    main(["why", str(REASONS[0])])
    output = {re.sub(r"/\S*/plan.py", "plan.py", line) for line in capsys.readouterr().out.splitlines()}
    lines = [line for line in shown if line != "..." and not line.startswith("$ ")]
    assert len(lines) == 3
    assert set(lines) <= output


def without_wording(why: dict[str, Any]) -> dict[str, Any]:
    """An explanation's steps, causes and types."""

    def task(found: dict[str, Any] | None) -> list[Any] | None:
        return found and [found["kind"], found["name"], found["steps"], found["error"] and found["error"][0]]

    return {
        "outcome": why["outcome"],
        "step": why["step"],
        "failure": why["failure"] and why["failure"]["type"],
        "exceptions": [[error["type"], *(line["line"] for line in error["lines"])] for error in why["raised"]],
        "tasks": [task(each) for each in why["around"]],
        "line": why["line"] and why["line"]["line"],
        "callers": [line["line"] for line in why["callers"]],
        "bodies": [body["object"] for body in why["things"]],
        "attempts": [[*task(each), each["parameters"]] for each in why["tries"]],
        "other_failures": why["others"],
        "queries": [[query["step"], query["name"], query["answer"]] for query in why["asked"]],
        "since": [why[key] and task(why[key]["task"]) for key in ("same", "last")],
        "unfinished": [task(each) for each in why["running"]],
    }


@pytest.mark.parametrize("step", ["", "60"])
@pytest.mark.parametrize("file", DEMOS, ids=lambda file: file.stem)
def test_why_explains_the_demos_as_ever(file: Path, step: str, capsys: pytest.CaptureFixture[str]) -> None:
    wanted = EXPLANATIONS[file.stem].get(step)
    assert main(["why", str(file), *step.split(), "--json"]) == (0 if wanted else 2)
    output = capsys.readouterr().out
    assert (without_wording(json.loads(output)) if output else None) == wanted


@pytest.mark.slow
@pytest.mark.parametrize("file", DEMOS, ids=lambda file: file.stem)
def test_the_demos_of_releases_are_verified(file: Path) -> None:
    with replay.open(file) as log:
        found = verify(log)
        assert found.steps == len(log)
        assert found.changes == sum(1 for _ in log.records(Mutation))
    assert found.sound
