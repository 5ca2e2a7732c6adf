"""Recordings in the viewer: it shows the recorded values, at every step and on all time lines."""

from __future__ import annotations

import json
import math
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import InCollision, PlanFailure
from pycram.language import par, seq
from pycram.process_module import ProcessModule
from recorder import geometry
from recorder.records import Argument, Mutation, Query, Task, to_json
from recorder.tracing.span import Span
from recorder.viewer import queries
from replay.cli.main import main
from tests.recorder.viewer.conftest import PATIENT, rows_of
from tests.recorder.viewer.pictures import LIKENESS, MOMENTS, ROBOT, WORLD, correlation, golden, robot_pixels, structure
from tests.recorder.viewer.shown import Shown, in_world, looked_for, small, view

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.recorder.viewer.conftest import Headless, Server

REPO = Path(__file__).parents[3]
NEAR = 1e-5  # m; the viewer's numbers are 32 bits


@pytest.fixture(scope="module")
def demo(recorded_demo: Callable[[str], Path]) -> Path:
    return recorded_demo("set_the_table")


@pytest.fixture(scope="module")
def shown(demo: Path) -> Shown:
    return view(demo, demo.with_suffix(".rrd"))


@pytest.mark.costly
def test_every_link_has_its_recorded_pose(demo: Path, shown: Shown) -> None:
    with replay.open(demo) as log:
        for step in [*range(12, len(log) - 3, 29), len(log) - 3]:
            state, frames = log.state_at(step), shown.frames(step)
            for body in state.world().bodies.values():
                for link in state.urdf(body).links:
                    name = body.name if link == state.urdf(body).root else f"{body.name}/{link}"
                    position, orientation = in_world(frames, name)
                    true_position, true_orientation = state.link_pose(body, link)
                    assert math.dist(position, true_position) < NEAR, f"step {step}: {name}"
                    assert geometry.angle(orientation, true_orientation) < 1e-3, f"step {step}: {name}"


@pytest.mark.slow
def test_every_record_has_its_rows(demo: Path, shown: Shown) -> None:
    counts = shown.counts()
    with replay.open(demo) as log:
        for kind, count in log.counts().items():
            assert counts[f"/records/{kind}", f"pycram.{kind.capitalize()}:text"] == count
            lines = count - sum(record.phase == record.ASKED for record in log if kind == "task" and is_task(record))
            assert counts[f"/log/{kind}", "TextLog:text"] == lines
        pictures = sum(record.HasField("picture") for record in log.records(Query))
    assert counts["/queries/picture", "SegmentationImage:buffer"] == pictures > 0
    assert {entity for entity, _ in counts} >= {"/world_1/attachments/pr2/l_gripper_tool_frame/milk"}
    for link in ("base_link", "torso_lift_link", "l_gripper_palm_link"):
        assert shown.at(f"/world_1/bodies/pr2/{link}/mesh_0", 20)["Asset3D:blob"]


def is_task(record: object) -> bool:
    return type(record).__name__ == "Task"


@pytest.mark.costly
@pytest.mark.slow
def test_live_and_afterwards_show_the_same(
    tmp_path: Path, serve: Callable[[], Server], until: Callable[..., None]
) -> None:
    server, log, file = serve(), tmp_path / "live.mcap", tmp_path / "afterwards.rrd"
    demo = f"{PATIENT}\nimport sys\nfrom pycram.cli import main\nsys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", demo, "demo", "--log", str(log), f"--rerun=connect:{server.url}"]
    subprocess.run(command, check=True, capture_output=True, cwd=REPO)
    afterwards = view(log, file)
    rows = rows_of(file)
    until(lambda: server.rows() == rows, "all is there")
    server.finish()
    live = Shown(server.file)
    assert live.counts() == afterwards.counts()
    assert without_start(live.fixed) == without_start(afterwards.fixed)
    assert {entity: [at for at, _ in rows] for entity, rows in live.rows.items()} == {
        entity: [at for at, _ in rows] for entity, rows in afterwards.rows.items()
    }


def without_start(fixed: dict[str, dict[str, object]]) -> dict[tuple[str, str], object]:
    """What holds at all times, but for when the viewer first got it."""
    values_by_entity = {(entity, name): value for entity, values in fixed.items() for name, value in values.items()}
    return {key: value for key, value in values_by_entity.items() if key[1] != "RecordingInfo:start_time"}


