"""Values and errors of users in records: JSON that keeps every bit, and never breaks a plan."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import JointLimitError
from recorder.records import arguments, failure, to_json
from recorder.records.tracebacks import MAX_FRAMES
from recorder.records.values import MAX_CHARACTERS

scalars = st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False, allow_infinity=False)
values = st.recursive(
    scalars | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@pytest.mark.slow
@given(values)
def test_plain_values_survive_json_bit_for_bit(value: object) -> None:
    text = to_json(value)
    assert json.loads(text) == value
    assert "\n" not in text


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=8))
def test_arrays_become_lists(numbers: list[float]) -> None:
    array = np.array(numbers)
    assert json.loads(to_json(array)) == json.loads(to_json(tuple(numbers))) == numbers
    for number in array:
        assert json.loads(to_json(number)) == number


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_nan_and_infinities_become_valid_json(number: float) -> None:
    data = json.loads(to_json([number]), parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    assert data == [{"float": repr(number)}]


def test_objects_and_functions_are_recorded_by_name_and_unknown_values_by_repr() -> None:
    with BulletWorld() as world:
        cup = Object("cup", "cup", "cup.stl")
        assert json.loads(to_json({"object": cup})) == {"object": {"object": "cup", "world": world.name}}
    assert json.loads(to_json(math.sqrt)) == {"callable": "math.sqrt"}
    assert json.loads(to_json({3, 1})) == [1, 3]

    class Odd:
        def __repr__(self) -> str:
            return "<odd>"

    assert json.loads(to_json(Odd())) == {"repr": "<odd>"}


def test_values_that_raise_errors_are_recorded_all_the_same() -> None:
    class Broken:
        def __repr__(self) -> str:
            raise ZeroDivisionError

    endless: list[object] = []
    endless.append(endless)
    assert json.loads(to_json(Broken()))["because"].startswith("ZeroDivisionError")
    assert json.loads(to_json(endless))["untold"] == "list"
    assert "generator" in json.loads(to_json(x for x in "ab"))["repr"]
    assert json.loads(to_json("a\ud800")) == "a\ud800"
    to_json("a\ud800").encode()


def test_a_value_that_would_make_a_record_unreadable_is_left_out() -> None:
    assert json.loads(to_json("x" * (MAX_CHARACTERS - 2))) == "x" * (MAX_CHARACTERS - 2)
    text = "ä" * (MAX_CHARACTERS - 1)
    assert json.loads(to_json(text)) == {"untold": "str", "because": f"ValueError: it has {len(text) + 2} characters"}


def test_a_failure_holds_type_data_and_traceback() -> None:
    with pytest.raises(JointLimitError) as caught:
        raise JointLimitError("pr2", "torso_lift_joint", 2.0, 0.0, 0.33)
    recorded = failure(caught.value)
    assert recorded.type == "JointLimitError"
    assert "test_a_failure_holds_type_data_and_traceback" in recorded.traceback
    data = {argument.name: json.loads(argument.json) for argument in recorded.data}
    assert data["joint"] == "torso_lift_joint"
    assert data["value"] == 2.0


def test_a_long_traceback_holds_the_innermost_frames_of_each_error() -> None:
    def there(left: int) -> None:
        back(left - 1)

    def back(left: int) -> None:
        if left <= 0:
            raise ValueError("innermost")
        there(left - 1)

    def again() -> None:
        try:
            there(300)
        except ValueError as error:
            raise KeyError from error

    def nested(left: int) -> None:
        again() if left <= 0 else other(left - 1)

    def other(left: int) -> None:
        nested(left - 1)

    with pytest.raises(KeyError) as raised:
        nested(300)
    cause, error = failure(raised.value).traceback.split("direct cause of")
    assert cause.count('  File "') == error.count('  File "') == MAX_FRAMES
    assert 'raise ValueError("innermost")' in cause
    assert "raise KeyError from error" in error


def test_errors_whose_message_raises_are_recorded_all_the_same() -> None:
    class Shy(Exception):
        def __str__(self) -> str:
            raise ZeroDivisionError

    assert "ZeroDivisionError" in failure(Shy()).message
    assert failure(ValueError("a\ud800")).message == "a\\ud800"


def test_arguments_keep_their_order() -> None:
    assert [argument.name for argument in arguments([("b", 1), ("a", 2)])] == ["b", "a"]
