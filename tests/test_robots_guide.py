"""The examples in docs/guides/robots.md give the printed output."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from pycram.models import files
from pycram.models.robots.description import RobotDescription

REPO = Path(__file__).parent.parent
GUIDE = (REPO / "docs" / "guides" / "robots.md").read_text(encoding="utf-8")


def commands() -> list[tuple[str, list[str]]]:
    blocks = re.findall(r"```console\n\$ (.*?)```", GUIDE, re.DOTALL)
    return [(block.splitlines()[0], block.splitlines()[1:]) for block in blocks]


@pytest.mark.slow
@pytest.mark.parametrize(("command", "shown"), commands())
def test_commands_print_what_the_guide_shows(tmp_path: Path, command: str, shown: list[str]) -> None:
    program, *arguments = shlex.split(command.replace("pycram/models", str(REPO / "pycram" / "models")))
    assert program == "pycram"
    ended = subprocess.run(
        [sys.executable, "-m", "pycram", *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(REPO), "PATH": "/usr/bin:/bin"},
    )
    assert ended.returncode == 0, ended.stderr
    printed = ended.stdout.splitlines()
    if shown[-1] == "...":
        shown, printed = shown[:-1], printed[: len(shown) - 1]
    stillness = [line for line in shown if line.startswith("ok      stillness")]
    assert [line for line in printed if "stillness" not in line] == [line for line in shown if line not in stillness]
    for line in stillness:  # which joint moves most, by how many micrometres, is the engine's
        assert any(other.startswith("ok      stillness: in 2 s of simulation ") for other in printed), line


def test_the_guide_names_the_robots_in_the_box_and_their_arms() -> None:
    rows = re.findall(r"^\| [\w ]+ \| `([\w.]+)` \| ((?:`\w+`(?:, )?)+) \|", GUIDE, re.MULTILINE)
    assert {urdf for urdf, _ in rows} == set(files.ROBOT_URDFS)
    for urdf, arms in rows:
        described = RobotDescription.load(REPO / "pycram" / "models" / "robots" / urdf.replace(".urdf", ".toml"))
        assert set(re.findall(r"`(\w+)`", arms)) == set(described.arms)


def test_every_entry_of_the_descriptions_is_in_the_guide() -> None:
    entries = set()

    def collect(table: dict[str, object]) -> None:
        for key, value in table.items():
            if isinstance(value, dict):
                collect(value)
            else:
                entries.add(key)

    for file in (REPO / "pycram" / "models" / "robots").glob("*.toml"):
        collect(tomllib.loads(file.read_text(encoding="utf-8")))
    missing = {entry for entry in entries if not re.search(rf"\b{entry}\b", GUIDE)}
    assert missing <= {"horizontal_fov", "vertical_fov", "width", "height", "near", "far"}