def test_added_and_removed_bodies_appear_and_disappear(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="kitchen") as world:
        world.set_gravity([0, 0, -9.8])
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        bowl = Object("bowl", "bowl", "bowl.stl", [1, 0, 1], color=[1, 0, 0, 1])
        bowl.attach(cup)
        bowl.set_position([2, 0, 1])
        bowl.set_color([0, 1, 0, 1])
        bowl.detach(cup)
        cup.remove()
        Object("cup", "cup", "cup.stl", [5, 0, 1])
        world.simulate(0.1)
    shown = view(log, tmp_path / "log.rrd")
    with replay.open(log) as recording:
        did = {record.WhichOneof("command"): record.seq for record in recording.records(Mutation)}
        first = next(r.seq for r in recording.records(Mutation) if r.load_body.body == "cup")
    cup_shape = next(entity for entity in shown.rows if entity.startswith("/kitchen/bodies/cup/") and "mesh" in entity)
    bowl_shape = next(
        entity for entity in shown.rows if entity.startswith("/kitchen/bodies/bowl/") and "mesh" in entity
    )
    attachment = "/kitchen/attachments/bowl/bowl/cup"
    assert not shown.at(cup_shape, first - 1)
    assert shown.at(cup_shape, first)["Asset3D:blob"]
    assert not shown.at(cup_shape, did["remove_body"])
    assert shown.at(cup_shape, did["load_body"])["Asset3D:blob"], "it was loaded again"
    assert in_world(shown.frames(did["load_body"]), "kitchen//cup")[0] == (5, 0, 1)
    assert math.dist(in_world(shown.frames(did["detach_body"]), "kitchen//cup")[0], (1, 0, 1)) < NEAR
    assert shown.at(bowl_shape, did["set_color"] - 1)["Asset3D:albedo_factor"] == [0xFF0000FF]
    assert shown.at(bowl_shape, did["set_color"])["Asset3D:albedo_factor"] == [0x00FF00FF]
    assert not shown.at(attachment, did["attach_body"] - 1)
    assert shown.at(attachment, did["attach_body"])["LineStrips3D:labels"] == ["holds cup"]
    assert not shown.at(attachment, did["detach_body"])
    falls = [moment for moment, _ in shown.rows["/kitchen/bodies/cup"] if moment[0] == did["simulate"]]
    assert len(falls) >= 3, "a fall is seen while it happens"
    assert [line[1] for line in falls] == sorted({line[1] for line in falls})
    assert [line[2] for line in falls] == sorted({line[2] for line in falls})
    assert falls[-1][1] == 100_000_000


def fail() -> None:
    raise PlanFailure("too heavy")


def test_lanes_show_how_tasks_ended(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log, name="lift"), BulletWorld(name="w"):
        failures: list[BaseException] = []
        with seq, par(failures) as block:
            block(list)
            block(fail)
    shown = view(log, tmp_path / "log.rrd")
    lanes = {entity.rpartition("/")[2]: rows for entity, rows in shown.rows.items() if entity.startswith("/level/")}
    assert set(lanes) >= {"1", "2", "3"}
    last = max(step for rows in lanes.values() for (step, *_), _ in rows)
    states = {
        lane: [now for step in range(last) if (now := shown.at(f"/level/{lane}", step).get("StateChange:state"))]
        for lane in lanes
    }
    assert ["seq succeeded"] in states["1"]
    assert ["par failed"] in states["2"]
    branches = [state for lane, labels in states.items() if lane.startswith("3") for state in labels]
    assert ["list succeeded"] in branches
    assert ["fail failed"] in branches
    assert not any(state for lane in lanes if (state := shown.at(f"/level/{lane}", last)["StateChange:state"][0]))
    graph = [values["GraphNodes:labels"] for _, values in shown.rows["/tasks/graph"]]
    assert any("fail \u2717" in labels for labels in graph)
    assert all(labels[0] == "lift" for labels in graph)
    failed = [(at, values["TextLog:text"]) for at, values in shown.rows["/w/failures"] if "TextLog:text" in values]
    _, lines = failed[0]
    assert lines == ["fail: PlanFailure: too heavy"]
    red_lines = [
        (values["TextLog:level"] == ["ERROR"], bool(values["TextLog:color"])) for _, values in shown.rows["/log/task"]
    ]
    assert {*red_lines} == {(True, True), (False, False)}, "failures, and nothing else"


