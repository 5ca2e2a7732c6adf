"""``pycram run``: one seed decides random numbers and the order of sets; names of recordings; local variables."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.cli import main, recording_path
from pycram.running import chosen_seed
from recorder.records import Output, Run

if TYPE_CHECKING:
    from collections.abc import Sequence

REPO = Path(__file__).parents[2]
PLAN = """
import os, random, subprocess, sys
import numpy as np
print(random.random(), np.random.rand(), list({"cup", "bowl", "milk", "spoon", "floor"}))
"""


def test_a_command_that_starts_itself_again_has_loaded_little_before() -> None:
    program = "import sys, pycram.cli; print({'numpy', 'google.protobuf', 'mcap', 'pybullet'} & sys.modules.keys())"
    ended = subprocess.run([sys.executable, "-c", program], cwd=REPO, capture_output=True, text=True, check=True)
    assert ended.stdout == "set()\n"


def run(folder: Path, *arguments: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    inherited = {name: value for name, value in os.environ.items() if name not in ("PYTHONHASHSEED", "PYCRAM_SEEDED")}
    return subprocess.run(
        [sys.executable, "-m", "pycram", "run", "plan.py", *arguments],
        cwd=folder,
        env=inherited | {"PYTHONPATH": str(REPO)} | (environment or {}),
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )


def start_of(file: Path) -> Run:
    with replay.open(file) as log:
        first = log[0]
        assert isinstance(first, Run)
        return first


@pytest.mark.costly
@pytest.mark.slow
def test_the_seed_of_a_run_repeats_its_random_numbers_and_the_order_of_its_sets(tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text(PLAN)
    drawn = run(tmp_path)
    start = start_of(tmp_path / "plan.mcap")
    assert start.hash_seed == start.seed
    again = run(tmp_path, "--seed", start.seed, "--log", "{plan}-{seed}.mcap")
    assert again.stdout == drawn.stdout
    file = tmp_path / f"plan-{start.seed}.mcap"
    assert start_of(file).seed == start.seed
    with replay.open(file) as log:
        assert [record.text for record in log.records(Output)] == again.stdout.splitlines()
    other = run(tmp_path, "--seed", "1")
    assert other.stdout != drawn.stdout
    assert "plan.mcap exists already; recording to plan.2.mcap" in re.sub(r"\S*/", "", other.stderr)
    assert "pycram-replay info plan.2.mcap" in other.stderr
    fixed = run(tmp_path, "--overwrite", environment={"PYTHONHASHSEED": "1"})
    assert fixed.stdout == other.stdout
    assert start_of(tmp_path / "plan.mcap").seed == "1"


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--seed", "5"], ["--seed=5", "--", "--seed", "x"]])
def test_what_takes_long_is_imported_once(tmp_path: Path, options: Sequence[str]) -> None:
    """The command that starts itself again has imported little before."""
    (tmp_path / "plan.py").write_text(PLAN)
    ended = run(tmp_path, *options, environment={"PYTHONPROFILEIMPORTTIME": "1"})
    started = [re.findall(rf"\| +{name}\n", ended.stderr) for name in ("pycram.running", "numpy")]
    assert [len(each) for each in started] == [2, 1]


def test_a_run_that_a_plan_starts_draws_a_seed_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHASHSEED", "7")
    monkeypatch.delenv("PYCRAM_SEEDED", raising=False)
    assert chosen_seed(None) == 7  # the user's
    monkeypatch.setenv("PYCRAM_SEEDED", f"{os.getpid()}:7")
    assert chosen_seed(None) == 7  # of this process, that was started again
    monkeypatch.setenv("PYCRAM_SEEDED", "1:7")
    assert len({chosen_seed(None) for _ in range(3)}) > 1
    assert chosen_seed(3) == 3


@pytest.mark.parametrize("options", [["--seed", "-1"], ["--seed", "4294967296"], ["--seed", "x"], ["--log", "{nix}"]])
def test_a_wrong_seed_or_placeholder_is_wrong_usage(
    tmp_path: Path, options: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text("print('ran')")
    with pytest.raises(SystemExit) as ended:
        main(["run", str(plan), *options])
    assert ended.value.code == 2
    output = capsys.readouterr()
    assert not output.out
    assert "4294967295" in output.err or "{plan}, {time} and {seed}" in output.err


def test_placeholders_of_a_recording_s_name(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recording_path("runs/{plan}.{seed}.mcap", "tidy", 5) == Path("runs/tidy.5.mcap")
    assert re.fullmatch(r"tidy-\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d", str(recording_path("{plan}-{time}", "tidy", None)))
    assert recording_path("{{x}}.mcap", "tidy", None) == Path("{x}.mcap")


@pytest.mark.parametrize("option", [[], ["--no-locals"]])
def test_local_variables_are_left_out_on_request(tmp_path: Path, option: Sequence[str]) -> None:
    plan, file = tmp_path / "plan.py", tmp_path / "x.mcap"
    plan.write_text("tries = 3\nraise ValueError(tries)")
    assert main(["run", str(plan), "--log", str(file), *option]) == 1
    with replay.open(file) as log:
        end = log[-1]
        assert isinstance(end, Run)
        found = [each.name for frame in end.failure.frames for each in frame.variables]
    assert found == ([] if option else ["tries"])
