"""What completion and ``dir()`` show of the packages, and ``pycram.seed``."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

import pycram
import recorder
import replay
from pycram.bullet_world import BulletWorld
from pycram.failures import BadArgument
from pycram.language import par
from pycram.scheduling.schedule import seed_order

REPO = Path(__file__).parents[2]


@pytest.mark.parametrize("package", [pycram, recorder, replay])
def test_dir_shows_the_public_names_alone_and_all_of_them_exist(package: object) -> None:
    shown = dir(package)
    assert set(package.__all__) <= set(shown)
    assert not [name for name in shown if name.startswith("_") or name == "TYPE_CHECKING"]
    assert all(getattr(package, name) is not None for name in shown)


def test_modules_are_attributes_without_an_import_of_their_own_and_dir_loads_none() -> None:
    program = """
import sys, pycram, recorder
assert "language" in dir(pycram) and "start" in dir(recorder)
print({"numpy", "google.protobuf", "mcap", "pybullet"} & sys.modules.keys())
print(pycram.language.par.__class__.__name__, pycram.bullet_world.BulletWorld.__name__)
"""
    ended = subprocess.run([sys.executable, "-c", program], cwd=REPO, capture_output=True, text=True, check=True)
    assert ended.stdout == "set()\nKind BulletWorld\n"


def test_help_and_completion_of_commands_load_no_heavy_package() -> None:
    """A shell waits for each completion: protobuf alone takes as long as all else."""
    program = (
        "import sys, pycram.cli, replay.cli.main; print({'numpy', 'google.protobuf', 'mcap'} & sys.modules.keys())"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=REPO, capture_output=True, text=True, check=True)
    assert ended.stdout == "set()\n"


def order_of_branches() -> list[int]:
    turns: list[int] = []

    def work(number: int) -> None:
        for _ in range(5):
            world.simulate(1 / 240)  # a checkpoint
            turns.append(number)

    with BulletWorld() as world, par as p:
        for number in range(3):
            p(work, number)
    return turns


def test_a_seed_decides_random_numbers_and_the_order_of_branches() -> None:
    try:
        runs = []
        for seed in (1, 1, 2):
            pycram.seed(seed)
            runs.append((order_of_branches(), random.random()))
    finally:
        seed_order(None)
    first, again, other = runs
    assert first == again
    assert first[0] != other[0]
    assert first[1] != other[1]


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5, True, None])
def test_what_is_no_seed_is_refused(seed: object) -> None:
    with pytest.raises(BadArgument, match="an integer from 0 to 4294967295"):
        pycram.seed(seed)
