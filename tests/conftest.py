"""What many tests need: an empty world, a full scene, a journal that keeps records in memory, a screen."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.world.transaction import restore_snapshot, take_snapshot
from recorder.tracing import journal
from tests import measures, needs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from recorder.records import Record
    from recorder.records.values import AssetFile

REPO = Path(__file__).parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    measures.pytest_addoption(parser)


def pytest_configure(config: pytest.Config) -> None:
    # A shell ignores SIGINT for what it starts in the background, and processes inherit that.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ["PYCRAM_CACHE"] = ""  # the user's folder stays as it is
    config.pluginmanager.register(needs)
    measures.pytest_configure(config)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # no worker is to begin with what takes long when the others are done
    items.sort(key=lambda item: not {"viewer", "tutorial", "test_pages.py"}.intersection(item.path.parts))


def pytest_collection_finish() -> None:
    """Thousands of tests are no garbage: whoever collects it later, here or in a fork, doesn't look through them."""
    gc.collect()
    gc.freeze()


def pytest_runtest_call(item: pytest.Item) -> None:
    """A module's worlds are open at once, whichever was opened last: a test's own is the current one."""
    given = item.funcargs.values() if isinstance(item, pytest.Function) else ()
    own = [
        each if isinstance(each, BulletWorld) else each.world
        for each in given
        if isinstance(each, BulletWorld | Object)
    ]
    if own and BulletWorld.current_bullet_world not in own:
        BulletWorld.current_bullet_world = own[0]


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers of this run have."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session", autouse=True)
def converted_meshes(shared_folder: Path) -> None:
    """What one process of a run has converted, the others find."""
    os.environ["PYCRAM_CACHE"] = str(shared_folder / "converted meshes")


class DemoRun(NamedTuple):
    """What has come of a demo that was run in a folder of its own."""

    folder: Path
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def demo_run(shared_folder: Path) -> Callable[[str], DemoRun]:
    """Runs a demo by its command, once in a run of the tests."""

    def run(name: str) -> DemoRun:
        folder, ended = shared_folder / name, shared_folder / f"{name}.json"
        with (shared_folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not ended.exists():
                folder.mkdir()
                process = subprocess.run(
                    [sys.executable, "-m", "pycram", "demo", *([] if name == "set_the_table" else [name])],
                    cwd=folder,
                    capture_output=True,
                    text=True,
                    check=False,
                    timeout=300,
                    env={"PYTHONPATH": str(REPO), "PATH": "/usr/bin:/bin", "PYCRAM_CACHE": os.environ["PYCRAM_CACHE"]},
                )
                ended.write_text(json.dumps([process.returncode, process.stdout, process.stderr]))
        return DemoRun(folder, *json.loads(ended.read_text()))

    return run


@pytest.fixture(scope="session")
def recorded_demo(
    demo_run: Callable[[str], DemoRun], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """Gives a copy of a demo's recording, which is made once in a run."""

    def recorded(name: str) -> Path:
        made = demo_run(name).folder / f"{name}.mcap"
        return shutil.copy(made, tmp_path_factory.mktemp(name) / made.name)

    return recorded


class MemorySink:
    """Keeps copies of all records and assets."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.assets: dict[str, AssetFile] = {}
        self.closed = False

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.records.append(type(record).FromString(payload))

    def attach(self, asset: AssetFile) -> None:
        self.assets[asset.key] = asset

    def flush(self) -> None: ...

    def close(self) -> None:
        self.closed = True

    def of(self, kind: type) -> list[Record]:
        return [record for record in self.records if isinstance(record, kind)]


def furnish(world: BulletWorld) -> None:
    """Fills a world with the thesis' scene: a PR2 with parked arms before the counter, food, a spoon in its drawer."""
    Object("floor", "environment", "plane.urdf", world=world)
    robot = Object("pr2", "robot", "pr2.urdf", world=world)
    Object("kitchen", "environment", "kitchen.urdf", world=world)
    Object("milk", "milk", "milk.stl", [1.3, 1, 0.947], world=world)
    Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 0.8835], world=world)
    Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 0.962], world=world)
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.7136], world=world)
    world.set_robot(robot)
    description = robot.description
    assert description is not None
    for arm in description.arms.values():
        robot.set_joint_positions(arm.posture("park"))
    robot.set_joint_position("torso_lift_joint", 0.2)
    robot.set_position([0.65, 0.7, 0])
    world.simulate(0.05)  # they stand already


@pytest.fixture
def sink() -> Iterator[MemorySink]:
    """Everything that happens in the test is recorded into it."""
    memory = MemorySink()
    log = journal.Journal([memory])
    journal.open_journal(log)
    yield memory
    journal.close_journal(log)


@pytest.fixture
def world() -> Iterator[BulletWorld]:
    """An empty world with gravity."""
    with BulletWorld() as made:
        made.set_gravity([0, 0, -9.8])
        yield made


@pytest.fixture
def scene(world: BulletWorld) -> BulletWorld:
    """The scene of :func:`furnish`, for one test."""
    furnish(world)
    return world


@pytest.fixture(scope="module")
def built() -> Iterator[BulletWorld]:
    """The scene of :func:`furnish`, for a module."""
    with BulletWorld() as made:
        made.set_gravity([0, 0, -9.8])
        furnish(made)
        yield made


@pytest.fixture
def shared_scene(built: BulletWorld) -> Iterator[BulletWorld]:
    """The module's scene; what a test has moved, attached or added is undone."""
    before = {body: take_snapshot(body) for body in built.objects}
    yield built
    for body in built.objects:
        body.detach_all()
    for body in list(built.objects):
        if body not in before:
            body.remove()
    for body, state in before.items():
        if take_snapshot(body) != state:
            restore_snapshot(body, state)


@pytest.fixture
def display() -> Iterator[str]:
    """The name of a screen that is started for the test."""
    needs.need("Xvfb")
    reading, writing = os.pipe()
    # without noreset it starts anew whenever its last client leaves, and refuses others meanwhile
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1024x768x24", "-nolisten", "tcp", "-noreset"]
    with (
        os.fdopen(reading) as answer,
        subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server,
    ):
        os.close(writing)
        number = answer.readline().strip()  # it says so when it is ready
        try:
            assert number, "Xvfb didn't start"
            yield f":{number}"
        finally:
            server.terminate()