PLAN = """\
from pycram.bullet_world import BulletWorld, Object
from recorder.tracing.span import Span

def shove(cup):
    cup.set_position([1, 0, 1])

with BulletWorld(name="w"):
    cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
    with Span("task", "tidy"):
        shove(cup)
    with Span("task", "paint"): cup.set_color([1, 0, 0, 1])
"""


def test_tables_have_call_sites_and_callers(tmp_path: Path) -> None:
    log, plan = tmp_path / "log.mcap", tmp_path / "plan.py"
    plan.write_text(PLAN)
    with recorder.record(log, source=plan):
        runpy.run_path(str(plan))
    rows = view(log, tmp_path / "log.rrd").rows
    sources = {}
    for kind, what in (("Mutation", "command"), ("Task", "status")):
        for _, values in rows[f"/records/{kind.lower()}"]:
            names = (what, "source", "callers")
            key, source, callers = (values[f"pycram.{kind}:{name}"][0] for name in names)
            of_plan = [line for line in callers.split(", ") if line.startswith("plan.py")]  # else it's this test
            sources[key] = source, of_plan
    assert sources["load_body"] == ("plan.py:8", [])
    assert sources["move_body"] == ("plan.py:5", ["plan.py:10"])
    assert sources["set_color"] == ("plan.py:11", []), "where its task was asked for"
    assert sources["running"] == sources["succeeded"] == ("plan.py:11", [])


