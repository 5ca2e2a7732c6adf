"""What a sweep on two Ray nodes of this machine takes beside one without Ray."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

import pycram
from tests.benchmarks.timing import goal

DEMO = Path(__file__).parents[2] / "demos" / "scattered_table.py"
RUNS = 200
BEGUN = 30  # runs until all processes are there, and warm
NODES = 2
TURNS = 2


def seconds(folder: Path, ray: str | None) -> float:
    """How long it takes by the clock, start-up apart; recordings tell when their runs ended, and Ray only batches."""
    result = pycram.sweep(DEMO, RUNS, folder, set={"scatter": [0.01]}, cores=NODES, ray=ray)
    assert (result.done, result.stopped) == (RUNS, "")
    ended = sorted(file.stat().st_mtime for file in folder.glob("[0-9]*.mcap"))
    return ended[-1] - ended[BEGUN]


@pytest.mark.long
@pytest.mark.needs("Ray")
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_ray_takes_little_more_than_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import ray  # noqa: PLC0415  heavy, and of `make test-long` alone
    from ray.cluster_utils import Cluster  # noqa: PLC0415  as above

    monkeypatch.setenv("RAY_worker_niceness", "0")  # else everybody else on the machine goes first
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    local, rays = [], []
    try:
        for _ in range(NODES - 1):
            cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        ray.init(address=cluster.address, logging_level=logging.ERROR)
        for turn in range(TURNS):  # the pace of the machine changes
            local.append(seconds(tmp_path / f"local-{turn}", None))
            rays.append(seconds(tmp_path / f"ray-{turn}", ""))
    finally:
        ray.shutdown()
        cluster.shutdown()
    goal("200 runs of the demo on two Ray nodes, in times without Ray", min(rays) / min(local), 1.3, room=2)
