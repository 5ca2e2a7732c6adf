"""A failure at first sight: its view, wrong beliefs, waits, curves, what the camera saw, and where a fork parts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest
from rerun.chunk import RrdReader

import recorder
import replay
from pycram import bullet_world_reasoning as btr, monitored, perform
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.knowledge import learn
from pycram.motion_designators import pick_up
from recorder.records import Query
from recorder.viewer.rerun_stream import YELLOW, up_to
from replay.cli.main import main
from tests.recorder.viewer.shown import Shown

if TYPE_CHECKING:
    from pathlib import Path

WATCHED = "always milk.z > 0.5 m"
SEEN, MOVED = (1.3, 0.75, 1.0), (1.3, 3.0, 0.9)


def run() -> None:
    """Move the milk away from its believed position, wait until a timeout, and fail to reach the milk."""
    door, battery = Fluent(name="door"), Fluent(80, name="battery")
    with BulletWorld(name="w") as world:
        milk = Object("milk", "milk", "milk.stl", SEEN, color=[1, 0, 0, 1])
        world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
        with monitored(WATCHED, only_record=True):
            learn({milk: milk.get_position_and_orientation()})
            btr.visible(milk, [0.5, 0.75, 1.0])
            milk.set_position([1.3, 3.0, 0.4])
            milk.set_position(MOVED)
            battery.set_value(60)
            battery.set_value(30)
            assert not door.wait_for(timeout=0.01)
            perform(pick_up(object=milk, arm="left"))


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("failed") / "failed.mcap"
    with pytest.raises(PlanFailure), recorder.record(log):
        run()
    return log


@pytest.fixture(scope="module")
def shown(failed: Path) -> Shown:
    file = failed.with_suffix(".rrd")
    assert main(["view", str(failed), "--at", "failure", "--save", str(file)]) == 0
    return Shown(file)


def _sent(table: Any) -> int:
    return max(table.column("log_time").cast("int64").to_pylist()) if "log_time" in table.schema.names else 0


def layout(file: Path) -> dict[str, Any]:
    """The last value of each property of any view or panel in the layout that was sent last."""
    reader = RrdReader(file)
    layouts = [[chunk.to_record_batch() for chunk in reader.stream(store=each)] for each in reader.blueprints()]
    tables = max(layouts, key=lambda rows: max(map(_sent, rows)))
    found = {}
    for table in tables:
        found |= {name: table.column(name).to_pylist()[-1] for name in table.schema.names if ":" in name}
    return found


def test_the_view_opens_at_the_step_and_looks_at_the_failure(failed: Path, shown: Shown) -> None:
    with replay.open(failed) as log:
        step = log.why().step
    opened = layout(failed.with_suffix(".rrd"))
    assert opened["TimePanelBlueprint:timeline"] == [up_to(step)]
    lines: dict[str, int] = {}
    for chunk in RrdReader(failed.with_suffix(".rrd")).stream():
        table = chunk.to_record_batch()
        for name in {up_to(step), "step number"} & {*table.schema.names}:
            lines[name] = max(lines.get(name, 0), *table.column(name).cast("int64").to_pylist())
    assert lines[up_to(step)] == step < lines["step number"]
    target, eye = opened["EyeControls3D:look_target"][0], opened["EyeControls3D:position"][0]
    assert math.dist(target[:2], (1.0, 1.9)) < 0.3, "between the robot and the milk"
    assert math.dist(eye, target) < 6
    (label,) = shown.at("/w/failures", step)["Points3D:labels"]
    assert label.startswith("PickUp: left arm can't reach")


def test_a_wrong_belief_is_a_ghost(shown: Shown, failed: Path) -> None:
    ghosts = [entity for entity in shown.rows if entity.startswith("/w/beliefs/pr2/milk/")]
    with replay.open(failed) as log:
        learned = next(record.seq for record in log.records(Query) if record.name == "seen")
        step = log.why().step
    assert ghosts
    assert not any(shown.at(ghost, learned) for ghost in ghosts), "a right belief has none"
    (mesh,) = [now for ghost in ghosts if (now := shown.at(ghost, step))]
    assert mesh["InstancePoses3D:translations"][0] == pytest.approx(SEEN, abs=0.1)
    assert mesh["Asset3D:albedo_factor"][0] & 0xFF < 200, "translucent"


def test_a_wait_that_timed_out_is_neither_green_nor_succeeded(
    shown: Shown, failed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    states = shown.fixed["/level/1"]
    colors = dict(zip(states["StateConfiguration:values"], states["StateConfiguration:colors"], strict=True))
    red, green, blue = YELLOW
    assert colors["door timed out"] >> 8 == (red << 16) + (green << 8) + blue
    graphs = [values["GraphNodes:labels"] for _, values in shown.rows["/tasks/graph"]]
    assert "door timed out" in graphs[-1]
    assert main(["log", str(failed)]) == 0
    printed = capsys.readouterr().out
    assert "wait door timed out after" in printed
    assert "wait door succeeded" not in printed


def test_fluents_and_properties_are_curves(shown: Shown) -> None:
    fluent = [values["Scalars:scalars"][0] for _, values in shown.rows["/plots/fluents/battery"]]
    assert fluent == [80, 60, 30]
    (entity,) = [each for each in shown.rows if each.startswith("/plots/properties/")]
    margins = [values["Scalars:scalars"][0] for _, values in shown.rows[entity]]
    assert margins == pytest.approx([SEEN[2] - 0.5, -0.1, MOVED[2] - 0.5])
    assert shown.fixed[entity]["SeriesLines:names"] == [WATCHED]


def test_what_it_saw_has_the_colours_of_the_scene_and_a_legend(shown: Shown, failed: Path) -> None:
    (classes,) = shown.fixed["/queries/picture"]["AnnotationContext:context"]
    milk = next(each["class_description"]["info"] for each in classes if "milk" in str(each))
    assert milk["color"] >> 8 == 0xFF0000
    with replay.open(failed) as log:
        asked = next(record.seq for record in log.records(Query) if record.name == "visible")
    assert shown.at("/queries/picture/names", asked)["Points2D:labels"] == ["milk", "pr2"]
    assert shown.at("/queries/picture/legend", asked)["Points2D:colors"][0] >> 8 == 0xFF0000


def test_side_by_side_the_first_difference_is_marked(tmp_path: Path) -> None:
    for name, x in (("one", 1.0), ("two", 2.0)):
        with recorder.record(tmp_path / f"{name}.mcap"), BulletWorld(name="w"):
            cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
            cup.set_position([0, 1, 1])
            cup.set_position([x, 1, 1])
    logs = [str(tmp_path / f"{name}.mcap") for name in ("one", "two")]
    assert main(["view", *logs, "--save", str(tmp_path / "both.rrd")]) == 0
    file = Shown(tmp_path / "both.rrd")
    with replay.open(logs[0]) as log:
        last = [record.seq for record in log.records("mutation") if record.HasField("move_body")][-1]
    for root, other in (("one", "two"), ("two", "one")):
        (lane,) = [entity for entity in file.rows if entity.startswith(f"/{root}/level/0")]
        states = [file.at(lane, step)["StateChange:state"] for step in (last - 1, last)]
        assert states == [[f"as in {other}"], [f"differs from {other}"]]
        assert file.at(f"/{root}/log/difference", last)["TextLog:text"] == [f"the first difference from {other}"]
