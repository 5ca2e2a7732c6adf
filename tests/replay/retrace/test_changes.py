"""A fork goes on with something set, with another answer or another seed: on record, and executed again as any run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Fluent, Mutation, Output, Query, Task
from replay.cli.main import main
from replay.compare import differing
from replay.errors import NoSuchName, ReplayError
from replay.restore.verify import verify
from replay.retrace.changes import parse_answer
from replay.retrace.decisions import BadChange
from replay.retrace.fork import fork
from replay.retrace.retrace import retrace
from tests.replay.retrace.bits import assert_same_bits
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from replay.recording import Recording
    from replay.retrace.fork import Fork

CABINET = Path(__file__).parents[1] / "golden" / "cabinet.urdf"
PLAN = f"""\
import random
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.fluent import Fluent
from pycram.language import par
world = BulletWorld(name="kitchen")
world.set_gravity([0, 0, -9.8])
floor = Object("floor", "environment", "plane.urdf")
cabinet = Object("cabinet", "environment", {str(CABINET)!r}, [3, 0, 1])
milk = Object("milk", "milk", "milk.stl", [0, 0, 0.2])
cup = Object("cup", "cup", "cup.stl", [1, 0, 0.1])
world.settle()
battery = Fluent(50, name="battery")
battery.set_value(40)
busy = Fluent(0, name="left.busy")
world.get_manipulation_event().__iadd__(lambda *_: print("somebody moved the furniture"))
with world.lock:
    print("here")
    cup.set_color([1, 0, 0, 1])
print([round(each, 9) for each in milk.get_position()[:2]], cabinet.get_joint_position("drawer_joint"), battery.get_value(), busy.get_value())
print([bool(btr.contact(milk, each)) for each in (cup, floor, cup)])
print(btr.blocking.__name__, btr.stable(milk), btr.supporting(floor, milk).evidence["touches"] > 0)
print(btr.reachable_poses.__name__, btr.occluding(milk, [-1, 0, 0.1]))
for number in range(3):
    par(lambda: print("one"), lambda: print("two"), lambda: print("three"))
cup.set_position([random.random(), 2, 1])
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    file = tmp_path_factory.mktemp("changes") / "plan.py"
    file.write_text(PLAN)
    with replay.open(record(file)) as recording:
        assert recording[len(recording) - 1].succeeded
        yield recording


def here(log: Recording) -> int:
    return next(each.seq for each in log.records(Output) if each.text == "here")


def printed(log: Recording) -> list[str]:
    return [each.text for each in log.records(Output, here(log) + 1)]


def forked(log: Recording, file: Path, **changes: object) -> Fork:
    return fork(log, here(log), file, **changes)  # type: ignore[arg-type]


def assert_runs_again(file: Path) -> None:
    """The recording is consistent, its changes have their effects again, and its plan does the same again."""
    with replay.open(file) as recording:
        assert verify(recording).exact
        again = retrace(recording)
        assert again.difference is None
        assert again.equal == len(recording)


