"""Names that aren't identifiers are in quotes, as in Python, in watches, questions, moves and settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from replay.cli.main import main
from replay.debug.session import NoQuantity, quantity_names, value_changes
from replay.retrace.changes import checked_answer, parse_setting, settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    file = tmp_path_factory.mktemp("names") / "run.mcap"
    with recorder.record(file), BulletWorld(name="big lab") as world:
        Object("floor", "environment", "plane.urdf")
        carton = Object("milk carton", "milk", "milk.stl", [0, 0, 1])  # step 3
        cup = Object("cup 2.0", "cup", "cup.stl", [0, 3, 1])  # step 4
        carton.set_position([0, 0, 2])  # step 5
        btr.stable(cup)
        assert world.objects
    with replay.open(file) as opened:
        yield opened


@pytest.mark.parametrize(
    ("expression", "values"),
    [
        ("'milk carton'.z", [None, 1.0, 2.0]),
        ("milk_carton.z", [None, 1.0, 2.0]),
        ('big_lab["milk carton"].z > 1.5', [None, False, True]),
        ("'big lab'['milk carton'].z", [None, 1.0, 2.0]),
        ("""distance("cup 2.0", 'milk carton')""", [None, 3.0, pytest.approx(10**0.5)]),
        ("'cup 2.0'.carrier == 'milk carton'", [None, False]),  # compared as text
    ],
)
def test_watches_take_names_in_quotes(log: Recording, expression: str, values: list[object]) -> None:
    changes = value_changes(log, expression)[: len(values) - 1]
    assert [None, *(change.after for change in changes)] == values


def test_a_name_in_quotes_alone_is_the_object(log: Recording) -> None:
    assert [change.step for change in value_changes(log, "'milk carton'")][:2] == [3, 5]


@pytest.mark.parametrize(
    ("expression", "cause"),
    [
        ("'milk crton'.z", "no object is called milk crton; did you mean milk carton"),
        ("distance('milk carton', 'cup')", r"no object is called cup; did you mean cup 2\.0"),
        ("'milk carton'.positon", "has no positon; did you mean position"),
        ("mlik.z", "no object is called mlik; there are big lab, cup 2.0, floor, milk carton"),
    ],
)
def test_unknown_names_in_watches_are_refused_with_the_nearest_name(
    log: Recording, expression: str, cause: str
) -> None:
    with pytest.raises(NoQuantity, match=cause):
        value_changes(log, expression)


def test_completion_offers_what_a_watch_takes(log: Recording) -> None:
    for name in quantity_names(log, 5):
        if not name.endswith("(") and name != "'big lab'":
            assert value_changes(log, name) is not None
    assert "'milk carton'.z" in quantity_names(log, 5)


def test_questions_and_moves_take_names_in_quotes(log: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    here = ["ask", str(log.path), "5"]
    assert main([*here, "contact('milk carton', 'cup 2.0')"]) == 0
    assert main([*here, "contact('milk carton', 'cup 2.0')", "--move", "'milk carton'=0,3,1"]) == 0
    no, yes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("contact")]
    assert (no[-2:], yes[-3:]) == ("no", "yes")
    assert main([*here, "stable('milk crton')"]) == 2
    assert "did you mean milk carton" in capsys.readouterr().err


def test_settings_and_answers_take_names_in_quotes(log: Recording) -> None:
    text = "'milk carton'.position=1,2,3"
    (change,) = settings(log, 5, [text])
    assert change.world == "big lab"
    found = parse_setting(text, fluent=False)
    assert (found.name, found.quantity, found.value) == ("milk carton", "position", [1, 2, 3])
    (fluent,) = settings(log, 5, ["'left = battery'=20"])
    assert not fluent.world
    found = parse_setting(fluent.set, fluent=True)
    assert (found.name, found.quantity, found.value) == ("left = battery", "", 20)
    checked_answer(log, 0, "contact('milk carton', 'cup 2.0')=false")
