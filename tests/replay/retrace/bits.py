"""Compares recordings byte by byte, but for what clocks tell and a fork is named after."""

from __future__ import annotations

import json
from itertools import zip_longest
from typing import TYPE_CHECKING

import replay
from recorder.records import Run, Task

if TYPE_CHECKING:
    from pathlib import Path

    from google.protobuf.message import Message

    from recorder.records import Record

CLOCKS = ("wall_time_ns", "monotonic_ns", "duration_ns", "began_ns")


def bits(record: Record) -> bytes:
    """All of a record but what may differ where the same happens: see the module."""
    copy: Message = type(record).FromString(record.SerializeToString())
    for clock in CLOCKS:
        if clock in copy.DESCRIPTOR.fields_by_name:
            copy.ClearField(clock)
    if isinstance(copy, Run):
        copy.ClearField("origin")
    if isinstance(copy, Task) and "recording" in copy.result_json:
        copy.result_json = json.dumps(without_recordings(json.loads(copy.result_json)))
    return copy.SerializeToString(deterministic=True)


def without_recordings(result: object) -> object:
    """A task's result without the files of projections' recordings, which are named after the fork's."""
    if isinstance(result, dict):
        return {name: without_recordings(part) for name, part in result.items() if name != "recording"}
    return [without_recordings(part) for part in result] if isinstance(result, list) else result


def assert_same_bits(first: Path, second: Path) -> None:
    """Both have the same records in the same order, byte for byte."""
    with replay.open(first) as one, replay.open(second) as other:
        for a, b in zip_longest(one, other):
            assert a is not None, f"the second goes on with {b}"
            assert b is not None, f"the second lacks {a}"
            assert bits(a) == bits(b), f"step {a.seq}:\n{a}\n{b}"
        assert not other.problems
