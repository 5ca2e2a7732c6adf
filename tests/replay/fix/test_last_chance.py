"""The last chance of plans whose closing step is known (:mod:`tests.replay.fix.closings`)."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import replay
from replay.cli.main import main
from tests.replay.fix.closings import KINDS, SPOT, closing_line, drawn

if TYPE_CHECKING:
    from pathlib import Path

SEEDS = range(1, 7)
IN_THE_GATE = {("away", 2)}
ALL = [(kind, seed) for kind in KINDS for seed in SEEDS]
CASES = [pytest.param(*case, marks=[pytest.mark.costly if case in IN_THE_GATE else pytest.mark.long]) for case in ALL]


def record(plan: Path, log: Path, text: str) -> None:
    plan.write_text(text)
    command = [sys.executable, "-m", "pycram", "run", str(plan), "--seed", "1", "--log", str(log), "--overwrite"]
    subprocess.run(command, capture_output=True, check=False)


@pytest.mark.slow
@pytest.mark.measure("last chances, {kind}")
@pytest.mark.parametrize(("kind", "seed"), CASES)
def test_the_closing_line_is_found_and_the_last_chance_leads_to_success(
    kind: str, seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, log, text = tmp_path / "plan.py", tmp_path / "run.mcap", drawn(kind, seed)
    record(plan, log, text)
    if SPOT in text:  # the cup must go where the bowl is now
        with replay.open(log) as first:
            x, y, _ = first.state_at("last").body("bowl").position
        text = text.replace(SPOT, f"[{x:.3f}, {y:.3f}, 0.91]")
        record(plan, log, text)
    assert main(["last-chance", str(log), "--json", "--keep", str(tmp_path)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["line"].endswith(f"plan.py:{closing_line(text)}")
    assert found["step"] < found["closed_by"]
    assert found["runs"] <= 80
    assert bool(found["exceptions"]) == (kind in ("drawer", "door")), "they were closed at the beginning, too"
    with replay.open(found["recording"]) as success:
        assert success.why().run.outcome == "succeeded"
    if found["choice"]:
        answer = ["--answer", found["choice"], "-o", str(tmp_path / "again.mcap")]
        assert main(["fork", str(log), "--at", str(found["step"]), *answer]) == 0


@pytest.mark.slow
def test_a_plan_that_succeeded_has_no_last_chance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan, log = tmp_path / "plan.py", tmp_path / "run.mcap"
    record(plan, log, "from pycram.bullet_world import BulletWorld\n\nBulletWorld().exit()\n")
    assert main(["last-chance", str(log), "--keep", str(tmp_path)]) == 2
    assert "the plan succeeded" in capsys.readouterr().err
