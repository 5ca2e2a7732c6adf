"""Local variables of raised errors: which are recorded, how they are written, and that no user code runs."""

from __future__ import annotations

import enum
import pickle
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np
import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import par
from recorder.records import Run, Task
from recorder.tracing.call_stack import MAX_CHARACTERS, MAX_FRAMES, MAX_VARIABLES, described
from recorder.tracing.span import span
from replay.cli.main import main

if TYPE_CHECKING:
    from recorder.records import Failure


SECRET = "hunter" + str(2)  # in no source


class Touchy:
    """A value that must not be touched."""

    def __repr__(self, *_: object) -> NoReturn:
        raise AssertionError("touched")

    __len__ = __iter__ = __eq__ = __hash__ = __str__ = __bool__ = __lt__ = __getattribute__ = __repr__


class Sly(type):
    """The type of a type that must not be touched."""

    def __getattribute__(cls, name: str) -> NoReturn:
        raise AssertionError(f"touched {name}")


class Side(enum.Enum):
    LEFT = 1


def grasp(arm: str, tries: int, api_key: str = "s3cret") -> NoReturn:
    touchy = Touchy()
    login = {"user": "ada", "password": SECRET}
    raise PlanFailure(f"the {arm} arm can't, {bool(tries and api_key and login and id(touchy))}")


def attempt(arm: str) -> None:
    height = 0.5
    with span("motion", "pick-up"), span("process-module", "PickUp"):
        grasp(arm, round(height * 6))


def values(failure: Failure) -> list[tuple[str, dict[str, str]]]:
    return [(frame.function, {each.name: each.value for each in frame.variables}) for frame in failure.frames]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "x.mcap"


def test_a_failure_holds_the_plan_s_variables_once(file: Path) -> None:
    with pytest.raises(PlanFailure), recorder.record(file):
        attempt("right")
    with replay.open(file) as log:
        module, motion = [record.failure for record in log.records(Task) if record.phase == Task.FINISHED]
        end = log[-1]
        assert isinstance(end, Run)
        assert values(module)[-2:] == [
            ("attempt", {"arm": "'right'", "height": "0.5"}),
            (
                "grasp",
                {
                    "arm": "'right'",
                    "tries": "3",
                    "api_key": "<left out>",
                    "touchy": "<Touchy>",
                    "login": "{'user': 'ada', 'password': <left out>}",
                },
            ),
        ]
        assert values(module)[-3][0] == "test_a_failure_holds_the_plan_s_variables_once"
        assert values(motion) == values(end.failure) == []  # they are on record
    assert SECRET.encode() not in file.read_bytes()


def test_why_shows_them_beside_the_lines(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(PlanFailure), recorder.record(file, source=__file__):
        attempt("right")
    assert main(["why", str(file)]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    at = next(number for number, line in enumerate(lines) if line.startswith("raise PlanFailure("))
    assert lines[at + 1] == "with arm='right', tries=3, api_key=<left out>, touchy=<Touchy>"
    assert lines[at + 2] == "with login={'user': 'ada', 'password': <left out>}"
    assert "with arm='right', height=0.5" in lines


def test_each_branch_and_what_is_around_it_has_its_own(file: Path) -> None:
    place = "table"

    def left() -> None:
        hand = "left"
        attempt(hand)

    with pytest.raises(PlanFailure), recorder.record(file), par as s:
        s(left)
    with replay.open(file) as log:
        failures = [record.failure for record in log.records((Task, Run)) if record.HasField("failure")]
        found = [frame for failure in failures for frame in values(failure)]
        names = [name for name, _ in found]
        assert names.count("left") == names.count("attempt") == names.count("grasp") == 1
        outer = "test_each_branch_and_what_is_around_it_has_its_own"
        assert [variables["place"] for name, variables in found if name == outer][:1] == [repr(place)]
        why = log.why()
        assert {"hand": "'left'"} in why.variables.values()


def test_locals_are_left_out_on_request_also_where_another_recording_wants_them(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "y.mcap"
    for first, second in ((True, False), (False, True)):
        with (
            recorder.record(file, locals=first, overwrite=True),
            recorder.record(other, locals=second, overwrite=True),
            pytest.raises(PlanFailure),
        ):
            attempt("right")
        for path in (file, other):
            with replay.open(path) as log:
                failures = [record.failure for record in log.records(Task) if record.HasField("failure")]
                assert failures
                assert not any(failure.frames for failure in failures)


def test_many_frames_and_variables_are_cut(file: Path) -> None:
    def down(depth: int) -> None:
        if not depth:
            exec("\n".join([*(f"v{number} = {number}" for number in range(50)), "raise PlanFailure"]), globals(), {})
        down(depth - 1)

    with pytest.raises(PlanFailure), recorder.record(file):
        down(100)
    with replay.open(file) as log:
        end = log[-1]
        assert isinstance(end, Run)
        assert len(end.failure.frames) == MAX_FRAMES
        inner = end.failure.frames[-1]
        assert [each.name for each in inner.variables] == [f"v{number}" for number in range(MAX_VARIABLES)]
        assert end.failure.frames[-2].function == "down"


def test_values_are_told_in_a_few_words_without_calling_anything_of_theirs() -> None:
    class Hidden(metaclass=Sly):
        pass

    class MyList(list):  # type: ignore[type-arg]
        __iter__ = __len__ = __repr__ = Touchy.__repr__

    loop: list[object] = []
    loop.append(loop)
    for value, text in (
        ("a" * 200, None),
        (b"\0\1", r"b'\x00\x01'"),
        (10**5000, "<int of 16610 bits>"),
        ([1.5, None, True], "[1.5, None, True]"),
        (list(range(100)), "[0, 1, 2, 3, 4, 5, ...]"),
        ((1,), "(1,)"),
        (set(), "set()"),
        ({Side.LEFT: {3}}, "{Side.LEFT: {3}}"),
        (loop, "[[[[...]]]]"),
        (np.float64(0.25), "0.25"),
        (np.array([1, 2]), "array([1, 2])"),
        (np.zeros((480, 640)), "<array 480x640 of float64>"),
        (np.array([Fraction(1)], dtype=object), "<ndarray>"),
        (Path("x"), "PosixPath('x')"),
        (Fraction(1, 2), "<Fraction>"),
        ([Touchy()], "[<Touchy>]"),
        (MyList(), f"<{MyList.__qualname__}>"),
    ):
        assert described(value) == (text if text is not None else described(value))
    assert (
        described(Hidden())
        == "<test_values_are_told_in_a_few_words_without_calling_anything_of_theirs.<locals>.Hidden>"
    )
    assert len(described("a" * 10**6)) < 2 * MAX_CHARACTERS


def test_objects_of_a_world_have_their_names() -> None:
    with BulletWorld(name="lab"):
        milk = Object("milk", "milk", "milk.stl")
        assert described([milk]) == "[<Object milk>]"


def test_an_error_that_was_recorded_pickles_and_compares_as_before(file: Path) -> None:
    with pytest.raises(PlanFailure) as raised, recorder.record(file):
        attempt("left")
    again = pickle.loads(pickle.dumps(raised.value))
    assert str(again) == str(raised.value)
