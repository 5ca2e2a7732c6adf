"""What somebody dragged by hand: ``blame`` says so, ``verify`` goes on from what is recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.physics.engine import Engine
from recorder.records import Mutation
from replay.cli.main import main
from replay.errors import NotRestored
from replay.restore.verify import verify

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pycram.physics.body import LoadedBody


class Mouse:
    """A mouse that pushes a body while it is down, as that of PyBullet's window does."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.body: LoadedBody | None = None
        step = Engine.step

        def pushed(engine: Engine, steps: int) -> None:
            if self.body is not None:
                engine.set_velocity(self.body, [0.5, 0, 0, 0, 0, 0])
            step(engine, steps)

        def dragged(_: Engine, bodies: Iterable[LoadedBody]) -> list[tuple[LoadedBody, str]]:
            return [(body, "milk") for body in bodies if body is self.body]

        monkeypatch.setattr(Engine, "step", pushed)
        monkeypatch.setattr(Engine, "dragged", dragged)


@pytest.fixture
def dragged_log(tmp_path: Path) -> Path:
    """Milk that was dragged over the floor, and moved on by its plan."""
    file = tmp_path / "x.mcap"
    with pytest.MonkeyPatch.context() as patched:
        mouse = Mouse(patched)
        with recorder.record(file), BulletWorld(name="lab") as world:
            world.set_gravity([0, 0, -9.8])
            Object("floor", "environment", "plane.urdf")
            cup = Object("cup", "cup", "cup.stl", [2, 0, 0.05])
            milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
            world.simulate(0.2)
            mouse.body = milk.handle
            world.simulate(0.5)
            mouse.body = None
            world.simulate(0.5)
            cup.set_position([3, 0, 0.05])
    return file


def test_blame_and_log_say_that_it_was_dragged(dragged_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(dragged_log) as log:
        step = next(record.seq for record in log.records(Mutation) if record.drags)
        assert log[step].drags[0].link == "milk"
        change = log.blame("milk", step)
        assert (change.how, change.record.seq) == ("hand", step)
        assert log.blame("cup", step).how != "hand"
        assert log.blame("milk").how == "physics"  # it came to rest
    assert main(["blame", str(dragged_log), "milk", "--at", str(step)]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("milk was dragged by hand in the window: by ")
    assert "simulate 120 steps, while milk was dragged by hand" in shown


def test_verify_does_not_call_it_a_divergence(dragged_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(dragged_log) as log:
        found = verify(log)
        assert found.sound
        assert not found.exact
        assert found.dragged == ("lab",)
        assert not found.late
        step = next(record.seq for record in log.records(Mutation) if record.drags)
        with pytest.raises(NotRestored, match=rf"milk was dragged by hand at step {step}"):
            log.world_at(step + 1, exact=True)
        with log.world_at(step - 1, exact=True) as world:
            assert world.get_object("milk")
    assert main(["verify", str(dragged_log)]) == 0
    assert "in lab, somebody dragged an object by hand" in capsys.readouterr().out


def test_a_command_after_it_is_still_compared(dragged_log: Path, tmp_path: Path) -> None:
    from tests.replay.restore.test_verify import rewritten  # noqa: PLC0415

    def wrong(record: recorder.records.Record) -> recorder.records.Record:
        if isinstance(record, Mutation) and record.move_body.body == "cup":
            record.effect.bodies[0].position[0] += 0.01
        return record

    with replay.open(rewritten(dragged_log, tmp_path / "y.mcap", wrong)) as log:
        problem = verify(log).problem
        assert problem is not None
        assert "another effect" in problem.cause
