"""What users put into slots and results stands in records as JSON, whole."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import JointLimitError
from recorder.records import arguments, failure, to_json

scalars = st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False, allow_infinity=False)
values = st.recursive(
    scalars | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@given(values)
def test_plain_values_come_back_with_all_their_bits(value: object) -> None:
    text = to_json(value)
    assert json.loads(text) == value
    assert "\n" not in text


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=8))
def test_arrays_are_lists(numbers: list[float]) -> None:
    array = np.array(numbers)
    assert json.loads(to_json(array)) == json.loads(to_json(tuple(numbers))) == numbers
    for number in array:
        assert json.loads(to_json(number)) == number


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_what_json_cannot_say_is_still_json(number: float) -> None:
    told = json.loads(to_json([number]), parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    assert told == [{"float": repr(number)}]


def test_objects_functions_and_the_unknown() -> None:
    with BulletWorld() as world:
        cup = Object("cup", "cup", "cup.stl")
        assert json.loads(to_json({"object": cup})) == {"object": {"object": "cup", "world": world.name}}
    assert json.loads(to_json(math.sqrt)) == {"callable": "math.sqrt"}
    assert json.loads(to_json({3, 1})) == [1, 3]

    class Odd:
        def __repr__(self) -> str:
            return "<odd>"

    assert json.loads(to_json(Odd())) == {"repr": "<odd>"}


def test_whatever_a_plan_hands_over_recording_it_never_fails() -> None:
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


def test_failures_carry_their_data() -> None:
    with pytest.raises(JointLimitError) as caught:
        raise JointLimitError("pr2", "torso_lift_joint", 2.0, 0.0, 0.33)
    told = failure(caught.value)
    assert told.type == "JointLimitError"
    assert "test_failures_carry_their_data" in told.traceback
    data = {argument.name: json.loads(argument.json) for argument in told.data}
    assert data["joint"] == "torso_lift_joint"
    assert data["value"] == 2.0


def test_failures_that_can_t_be_told_are_recorded_all_the_same() -> None:
    class Shy(Exception):
        def __str__(self) -> str:
            raise ZeroDivisionError

    assert "ZeroDivisionError" in failure(Shy()).message
    assert failure(ValueError("a\ud800")).message == "a\\ud800"


def test_arguments_keep_their_order() -> None:
    assert [argument.name for argument in arguments([("b", 1), ("a", 2)])] == ["b", "a"]
