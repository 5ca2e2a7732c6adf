"""What docs/retrace.md shows is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.replay.test_readme import without_numbers

REPO = Path(__file__).parents[3]


@pytest.mark.slow
def test_the_guide_s_output_is_real(failed_log: Path, tmp_path: Path) -> None:
    (tmp_path / failed_log.name).write_bytes(failed_log.read_bytes())
    (tmp_path / "demos").symlink_to(REPO / "demos")
    (tmp_path / "pycram-replay").write_text(f'#!/bin/sh\nexec {sys.executable} -m replay "$@"\n')
    (tmp_path / "pycram-replay").chmod(0o755)
    blocks = re.findall(r"```console\n(.*?)```", (REPO / "docs" / "retrace.md").read_text(), re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        lines = block.splitlines()
        commands = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        shown = [without_numbers(line) for line in lines if not line.startswith("$ ")]
        script = f'PATH="$PWD:$PATH"\n{chr(10).join(commands)}'
        ended = subprocess.run(["sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert [without_numbers(line) for line in ended.stdout.splitlines()] == shown, ended.stderr
