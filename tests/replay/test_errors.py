"""Errors of recording and reading survive the way to another process, with their message and their data."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from recorder.errors import PortableError, RecordingError
from recorder.properties import BadProperty
from replay.debug.guided_plan import PlanEnded, PlanInterrupted
from replay.debug.session import NoFurther, NoQuantity, NoSuchPlace
from replay.errors import (
    Damaged,
    LogClosed,
    MissingModels,
    NoSuchName,
    NoSuchStep,
    NotALog,
    NotRestored,
    ReplayError,
    Unreadable,
)
from replay.fix.trials import PlanHasEffects
from replay.report.question import BadQuestion
from replay.retrace.decisions import BadChange
from replay.retrace.fork import NotForked
from replay.retrace.plan_process import CantRetrace, FirstDifference
from replay.runs.folder import NotRead, Refused

if TYPE_CHECKING:
    from collections.abc import Iterator

ERRORS: tuple[PortableError, ...] = (
    RecordingError("/no/where.mcap", "no such folder", "make it"),
    ReplayError("a picture can't have 0 x 0 pixels"),
    NotALog("notes.txt", "isn't an MCAP file"),
    Unreadable("run.mcap", "is empty"),
    Damaged("run.mcap", "step 12", "its checksum differs"),
    LogClosed("run.mcap"),
    NoSuchStep(99, 12),
    NoSuchName("object", "milc", ["milk", "cup"]),
    NotRestored(3, "no world is open then"),
    BadQuestion("stable(", "it can't be read"),
    CantRetrace("plan.py: the plan isn't there"),
    BadChange("stable(milk)=maybe", "its answer is true or false"),
    PlanHasEffects("os.mkdir '/srv/out'"),
    NotForked(12, FirstDifference(7, "the plan ended where step 7 has pressed", "plan.py:3")),
    NoSuchPlace("pick", "there is no such step or task"),
    PlanEnded("Killed"),
    PlanInterrupted(12),
    NoQuantity("milc.z", "no body is called so"),
    BadProperty("always milk.z >", "invalid syntax", "table.properties:3"),
    NoFurther(0, "the recording begins here"),
    MissingModels("00003.mcap", "models-0123456789ab.mcap isn't there"),
    NotRead(Path("runs"), "its tables can't be written (Permission denied)"),
    Refused("drop table runs", "it isn't one that only reads"),
)


def classes(base: type[PortableError]) -> Iterator[type[PortableError]]:
    for kind in base.__subclasses__():
        yield kind
        yield from classes(kind)


def test_every_error_class_is_tried_here() -> None:
    own = {kind for kind in classes(PortableError) if kind.__module__.startswith(("recorder.", "replay."))}
    assert own == {type(error) for error in ERRORS}


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("portable", [lambda error: pickle.loads(pickle.dumps(error)), copy.copy])
def test_errors_pickle_and_copy_with_message_and_data(error: PortableError, portable) -> None:
    again = portable(error)
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert again.args == error.args
    assert vars(again) == vars(error)
