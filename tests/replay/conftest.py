"""Recordings of the demos, made once."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld
from pycram.bullet_world_reasoning import ReasoningError
from pycram.world.world import open_worlds
from tests.conftest import furnish

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from replay.recording import Recording

GOLDEN = Path(__file__).parent / "golden"


@pytest.fixture
def nothing_left() -> Iterator[None]:
    """No world stays open."""
    yield
    assert not open_worlds()


@pytest.fixture(scope="session")
def demo_log(recorded_demo: Callable[[str], Path]) -> Path:
    return recorded_demo("set_the_table")


@pytest.fixture(scope="session")
def failed_log(recorded_demo: Callable[[str], Path]) -> Path:
    return recorded_demo("fails_to_reach")


@pytest.fixture(scope="session")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small plan's recording: two tasks that failed, and a run that did."""
    file = tmp_path_factory.mktemp("small") / "plan.mcap"
    with pytest.raises(ReasoningError), recorder.record(file, name="plan", source=GOLDEN / "plan.py"):
        runpy.run_path(str(GOLDEN / "plan.py"), run_name="__main__")
    BulletWorld.current_bullet_world.exit()  # after the recording: the plan left it open
    return file


@pytest.fixture(scope="session")
def scene_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The thesis' scene, and the robot looking at the milk."""
    file = tmp_path_factory.mktemp("scene") / "scene.mcap"
    with recorder.record(file), BulletWorld(name="kitchen") as world:
        furnish(world)
        world.robot.set_joint_positions({"head_pan_joint": 0.4, "head_tilt_joint": 0.5})
        btr.visible(world.get_object("milk"), "wide_stereo_optical_frame")
    return file


@pytest.fixture
def small(small_log: Path) -> Iterator[Recording]:
    with replay.open(small_log) as log:
        yield log


@pytest.fixture
def failed(failed_log: Path) -> Iterator[Recording]:
    with replay.open(failed_log) as log:
        yield log
