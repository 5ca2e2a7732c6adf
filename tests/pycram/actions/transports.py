"""One transport to the island, three ways, looked at from outside; and the processor time that went into thinking."""

from __future__ import annotations

import os
import resource
import signal
import time
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal
from unittest.mock import patch

from pycram.actions import perform, projecting
from pycram.designator import ActionDesignator, LocationDesignator
from pycram.failures import PlanFailure
from pycram.process_module import ProcessModule
from tests.pycram.actions import fixed_poses
from tests.random_kitchens import build, draw, stands_on_island

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

    from tests.random_kitchens import Scene

Mode = Literal["fixed", "unprojected", "projected"]
LIMIT: Final = 60  # s of the processor that a transport may take; one that takes longer has failed


@dataclass(frozen=True)
class Transport:
    """What came of a transport.

    Attributes:
        seed: of the kitchen.
        kind: of the thing.
        spot: where it was.
        problem: why it doesn't stand on the island; "" if it does.
        failure: of the plan; "" if it didn't fail.
        thinking: s of the processor that went into choosing: all but the motions. Imagined runs count as shared by the
            cores that they may use.
        acting: s of the processor that went into motions.
    """

    seed: int
    kind: str
    spot: str
    problem: str
    failure: str
    thinking: float
    acting: float

    @property
    def succeeded(self) -> bool:
        """Whether the thing stands on the island, whatever the plan says."""
        return not self.problem


class _TooLongError(PlanFailure):
    """The processor was busy for too long."""


def transport(seed: int, mode: Mode, robot: str = "pr2") -> Transport:
    """Carry the thing of a kitchen to the island."""
    scene = build(draw(seed), robot)
    with scene.world:
        failure = ""
        acting: list[float] = []
        began, others = time.process_time(), _of_children()
        try:
            with _limited(), _timed(acting):
                _carry(scene, mode)
        except PlanFailure as error:
            failure = f"{type(error).__name__}: {error}"
        spent = time.process_time() - began + (_of_children() - others) / len(os.sched_getaffinity(0))
        thing = scene.drawing.thing
        problem = stands_on_island(scene)
        return Transport(seed, thing.kind, thing.spot, problem, failure, spent - sum(acting), sum(acting))


def _carry(scene: Scene, mode: Mode) -> None:
    if mode == "fixed":
        fixed_poses.carry(scene)
        return
    with projecting() if mode == "projected" else nullcontext():
        target = LocationDesignator(on="island")
        perform(ActionDesignator(type="transporting", object=scene.thing, target=target))


def _of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def _timed(spent: list[float]) -> Iterator[None]:
    """Write down how long each motion is carried out."""
    execute = ProcessModule.execute

    def timed(module: ProcessModule, designator: object) -> object:
        began = time.process_time()
        try:
            return execute(module, designator)
        finally:
            spent.append(time.process_time() - began)

    with patch.object(ProcessModule, "execute", timed):
        yield


@contextmanager
def _limited() -> Iterator[None]:
    def stop(_: int, __: FrameType | None) -> None:
        raise _TooLongError(f"it took more than {LIMIT} s of the processor")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
