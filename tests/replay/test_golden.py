"""Recordings of releases are read for ever: what each must give, whatever is added to the definition later.

``tests/replay/golden/VERSION.mcap`` was made by that release with ``pycram run tests/replay/golden/plan.py``. A new
release adds its own file; none is ever replaced.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Event, Fluent, Keyframe, Mutation, Query, Run, Task
from replay.cli.main import main
from replay.explain.blame import blame
from replay.explain.tree import tree
from replay.explain.why import why
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording

GOLDEN = sorted((Path(__file__).parent / "golden").glob("*.mcap"))
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


def test_there_is_one_and_it_is_small() -> None:
    assert GOLDEN
    assert all(file.stat().st_size < 100_000 for file in GOLDEN)


def test_it_is_whole(log: Recording) -> None:
    assert log.complete
    assert log.check() == ""
    assert [record.seq for record in log] == list(range(len(log)))
    assert log.metadata["plan"] == "plan"
    assert log.metadata["pybullet"]


def test_records_of_every_kind(log: Recording) -> None:
    kinds = (Run, Task, Mutation, Event, Fluent, Query, Keyframe)
    assert [sum(1 for _ in log.records(kind)) for kind in kinds] == [2, 12, 123, 3, 1, 4, 1]
    assert [record.WhichOneof("command") for record in log.records(Mutation)] == COMMANDS
    assert [record_data(query)["answer"] for query in log.records(Query)] == [False, True, False, False]
    assert [record_data(fluent)["after"] for fluent in log.records(Fluent)] == [True]
    visible = list(log.records(Query))[1]
    assert record_data(visible)["evidence"]["hidden_by"].keys() == {"cereal"}


def test_states_of_worlds(log: Recording) -> None:
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


def test_tasks_lines_and_failures(log: Recording) -> None:
    paths = [node.path for _, node in tree(log).walk()]
    assert paths[0] == "carry"
    assert paths[-2:] == ["put", "put"]
    found = why(log)
    assert found.failure.message == "the milk can't be put anywhere"
    assert found.raised[0].lines[-1].text.startswith("raise btr.ReasoningError(")
    assert [each.task.parameters["height"] for each in found.tries] == [1.0, 0.5]
    assert blame(log, "milk", "task:carry@end").how == "carried"


def test_attached_files(log: Recording) -> None:
    names = {name.partition("/")[2] for name in log.assets}
    assert {"plan.py", "carton.stl", "cabinet.urdf"} <= names
    for name, content in log.assets.items():
        assert hashlib.sha256(content).hexdigest() == name.partition("/")[0]


@pytest.mark.parametrize("verb", ["info", "log", "tree", "show 9", "state last", "diff 9 last", "blame milk", "why"])
def test_every_verb_reads_it(log: Recording, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    name, *rest = verb.split()
    assert main([name, str(log.path), *rest]) == 0
    said = capsys.readouterr()
    assert said.out.strip()
    assert not said.err
