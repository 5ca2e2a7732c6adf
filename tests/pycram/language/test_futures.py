"""Futures stand for the results of branches in every operation."""

from __future__ import annotations

import copy
import os
import pickle
from contextlib import suppress
from pathlib import Path

import pytest

from pycram.failures import PlanFailure, Unreachable
from pycram.language import par, pursue
from pycram.language.branch import NoResult
from tests.pycram.language.gates import Gate, fails, succeeds


def test_futures_are_their_results() -> None:
    gate = Gate()
    with par as s:
        future = s(lambda: gate.pass_through() and [3, 1, 2])
        gate.open()
        assert sorted(future) == [1, 2, 3]
    assert future == [3, 1, 2]
    assert isinstance(future, list)
    assert future + [0] == [3, 1, 2, 0]  # noqa: RUF005  the future's own operator
    with par as s:
        number = s(succeeds, 7)
    assert (number + 1, 10 - number, -number, number % 4, range(9)[number]) == (8, 3, -7, 3, 7)
    with suppress(PlanFailure), par as s:
        failed = s(fails)
    with pytest.raises(Unreachable):
        failed.arm  # noqa: B018
    with pursue as s:
        cancelled = s(Gate().pass_through)
        s(succeeds)
    with pytest.raises(NoResult, match="was cancelled"):
        bool(cancelled)


def test_futures_are_formatted_rounded_changed_and_copied_as_their_results() -> None:
    with par as s:
        number = s(lambda: 3.14159)
        table = s(lambda: {"a": [1]})
    assert f"{number:.2f} {round(number, 1)} {round(number)}" == "3.14 3.1 3"
    table["b"] = 2
    del table["a"]
    assert table.result() == {"b": 2}
    assert copy.copy(table) == copy.deepcopy(table) == {"b": 2}
    assert type(copy.copy(table)) is dict


def test_operations_on_a_future_apply_to_its_result(tmp_path: Path) -> None:
    file = tmp_path / "x"
    file.write_text("text")
    with par as s:
        seven, names, path = s(lambda: 7), s(lambda: ["a", "b"]), s(lambda: file)
        opened, letters = s(file.open), s(lambda: iter("ab"))
    assert (divmod(seven, 2), divmod(15, seven), seven << 1, 1 << seven, ~seven, +seven) == (
        (3, 1),
        (2, 1),
        14,
        128,
        -8,
        7,
    )
    assert [*reversed(names)] == ["b", "a"]
    assert Path(path).read_text() == Path(os.path.join(path, "")[:-1]).read_text() == "text"  # noqa: PTH118
    with opened as stream:
        assert stream.read() == "text"
    assert opened.closed
    assert (next(letters), next(letters)) == ("a", "b")
    assert type(pickle.loads(pickle.dumps(names))) is list
