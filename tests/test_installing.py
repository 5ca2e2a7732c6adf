"""What is installed with which extra, and what texts say about installing."""

from __future__ import annotations

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import requires
from pathlib import Path

import pytest

from recorder import packages

REPO = Path(__file__).parent.parent
ENVIRONMENT = REPO / ".ci" / "environment"
TEXTS = ("*.py", "*.md", "*.toml", "Makefile", ".ci/*")


def test_the_base_is_what_reading_needs() -> None:
    base = {re.split("[^a-z-]", line)[0] for line in requires("pycram") or () if "extra ==" not in line}
    assert base == {"mcap", "protobuf", "foxglove-schemas-protobuf", "numpy", "argcomplete"}


def test_nothing_sends_anybody_to_the_stranger_of_this_name() -> None:
    assert not [line for line in requires("pycram") or () if line.startswith("pycram")]
    folders = ("", "pycram", "recorder", "replay", "resources", "demos", "docs", "tests")
    files = {file for folder in folders for text in TEXTS for file in (REPO / folder).glob(text)}
    files |= {file for folder in folders[1:] for text in TEXTS for file in (REPO / folder).rglob(text)}
    wrong = re.compile(r"pip install (?:-\S+ )*['\"]?pycram\b")
    assert not [file for file in files if file.is_file() and wrong.search(file.read_text(encoding="utf-8"))]


def fake(folder: Path, name: str, code: str) -> None:
    (folder / name).write_text(f"#!/bin/sh\n{code}\n")
    (folder / name).chmod(0o755)


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A folder with the only programs of a machine: no Python yet."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for tool in ("sh", "cat"):
        (folder / tool).symlink_to(str(shutil.which(tool)))
    return folder


def prepare(machine: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Makes an environment as ``make demo`` does; nothing may be left where that can't be."""
    target = machine.parent / "venv"
    command = ["sh", str(ENVIRONMENT), str(target), ".[all]"]
    kept = {"PATH": str(machine), "HOME": os.environ.get("HOME", "/")}
    ended = subprocess.run(command, env=kept | environment, capture_output=True, text=True, check=False)
    assert not target.exists()
    assert not ended.stdout
    return ended


#: A Python as far as the script asks it.
PYTHON = """
case "$*" in
*"%d.%d"*) echo {version} ;;
*version_info*) exit {old} ;;
*ensurepip*) exit {venv} ;;
*) echo "unexpected: $*" >&2; exit 9 ;;
esac
"""


@pytest.mark.parametrize(
    ("version", "venv", "message"),
    [
        ("3.11", 1, "python3.11 can't make virtual environments: apt install python3.11-venv"),
        ("3.12", 1, "python3.12 can't make virtual environments: apt install python3.12-venv"),
    ],
)
def test_what_is_missing_is_said_before_anything_is_downloaded(
    machine: Path, version: str, venv: int, message: str
) -> None:
    fake(machine, f"python{version}", PYTHON.format(version=version, old=0, venv=venv))
    ended = prepare(machine)
    assert (ended.returncode, ended.stderr) == (2, f"pycram: {message}\n")


def test_python_3_11_is_preferred_whatever_its_command_is_called(machine: Path) -> None:
    for name, version in (("python3.13", "3.13"), ("python3.12", "3.12"), ("python3", "3.11")):
        fake(machine, name, PYTHON.format(version=version, old=0, venv=1))
    assert prepare(machine).stderr == "pycram: python3 can't make virtual environments: apt install python3.11-venv\n"


def test_other_pythons_are_refused(machine: Path) -> None:
    ended = prepare(machine)
    assert ended.returncode == 2
    assert ended.stderr.startswith("pycram: needs Python 3.11, 3.12 or 3.13, and found none: apt install python3")
    fake(machine, "python3", PYTHON.format(version="3.9", old=1, venv=0))
    assert prepare(machine).stderr == ended.stderr
    refused = prepare(machine, PYTHON="python3")
    assert (refused.returncode, refused.stderr) == (
        2,
        "pycram: python3 is Python 3.9, and PyCRAM needs 3.11 or newer\n",
    )
    assert prepare(machine, PYTHON="nothing").stderr == "pycram: PYTHON=nothing is no Python\n"


def python(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)


def test_without_the_extra_for_motions_only_simulated_time_is_refused() -> None:
    ended = python(
        "import sys\n"
        "sys.modules['toppra'] = sys.modules['ompl'] = None\n"
        "from pycram.bullet_world import BulletWorld\n"
        "from pycram.process_module import execution_environment\n"
        "with BulletWorld(), execution_environment('simulated'):\n"
        "    print('instant motions work')\n"
        "with execution_environment('continuous'):\n"
        "    print('not reached')\n"
    )
    assert ended.stdout == "instant motions work\n"
    assert ended.stderr.splitlines()[-1].endswith(
        "NotInstalled: ompl isn't installed; in a checkout of PyCRAM: pip install '.[motion]'"
    )


def test_two_packages_of_the_engine_in_one_environment_are_reported(tmp_path: Path) -> None:
    for name in ("pybullet-3.2.7", "pybullet_arm64-3.2.8"):
        (tmp_path / f"{name}.dist-info").mkdir()
    real = python("import pybullet; print(pybullet.__file__)").stdout.splitlines()[-1]
    ended = python(
        f"import sys, pybullet\npybullet.__file__ = {str(tmp_path / Path(real).name)!r}\nimport pycram.physics.engine\n"
    )
    assert ended.stderr.count("pybullet and pybullet-arm64 are both installed") == 1


def test_provenance_names_the_distribution_of_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "pybullet":
            raise importlib.metadata.PackageNotFoundError
        return "3.2.8"

    monkeypatch.setattr(importlib.metadata, "version", version)
    packages._installed.cache_clear()
    try:
        assert packages.versions()["pybullet"] == "3.2.8 (pybullet-arm64)"
        assert packages.other_versions({"pybullet": "3.2.7"}, "pybullet") == ()
        assert packages.other_versions({"pybullet": "3.2.5"}, "pybullet") == (
            "pybullet 3.2.8 (pybullet-arm64) instead of 3.2.5",
        )
    finally:
        packages._installed.cache_clear()
