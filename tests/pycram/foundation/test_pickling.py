"""Failures are copied and pickled with what they say, so they come back whole from another process."""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass

import pytest

from pycram.actions import ActionFailed, Try
from pycram.designator import LocationDesignator
from pycram.failures import (
    BadArgument,
    BranchesFailed,
    NotCleanedUp,
    PlanFailure,
    PycramError,
    Unreachable,
    WorldClosed,
)
from pycram.fluent import NotSettable
from pycram.language.timeouts import TimedOut
from pycram.motions.resources import ResourceError, Resources
from pycram.process_module import NoProcessModule
from pycram.scheduling.schedule import LockHeld


@dataclass(eq=False)
class Slipped(PlanFailure):
    """A failure as a plan may define it."""

    distance: float


FAILURES = [
    PlanFailure("no"),
    Slipped(0.2),
    TimedOut(3, "simulated"),
    Unreachable("left", (1, 2, 3)),
    NotCleanedUp("park", Slipped(0.1)),
    BadArgument("seconds", -1, "a number from 0 up"),
    WorldClosed("world_1", "simulate"),
    NotSettable("battery", of_world=True),
    NoProcessModule("dance", "pr2", "simulated", ["looking"]),
    ResourceError("moving", Resources({"base"}), Resources({"head"})),
    LockHeld(),
    ActionFailed("fetching", [Try({"place": LocationDesignator(position=[1, 2, 0])}, Unreachable("left", (1, 2, 3)))]),
    BranchesFailed("par", [Slipped(0.2), Slipped(0.3)]),
    BranchesFailed("par", [TimedOut(1, "wall"), BranchesFailed("seq", [Slipped(0.2)])]),
]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
@pytest.mark.parametrize("again", [copy.copy, lambda failure: pickle.loads(pickle.dumps(failure))])
def test_a_failure_comes_back_whole(failure: PycramError, again: object) -> None:
    back = again(failure)
    assert type(back) is type(failure)
    assert str(back) == str(failure)
    assert repr(back.data) == repr(failure.data)
    with pytest.raises(type(failure)):
        raise back
