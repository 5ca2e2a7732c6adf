"""The files that are checked in are those that the script generates."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


def made_files(folder: Path) -> dict[str, bytes]:
    kinds = ("*.stl", "*.obj", "*.urdf", "*.toml", "parts/*")
    return {str(path.relative_to(folder)): path.read_bytes() for kind in kinds for path in folder.glob(kind)}


@pytest.mark.slow
def test_generating_again_gives_the_same_bytes(resources: Path, tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(resources / "make_resources.py"), "--into", str(tmp_path)], check=True)

    there, here = made_files(resources), made_files(tmp_path)

    assert sorted(there) == sorted(here)
    assert [name for name in there if there[name] != here[name]] == []


def test_resources_are_small(resources: Path) -> None:
    assert sum(len(content) for content in made_files(resources).values()) < 5_000_000


def test_no_file_names_a_path_of_the_machine_that_made_it(resources: Path) -> None:
    texts = [*resources.glob("*.urdf"), *resources.glob("*.obj"), *resources.glob("*.toml")]
    assert texts
    for path in texts:
        assert str(resources.parent) not in path.read_text(encoding="utf-8")
