"""Two folders of runs compared, and several recordings looked at together."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import pytest

from replay.cli.main import main
from tests.replay.runs.seeded import Cause, sweep

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.slow


@pytest.fixture
def changed(runs: Path, tmp_path: Path) -> Path:
    """The same runs but for two, in which nothing falls any more."""
    folder = tmp_path / "changed"
    shutil.copytree(runs, folder)
    fell = [name for name, ok in _ended(folder).items() if not ok][:2]
    again = tmp_path / "again"
    again.mkdir()
    sweep(again, Cause("arm", "spoon", "neither"), [int(name.split(".")[0]) for name in fell])
    for recording in again.glob("*.mcap"):
        shutil.copy2(recording, folder)
    return folder


def _ended(folder: Path) -> dict[str, bool]:
    from replay.runs.folder import Runs  # noqa: PLC0415

    with Runs(folder) as opened:
        return dict(opened.sql("SELECT run, succeeded FROM runs ORDER BY run").rows())


def test_the_runs_that_end_otherwise_are_named(runs: Path, changed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = _ended(runs), _ended(changed)
    mended = sorted(name for name in before if after[name] and not before[name])
    assert mended
    assert main(["diff", str(runs), str(changed), "--json"]) == 1
    comparison = json.loads(capsys.readouterr().out)
    assert comparison["paired"] == len(before)
    assert comparison["mended"] == [[name, name] for name in mended]
    assert comparison["broken"] == []
    assert comparison["second"]["succeeded"] == comparison["first"]["succeeded"] + len(mended)
    assert comparison["effect"] == pytest.approx(len(mended) / len(before))
    assert comparison["interval"][0] < comparison["effect"] < comparison["interval"][1]
    (cause,) = [each for each in comparison["causes"] if each["first"] != each["second"]]
    assert cause["second"] == cause["first"] - len(mended)
    assert main(["diff", str(changed), str(runs)]) == 1
    text = capsys.readouterr().out
    assert f"{len(mended)} of them fail only in the second folder\n  pycram-replay diff {changed}/{mended[0]}" in text


def test_a_folder_is_the_same_as_itself(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diff", str(runs), str(runs)]) == 0
    assert "change   0%" in capsys.readouterr().out
    assert main(["diff", str(runs), str(next(runs.glob("*.mcap")))]) == 2
    assert "diff compares two folders" in capsys.readouterr().err


def test_a_folders_failures_are_looked_at_side_by_side(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "failures.rrd"
    assert main(["view", str(runs), "--save", str(scene)]) == 0
    assert scene.stat().st_size
    some = [str(path) for path in sorted(runs.glob("*.mcap"))]
    assert main(["view", *some[:3], "--save", str(tmp_path / "three.rrd")]) == 0
    capsys.readouterr()
    assert main(["view", *some[:5], "--save", str(tmp_path / "five.rrd")]) == 2
    assert "give at most four" in capsys.readouterr().err


def test_why_of_a_folder_has_the_causes(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(runs)]) == 0
    text = capsys.readouterr().out
    first = text.split("\n\n")[1].splitlines()[1].removeprefix("first in ").rstrip(":")
    assert main(["why", str(runs / first)]) == 0
    cause = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("The cause: "))
    assert f"  {cause}" in text
    assert "\n  Why\n" in text
