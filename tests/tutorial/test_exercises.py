"""Exercises of the tutorial: the checker accepts solutions, and says what is wrong in others."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from docs.cells import cells
from pycram.tutorial import exercises
from recorder.properties import parse
from tests.pages import REPO, environment

SOLUTIONS: Final = Path(__file__).parent / "solutions"
CHAPTERS: Final = {page.name[0]: page.read_text() for page in sorted((REPO / "docs" / "tutorial").glob("[1-9]*.md"))}
#: Mistakes: an edit of a solution, and what the reader is told.
MISTAKES: Final = [
    ("1_1", "    world.settle()\n", "", "the cup doesn't stand on the island"),
    ("1_2", ", [0.7071, 0, 0, 0.7071]", "", "the milk doesn't lie on its side"),
    ("5_1", '"cmd": "nodding"', '"cmd": "nod"', "no process module of pr2"),
    ("7_2", 'given = pycram.parameters(arm="left")', "given = None", "no parameter"),
]
OTHER_MISTAKES: Final = [
    ("1_1", "-0.8, 1.0, 0.92", "-0.8, 1.0, 0.2", "the cup doesn't stand on the island"),
    ("2_1", 'arm="right"', 'arm="left"', "the right gripper doesn't hold the milk at the end"),
    ("2_2", ', ("bowl", "right", [-0.8, 0.6, 0.89])', ",", "the robot never holds the bowl"),
    ("3_1", ', execution_environment("continuous")', "", "the robot"),
    ("3_2", "        perform(moving(", "        str(moving(", "while nobody simulates"),
    ("3_2", "random.sample(PLACES, 3)", "PLACES[:2]", "the robot is never near the bowl at the cat's place [-0.8"),
    ("4_1", "near=milk", "away_from=milk", "milk and bowl are more than 40 cm apart"),
    ("4_2", 'target="island"', 'target="island", close=False', "the drawer is still open"),
    ("5_1", 'designator.reference()["depth"], 0', 'designator.reference()["depth"],', "the head isn't up again"),
    ("5_2", 'side="left"', 'side="right"', "the bowl doesn't stand on the left side"),
    ("7_1", "perform(fetching(object=milk))", "print()", "the robot doesn't hold the milk at the end"),
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a reader who has read chapter 1."""
    for cell in cells(CHAPTERS["1"]):
        if cell.name == "scene.py":
            (tmp_path / "scene.py").write_text(cell.source)
    return tmp_path


def check(folder: Path, chapter: str) -> tuple[int, str]:
    command = [sys.executable, "-m", "pycram", "tutorial", "check", chapter]
    ended = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    assert not ended.stderr
    return ended.returncode, ended.stdout


@pytest.mark.costly
@pytest.mark.parametrize(
    "chapter", [pytest.param(each, marks=pytest.mark.long) if each in {"4", "7"} else each for each in CHAPTERS]
)
def test_solutions_are_right(folder: Path, chapter: str) -> None:
    for solution in SOLUTIONS.glob(f"exercise_{chapter}_*.py"):
        shutil.copy(solution, folder)
    assert check(folder, chapter) == (0, f"exercise_{chapter}_1.py: right\nexercise_{chapter}_2.py: right\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "old", "new", "mistake"),
    [*MISTAKES, *(pytest.param(*each, marks=pytest.mark.long) for each in OTHER_MISTAKES)],
)
def test_a_mistake_is_found_and_named(folder: Path, name: str, old: str, new: str, mistake: str) -> None:
    text = (SOLUTIONS / f"exercise_{name}.py").read_text()
    assert text.count(old) == 1
    (folder / f"exercise_{name}.py").write_text(text.replace(old, new))
    code, printed = check(folder, name[0])
    assert code == 1
    assert f"exercise_{name}.py: wrong: " in printed
    assert mistake in printed
    assert re.search(r"exercise_\d_\d.py: there is no such file in ", printed)


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "mistake"), [(1, "bowl can't be placed"), (2, "the bowl doesn't stand on the island")]
)
def test_the_broken_plans_of_chapter_6_are_wrong(folder: Path, number: int, mistake: str) -> None:
    blocks = re.findall(r"^    ```python\n(.*?)^    ```$", CHAPTERS["6"], re.DOTALL | re.MULTILINE)
    (folder / f"exercise_6_{number}.py").write_text(re.sub("^    ", "", blocks[number - 1], flags=re.MULTILINE))
    code, printed = check(folder, "6")
    assert code == 1
    assert mistake in printed


def test_each_chapter_describes_its_two_exercises() -> None:
    assert sorted(exercises()) == [f"{chapter}_{number}" for chapter in range(1, 8) for number in (1, 2)]
    for name, exercise in exercises().items():
        assert f"`exercise_{name}.py`" in CHAPTERS[name[0]]
        assert f"pycram tutorial check {name[0]}\n" in CHAPTERS[name[0]]
        assert [parse(each).text for each in exercise["properties"]]
