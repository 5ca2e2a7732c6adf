"""What the README shows of a failed plan is what a reader gets."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
FOLDER = re.compile(r"\S*demos/")
SECONDS = re.compile(r"# m?s\b")  # how long a thing takes here is no matter
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def commands() -> list[tuple[str, list[str]]]:
    """Each command of the section with the output that it shows."""
    section = README.read_text().partition("## 4. A plan failed. What now?")[2].partition("\n## ")[0]
    blocks = re.findall(r"```console\n\$ (.*?)```", section, re.DOTALL)
    return [(block.splitlines()[0], block.splitlines()[1:]) for block in blocks]


def without_numbers(line: str) -> str:
    return SECONDS.sub("# s", NUMBER.sub("#", FOLDER.sub("demos/", line))).strip()


@pytest.mark.slow
def test_the_readme_s_walk_through_a_failed_plan_is_real(failed_log: Path, tmp_path: Path) -> None:
    (tmp_path / failed_log.name).write_bytes(failed_log.read_bytes())
    shown = commands()
    assert [command.split()[1] for command, _ in shown] == ["why", "render", "blame", "ask", "restore"]
    for command, lines in shown:
        program, *arguments = shlex.split(command)
        assert program == "pycram-replay"
        ended = subprocess.run(
            [sys.executable, "-m", "replay", *arguments],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 0, ended.stderr
        output = {without_numbers(line) for line in ended.stdout.splitlines()}
        for line in lines:
            assert line == "..." or without_numbers(line) in output, (command, line)