@pytest.mark.costly
@pytest.mark.slow
def test_what_is_set_the_plan_finds(log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "set.mcap"
    settings = (
        *("milk.position=0,1,0.9", "'cabinet'.drawer_joint=0.2", "battery=20", "milk.orientation=0,0,1,0"),
        "fluent:left.busy=1",  # no record has it before
    )
    given = [word for text in settings for word in ("--set", text)]
    assert main(["fork", str(log.path), "--at", str(here(log)), "-o", str(file), *given, "--control"]) == 0
    said = capsys.readouterr().out
    assert f"{len(log)} records again" in said
    with replay.open(file) as other:
        # the colour is set while the plan holds the world's lock: what is under way is done first
        assert all(not differing(log[step], other[step]) for step in range(here(log) + 2))
        made = [each for each in other if getattr(each, "by_fork", False)]
        assert [each.WhichOneof("command") for each in made if isinstance(each, Mutation)] == [
            "move_body",
            "move_joints",
            "move_body",
        ]
        assert made[0].seq == here(log) + 2
        assert [each.after_json for each in made if isinstance(each, Fluent)] == ["20", "1"]
        assert not any(each.source_file for each in made)
        assert [change.set for change in other[0].origin.changes] == [*settings]
        assert "[0.0, 1.0] 0.2 20 1" in printed(other)
        assert printed(other).count("somebody moved the furniture") == 1
    assert_runs_again(file)
    assert main(["blame", str(file), "milk", "--at", str(here(log) + 3)]) == 0
    said = capsys.readouterr().out
    assert "by the fork" in said
    assert "by the plan itself" not in said.partition("Before that")[0]
    assert main(["info", str(file)]) == 0
    assert f"after step {here(log)}, with milk.position=0,1,0.9, 'cabinet'" in capsys.readouterr().out
    assert main(["diff", str(log.path), str(file)]) == 1
    said = capsys.readouterr().out
    assert f"second step {here(log) + 2}: move body milk [0.000, 1.000, 0.900], by the fork" in said


@pytest.mark.costly
def test_a_fork_of_a_fork_keeps_what_was_changed_before(log: Recording, tmp_path: Path) -> None:
    first, same, other = (tmp_path / f"{name}.mcap" for name in ("first", "same", "other"))
    forked(log, first, settings=["battery=20"])
    with replay.open(first) as parent:
        fork(parent, 3, same)
        fork(parent, here(parent) + 5, other, settings=["battery=10"])
    assert_same_bits(first, same)
    with replay.open(other) as recording:
        set_to = [each.after_json for each in recording.records(Fluent) if each.by_fork]
        assert set_to == ["20", "10"]
        assert [change.step for change in recording[0].origin.changes] == [here(log), here(log) + 5]


@pytest.mark.costly
def test_an_answer_is_given_to_the_next_query_that_fits(
    log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "answers.mcap"
    given = ("contact(milk, object2=cup)=true", "stable(...)=false", "occluding(milk, ...)=[cup]", "visible(cup)=true")
    result = forked(log, file, answers=given)
    assert result.notes[-1].startswith("1 of the 4 given answers weren't used: ")
    with replay.open(file) as other:
        assert "[True, True, False]" in printed(other)  # the next one, not those after it
        assert "blocking False True" in printed(other)
        assert "reachable_poses [Object('cup', 'cup')]" in printed(other)
        made = [each for each in other.records(Query) if each.by_fork]
        assert [(each.name, each.own_answer_json) for each in made] == [
            ("contact", "false"),
            ("stable", "true"),
            ("occluding", '[{"object":"floor","world":"kitchen"}]'),
        ]
        assert made[1].evidence  # of the query's own answer
        again = fork(other, here(log), tmp_path / "again.mcap")
        assert again.notes[-1] == result.notes[-1]  # a fork of that fork, which changes nothing more
    assert_runs_again(file)
    assert main(["log", str(file)]) == 0
    assert "stable(object=milk): no, set by the fork (own answer: yes)" in capsys.readouterr().out


@pytest.mark.costly
def test_another_seed_takes_another_order_from_the_step_on(log: Recording, tmp_path: Path) -> None:
    outputs = set()
    for seed in (7, 8):
        file = tmp_path / f"{seed}.mcap"
        forked(log, file, seed=seed)
        with replay.open(file) as other:
            assert all(not differing(log[step], other[step]) for step in range(here(log) + 1))
            place = [each.move_body.position[0] for each in other.records(Mutation) if each.HasField("move_body")]
            outputs.add((*printed(other), *place))
    assert len(outputs) == 2
    assert tuple(printed(log)) not in {each[: len(printed(log))] for each in outputs}
    assert_runs_again(tmp_path / "8.mcap")


@pytest.mark.costly
def test_what_only_the_setter_knows_ends_the_fork(log: Recording, tmp_path: Path) -> None:
    for changes, said in (
        ({"settings": ["cabinet.drawer_joint=9"]}, "drawer_joint"),
        ({"settings": ["hunger=1"]}, "there is no fluent hunger at that moment; the plan has battery"),
        ({"answers": ["occluding(milk)=[soap]"]}, "soap"),
    ):
        with pytest.raises(ReplayError, match=said):
            forked(log, tmp_path / "on.mcap", **changes)
        assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "kind", "said"),
    [
        ({"settings": ["milc.position=0,0,1"]}, NoSuchName, "'milc'; did you mean milk"),
        ({"settings": ["cabinet.drawer=1"]}, NoSuchName, "did you mean drawer_joint"),
        ({"settings": ["milk.position=0,1"]}, BadChange, "expected OBJECT.position=X,Y,Z"),
        ({"settings": ["milk.position=0,1,nan"]}, BadChange, "expected OBJECT.position=X,Y,Z"),
        ({"settings": ["battery"]}, BadChange, "FLUENT=VALUE"),
        ({"settings": ["milk.position=0,0,1"], "world": "garden"}, NoSuchName, "garden"),
        ({"settings": ["battery=1"], "world": "garden"}, NoSuchName, "garden"),
        ({"settings": ["robot.position=0,0,1"]}, BadChange, "has no robot at step"),
        ({"answers": ["stabel(milk)=false"]}, NoSuchName, "did you mean stable"),
        ({"answers": ["stable(milk)=[cup]"]}, BadChange, "its answer is true or false"),
        ({"answers": ["occluding(milk)=true"]}, BadChange, r"a list of objects, such as \[milk, bowl\]"),
        ({"answers": ["stable(milk, who=cup)=true"]}, BadChange, "who"),
        ({"answers": ["stable(mlik)=false"]}, NoSuchName, "no object 'mlik'; did you mean milk"),
        (
            {"answers": ["stable('milk carton')=false"]},
            NoSuchName,
            "no object 'milk carton'; there are cabinet, cup, floor, milk",
        ),
        ({"answers": ["occluding(milk)=[cop]"]}, NoSuchName, "did you mean cup"),
        ({"answers": ["visible(milk, camera)=true"]}, NoSuchName, "no camera 'camera'"),
        ({"settings": ["'milc'.position=0,0,1"]}, NoSuchName, "'milc'; did you mean milk"),
        ({"answers": ["stable(milk)"]}, BadChange, r"expected QUERY\(ARGUMENTS\)=ANSWER"),
        ({"seed": -1}, BadChange, "a whole number from 0 to"),
    ],
)
def test_what_cant_be_changed_is_said_before_it_runs(
    log: Recording, tmp_path: Path, changes: dict[str, object], kind: type[ReplayError], said: str
) -> None:
    with pytest.raises(kind, match=said):
        forked(log, tmp_path / "on.mcap", **changes)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_nothing_comes_after_the_last_step(log: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["fork", str(log.path), "--at", "last", "--set", "battery=1", "-o", str(tmp_path / "on.mcap")]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "is the last step" in said
    assert "runs again" not in said


def test_arguments_of_a_query_count_as_far_as_they_are_given() -> None:
    assert parse_answer("stable(...)=true").arguments == {}
    assert parse_answer("stable()=true").arguments == {}
    given = parse_answer("reachable_object(milk, gripper=left, ...)=false").arguments
    assert list(given) == ["object", "gripper"]


@pytest.mark.costly
def test_a_control_that_comes_out_differently_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.py"
    file.write_text(
        "import time\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        "world = BulletWorld()\n"
        'milk = Object("milk", "milk", "milk.stl")\n'
        "milk.set_position([0, 0, time.time() % 1000])\n"
    )
    path = str(record(file))
    assert main(["fork", path, "--at", "2", "--set", "milk.position=1,0,0", "--control", "--json"]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert facts["succeeded"]
    assert not facts["control"]["identical"]
    assert facts["control"]["difference"]["line"] == f"{file}:5"


@pytest.mark.parametrize("nested", [lambda outcome: outcome, lambda outcome: [outcome, {"best": outcome}]])
def test_where_projections_are_recorded_is_no_difference_wherever_a_task_returns_them(
    nested: Callable[[dict[str, object]], object],
) -> None:
    def returns(file: str, **more: object) -> Task:
        outcome = {"succeeded": True, "duration": 0.2, "recording": file, **more}
        return Task(kind="function", name="think", result_json=json.dumps(nested(outcome)))

    assert not differing(returns("a.projection-1.mcap"), returns("b.projection-1.mcap"))
    assert differing(returns("a.mcap", result=1), returns("a.mcap", result=2))
    assert differing(*(Task(result_json=json.dumps({"recording": each})) for each in "ab")), "the plan's own"
