"""A sweep on a Ray cluster of two nodes, of which one is lost in the middle: all runs are there, none twice."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import pytest

import pycram
import pycram.sweeping
from recorder.records import Run
from replay.recording import Recording
from replay.runs.rows import read_rows

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.sweeping import RunOutcome, Sweep

pytestmark = [pytest.mark.long, pytest.mark.needs("Ray")]
PLAN = """
import os, uuid
from pathlib import Path
import pycram
from pycram.bullet_world import BulletWorld, Object

given = pycram.parameters(marks="", side="left")
with BulletWorld():
    Object("cup", "cup", "cup.stl", [0, 0, 1])
Path(given.marks, f"{given.side}-{uuid.uuid4()}").touch()
"""
RUNS = 200


@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_node_is_lost_in_the_middle(tmp_path: Path) -> None:
    plan, folder, marks = tmp_path / "plan.py", tmp_path / "runs", tmp_path / "marks"
    plan.write_text(PLAN)
    marks.mkdir()
    import ray  # noqa: PLC0415  heavy, and of `make test-long` alone
    from ray.cluster_utils import Cluster  # noqa: PLC0415  as above

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    seen: list[int] = []

    def progress(result: Sweep, outcome: RunOutcome | None) -> None:
        nonlocal second
        if outcome is not None:
            seen.append(outcome.number)
        if result.done >= RUNS // 3 and second is not None:
            cluster.remove_node(second, allow_graceful=False)
            second = None

    try:
        ray.init(address=cluster.address, logging_level=logging.ERROR)
        result = pycram.sweep(
            plan, RUNS, folder, set={"marks": [str(marks)], "side": ["left", "right"]}, ray="", progress=progress
        )
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert second is None
    assert (result.done, result.failed, result.stopped) == (RUNS, 0, "")
    assert sorted(seen) == list(range(RUNS))
    files = sorted(folder.glob("[0-9]*.mcap"))
    assert len(files) == RUNS
    for number, file in enumerate(files):
        with Recording(file) as log:
            began, ended = log[0], log[-1]
            assert isinstance(began, Run)
            assert isinstance(ended, Run)
            assert (began.sweep.number, ended.succeeded) == (number, True)
            assert log.complete
    # those that were going on in the lost node were begun again, and no other
    assert RUNS <= len(list(marks.iterdir())) <= RUNS + 2
    assert not list(folder.glob(".*.mcap.part"))


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("memory://runs", "is gone with its process; name a folder of files"),
        ("s3://bucket/runs", "s3fs"),
        ("nothing://runs", "not known"),
    ],
)
def test_urls_to_which_nothing_can_be_written_are_refused(tmp_path: Path, url: str, says: str) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text("print(1)")
    with pytest.raises(pycram.sweeping.SweepRefused, match=says):
        pycram.sweep(plan, 1, url, ray="")


@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_url_of_files(tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(PLAN)
    url = f"file://{tmp_path}/runs"
    result = pycram.sweep(plan, 3, url, set={"marks": [str(tmp_path)]}, ray="", cores=1)
    assert (result.done, result.failed, result.stopped) == (3, 0, "")
    for file in sorted((tmp_path / "runs").glob("0*.mcap")):  # the run's own process has written its rows
        rows = read_rows(file, file.stat())
        assert rows is not None
        assert rows["runs"]["number"].to_pylist() == [int(file.name[:5])]
