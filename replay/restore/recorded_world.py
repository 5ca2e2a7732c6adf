"""A recorded world for restoring or drawing, without the physics engine: its state, models and robot descriptions."""

from __future__ import annotations

from functools import cache
from pathlib import PurePath
from typing import TYPE_CHECKING

from pycram.foundation.failures import AssetError
from pycram.models import load
from pycram.models.load import Model
from pycram.models.robots.description import RobotDescription
from pycram.physics.loading import Loading
from recorder.records import LoadBody
from replay.errors import Damaged, NotRestored
from replay.state.fold import last_open_step, state_at
from replay.state.state import World

if TYPE_CHECKING:
    from pycram.reasoning.queries.measured import ContactClient
    from replay.file.record_reader import RecordReader


def world_state(log: RecordReader, step: int, name: str | None = None, moment: float | None = None) -> World:
    """Return the state of an open world after a step, by default the last opened world.

    ``moment`` is a simulated time in s within the next record (:func:`replay.state.fold.state_at`).

    Raises:
        NotRestored: No such world is open at the step.
        NoSuchName: The recording has no world of this name.
        Damaged: Lost records may have changed the world.
    """
    state = state_at(log, step, moment)
    if name is None and not any(world.open for world in state.worlds.values()):
        closed = ", ".join(state.worlds)
        hint = (
            f" any more ({closed}); take {last_open_step(log, step)} or an earlier step"
            if closed
            else " yet; take a later step"
        )
        raise NotRestored(step, f"no world is open{hint}")
    world = state.world(name)
    if not world.open:
        raise NotRestored(step, f"{world.name} has ended before this step; take an earlier step")
    if state.uncertainty:
        raise Damaged(log.path, f"the world after step {step}", state.uncertainty)
    return world


def model_of(log: RecordReader, loaded: LoadBody) -> Model:
    """Return the model of a body as files in a temporary folder; raise Damaged if a file is missing or invalid."""
    names = [f"{asset.sha256}/{asset.path.rpartition('/')[2]}" for asset in loaded.assets]
    if not names:
        raise Damaged(log.path, f"the loading of {loaded.body}", "it names no files")
    missing = next((name for name in names if name not in log.assets), None)
    if missing is not None:
        raise Damaged(log.path, f"the attached file {missing}", "it is missing")
    files = [(name, log.assets[name]) for name in names]
    try:
        return load.restore(files, Loading.of(loaded))
    except AssetError as error:
        cause = f"{PurePath(error.path).name}: {error.cause}"
        raise Damaged(log.path, f"the model of {loaded.body}", cause) from error


def contacts_of(log: RecordReader) -> ContactClient:
    """Return a client that measures contacts in recorded states with the engine."""
    from pycram.reasoning.queries.measured import ContactClient  # noqa: PLC0415  imported here: drawing needs no engine

    return ContactClient(lambda _, loaded: model_of(log, loaded))


@cache
def description_of(text: str) -> RobotDescription | None:
    """Return the robot description of a recorded TOML text; None for "", which stands for other bodies."""
    return RobotDescription.parse(text, "the recording's robot description") if text else None