def test_a_failure_that_is_repeated_is_marked_again(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w"):
        for _ in range(2):
            with pytest.raises(PlanFailure), Span("task", "lift"), Span("task", "grasp"):
                fail()
    shown = view(log, tmp_path / "log.rrd")
    rows = shown.rows["/w/failures"]
    failed = [values["TextLog:text"][0] for _, values in rows if "TextLog:text" in values]
    assert failed == ["grasp: PlanFailure: too heavy"] * 2


def test_the_log_shows_failures_of_worlds_of_any_name(tmp_path: Path) -> None:
    log, file = tmp_path / "log.mcap", tmp_path / "log.rrd"
    with recorder.record(log):
        for name in ("my kitchen", "a/b", "$origin"):
            with BulletWorld(name=name), pytest.raises(PlanFailure), Span("task", "lift"):
                fail()
    failures = {entity for entity in view(log, file).rows if entity.endswith("/failures")}
    assert len(failures) == 3
    assert failures <= looked_for(file)


def test_simultaneous_motions_of_one_name_have_targets_of_their_own(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w"):
        left, right = (Span("motion", "moving-tcp", parameters={"target": [y, 0.0, 1.0]}) for y in (1.0, 2.0))
        for span in (left, right):
            span.start()
        left.finish()
        middle = Span("motion", "moving-tcp", parameters={"target": [3.0, 0.0, 1.0]})
        middle.start()
        for span in (middle, right):
            span.finish()
    shown = view(log, tmp_path / "log.rrd")
    with replay.open(log) as recording:
        steps = [record.seq for record in recording.records(Task)]
    targets = [entity for entity in shown.rows if entity.startswith("/w/targets/")]
    standing = [
        {now["Points3D:positions"][0][0] for entity in targets if (now := shown.at(entity, step))} for step in steps
    ]
    assert standing == [{1}, {1, 2}, {2}, {2, 3}, {2}, set()]
    assert len(targets) == 2, "names come again"


def test_a_query_has_a_page_a_picture_and_marks(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w"):
        cup = Object("cup", "cup", "cup.stl", [2, 0, 1])
        milk = Object("milk", "milk", "milk.stl", [1.5, 0.03, 1])
        verdict = btr.visible(cup, [0, 0, 1])
        seen, whole = verdict.evidence["pixels_seen"], verdict.evidence["pixels_alone"]
        btr.contact(cup, milk)
    shown = view(log, tmp_path / "log.rrd")
    (image,) = [values for _, values in shown.rows["/queries/picture"]]
    names = {each["class_id"]: each["class_description"]["info"]["label"] for each in context(shown)}
    pixels = np.array(image["SegmentationImage:buffer"][0], dtype=np.uint8).view(np.uint16)
    shares = {names[number]: int((pixels == number).sum()) for number in np.unique(pixels)}
    assert shares["cup"] == seen
    assert shares["milk"] >= whole - seen > 0
    with replay.open(log) as recording:
        asked, later = [record.seq for record in recording.records(Query)]
    target = shown.at("/w/answers/visible/target", asked)
    assert math.dist(target["Points3D:positions"][0], (2, 0, 1)) < NEAR
    assert shown.at("/w/answers/visible/hidden_by", asked)["Points3D:labels"] == ["milk hides it"]
    assert not shown.at("/w/answers/visible/target", later), "marks stand until the next query"
    assert "visible(object=cup" in shown.at("/queries/page", asked)["TextDocument:text"][0]


STICK = """<robot name="stick"><link name="foot"/><link name="eye"/><joint name="neck" type="fixed">
<parent link="foot"/><child link="eye"/><origin xyz="0 0 1" rpy="-1.5708 0 -1.5708"/></joint></robot>"""


def test_a_line_of_sight_begins_at_the_camera_of_the_robot_in_the_query(tmp_path: Path) -> None:
    log, model = tmp_path / "log.mcap", tmp_path / "stick.urdf"
    model.write_text(STICK)
    with recorder.record(log), BulletWorld(name="w") as world:
        far, near = (Object(f"robot {x}", "robot", model, [x, 0, 0]) for x in (0, 5))
        cup = Object("cup", "cup", "cup.stl", [7, 0, 1])
        world.robot = near
        assert btr.visible(cup, "eye").evidence == btr.visible(cup, "eye", robot=near).evidence
        btr.visible(cup, "eye", robot=far)
    shown = view(log, tmp_path / "log.rrd")
    with replay.open(log) as recording:
        asked = [record.seq for record in recording.records(Query)]
        for step in asked:
            assert recording.ask(step).answer == json.loads(recording[step].answer_json)
    positions = [shown.at("/w/answers/visible/sight", step)["LineStrips3D:strips"][0][0] for step in asked]
    assert [position[0] for position in positions] == [5, 5, 0]


def test_a_failure_without_a_place_is_marked_at_its_robot(tmp_path: Path) -> None:
    log, model = tmp_path / "log.mcap", tmp_path / "stick.urdf"
    model.write_text(STICK)
    with recorder.record(log), BulletWorld(name="w") as world:
        robots = [Object(f"robot {x}", "robot", model, [x, 0, 0]) for x in (0, 5)]
        for robot in reversed(robots):
            world.robot = robot
            with pytest.raises(PlanFailure), Span("motion", "lift"):
                fail()
    shown = view(log, tmp_path / "log.rrd")
    with replay.open(log) as recording:
        ends = [record.seq for record in recording.records(Task) if record.phase == record.FINISHED]
    assert [shown.at("/w/failures", step)["Points3D:positions"][0][0] for step in ends] == [5, 0]


def test_names_with_bars_keep_the_table_of_a_query(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w"):
        cup = Object("cup", "cup", "cup.stl", [2, 0, 1])
        Object("milk|2", "milk", "milk.stl", [1.5, 0.03, 1])
        btr.visible(cup, [0, 0, 1])
    page = view(log, tmp_path / "log.rrd").rows["/queries/page"][0][1]["TextDocument:text"][0]
    row = next(line for line in page.splitlines() if "hidden_by" in line)
    assert "milk" in row
    assert row.replace("\\|", "").count("|") == 3


def test_a_stranger_s_query_names_no_picture_that_the_viewer_would_fetch() -> None:
    """Its page is Markdown."""
    fetching = (
        "![seen](http://127.0.0.1:9/x.png) \\<img src='http://127.0.0.1:9/y.png'> ![1]\n[1]: http://127.0.0.1:9/z"
    )
    evidence = [Argument(name=fetching, json=to_json(fetching))]
    page = queries._page(Query(name=fetching, world=fetching, answer_json=to_json(fetching), evidence=evidence))
    assert page.count("127.0.0.1:9/x.png") == 5
    assert not re.search(r"(?<!\\)(\\\\)*(!\[|\]\(|\]\[|<)", page)
    assert not re.search(r"^\[1\]:", page, re.MULTILINE)


def context(shown: Shown) -> list[dict]:
    return shown.fixed["/queries/picture"]["AnnotationContext:context"][0]


def test_names_may_contain_the_characters_of_paths(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="my kitchen/2"):
        Object("cup of/tea", "cup", "cup.stl", [0, 0, 1])
        Object("cup", "cup", "cup.stl", [1, 0, 1])
    shown = view(log, tmp_path / "log.rrd")
    bodies = {entity for entity in shown.rows if "/bodies/" in entity and "mesh" in entity}
    assert len(bodies) == 2 * len({entity.rpartition("/")[2] for entity in bodies})


def test_ambiguous_names_have_entities_of_their_own(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="world_1"):
        Object("world", "cup", "cup.stl", [1, 0, 1])
        Object("w", "cup", "cup.stl", [2, 0, 1])
        with BulletWorld(name="w"):
            Object("cup", "cup", "cup.stl", [3, 0, 1])
            Object("w/cup", "cup", "cup.stl", [4, 0, 1])
    frames = view(log, tmp_path / "log.rrd").frames(20)
    assert "world" not in frames
    assert sorted(pose[0][0] for parent, pose in frames.values() if parent == "world") == [1, 2, 3, 4]


def test_two_recordings_side_by_side(tmp_path: Path) -> None:
    left, right = small(tmp_path / "left.mcap"), small(tmp_path / "right.mcap", 3.0)
    file = tmp_path / "both.rrd"
    assert main(["view", str(left), str(right), "--save", str(file)]) == 0
    frames = Shown(file).frames(10)
    assert in_world(frames, "left/w//cup", "left/world")[0] == (0, 0, 1)
    assert in_world(frames, "right/w//cup", "right/world")[0] == (3, 0, 1)


@pytest.mark.costly
@pytest.mark.slow
def test_the_viewer_shows_the_demo(
    demo: Path, tmp_path: Path, headless: Headless, capsys: pytest.CaptureFixture[str], until: Callable[..., None]
) -> None:
    assert main(["view", str(demo), "--at", "36", "--connect", headless.url, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["viewer"] == headless.url
    until(headless.has_loaded, "it is loaded")
    state = headless.state()
    names = {view.name for view in state.views}
    assert names >= {WORLD, "Tasks over time", "Task tree", "Query", "What it saw", "Log", "Heights", "Joints"}
    assert names >= {"task", "mutation", "event", "fluent", "query"}
    with replay.open(demo) as log:
        steps = {name: log.step(f"task:{name}") for name in MOMENTS}
    goldens = {name: golden(name) for name in MOMENTS}
    for name, step in steps.items():
        headless.go_to(step)

        def seen(name: str = name, step: int = step) -> bool:
            scene = headless.picture(tmp_path / f"{step}.png", WORLD)
            likeness = {moment: correlation(structure(scene), picture) for moment, picture in goldens.items()}
            nearest = max(likeness, key=lambda moment: likeness[moment])
            return nearest == name and likeness[name] > LIKENESS and robot_pixels(scene) > ROBOT

        until(seen, f"{name}, step {step}, looks like its golden picture")
    assert not headless.complaints()


@pytest.mark.slow
def test_a_collision_marks_the_links_that_would_meet(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w") as world:
        Object("floor", "environment", "plane.urdf")
        Object("kitchen", "environment", "kitchen.urdf")
        world.robot = Object("pr2", "robot", "pr2.urdf", [-1, 3, 0])
        with pytest.raises(InCollision) as raised:
            ProcessModule.perform(MotionDesignator([("type", "moving"), ("target", [1.2, 0.7, 0])]))
        pair = raised.value.pairs[0]
        ends = ((world.robot, pair.link), (world.get_object("kitchen"), pair.body_link))
        places = [body.get_link_position(link) for body, link in ends]
        with Span("task", "go on"):
            pass
    shown = view(log, tmp_path / "log.rrd")
    (mark,) = [entity for entity in shown.rows if entity.endswith("/pairs/1")]
    step = next(moment[0] for moment, values in shown.rows[mark] if "Points3D:positions" in values)
    now = shown.at(mark, step)
    assert now["Points3D:labels"] == [pair.link, pair.body_link]
    for found, expected in zip(now["Points3D:positions"], places, strict=True):
        assert found == pytest.approx(expected, abs=1e-5)
    assert now["LineStrips3D:strips"]
    assert not shown.at(mark, step + 100), "cleared when the next task begins"
