"""Plans whose robots move in simulated time run again to the same bits: retraced, and forked within their motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Mutation
from replay.cli.main import main
from replay.restore.verify import verify
from replay.retrace.retrace import retrace
from tests.replay.retrace.bits import assert_same_bits
from tests.replay.retrace.control_plans import PLANS
from tests.replay.retrace.test_fork import forked
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("motions") / "plan.py"
    file.write_text(PLANS["trajectories"])
    return record(file)


def within(log: Path) -> list[int]:
    """Steps at which several trajectories go on."""
    with replay.open(log) as recording:
        simulations = [each for each in recording if isinstance(each, Mutation) and each.HasField("simulate")]
    return [each.seq for each in simulations if sum(not part.ended for part in each.simulate.driven) > 1]


def test_the_plan_does_the_same_again(log: Path) -> None:
    with replay.open(log) as recording:
        result = retrace(recording)
        assert result.difference is None
        assert result.equal == len(recording)
        assert verify(recording).exact


@pytest.mark.costly
def test_a_fork_in_the_middle_of_motions_goes_on_as_the_original(log: Path, tmp_path: Path) -> None:
    steps = within(log)
    assert len(steps) > 2
    for step in (steps[0], steps[-1]):
        forked(log, step, tmp_path / "fork.mcap")
        assert_same_bits(log, tmp_path / "fork.mcap")


@pytest.mark.costly
def test_what_a_fork_changes_there_is_compared_with_its_control(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cup that is moved within the motions changes nothing else."""
    arguments = ["--at", str(within(log)[0]), "--set", "cup.position=0,2,1", "--control"]
    assert main(["fork", str(log), *arguments, "-o", str(tmp_path / "set.mcap")]) == 0, capsys.readouterr()
    with replay.open(log) as recording:
        assert f"made the same {len(recording)} records again" in capsys.readouterr().out
