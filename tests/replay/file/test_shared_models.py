"""Recordings of a sweep share a file of models: they are read, packed and repaired as others, and refused without it.

A recording may come from anybody: what it names is opened only in its own folder, by its hash, and never through a link.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from typing import TYPE_CHECKING

import pytest

import pycram
from recorder.mcap_writer import MODELS_METADATA
from replay.cli.main import main
from replay.errors import MissingModels
from replay.file.assets import SharedFile
from replay.recording import Recording
from replay.restore.verify import verify

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PLAN = """
import pycram
from pycram.bullet_world import BulletWorld, Object

given = pycram.parameters(also="")
world = BulletWorld()  # which stays open
Object("floor", "environment", "plane.urdf")
Object("cup", "cup", "cup.stl", [0, 0, 0.2])
if given.also:
    Object("other", "other", given.also, [1, 0, 0.2])
world.simulate(0.1)
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    plan = folder / "plan.py"
    plan.write_text(PLAN)
    result = pycram.sweep(plan, 3, folder / "runs", set={"also": ["", "", "milk.stl"]})
    assert result.failed == 0
    return folder / "runs"


@pytest.fixture
def folder(runs: Path, tmp_path: Path) -> Path:
    """A copy of the sweep's folder, which a test may change."""
    shutil.copytree(runs, tmp_path / "runs")
    return tmp_path / "runs"


def run(folder: Path, number: int = 1) -> Path:
    return next(folder.glob(f"{number:05}*.mcap"))


def models(folder: Path) -> Path:
    return next(folder.glob("models-*.mcap"))


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    code = main([str(word) for word in words])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def renamed(file: Path, name: str, sha256: str) -> None:
    """Have a recording name another file of models, as somebody else could have made it."""
    with Recording(file) as log, file.with_suffix(".new").open("wb") as new:
        log._index.metadata[MODELS_METADATA].update({"file": name, "sha256": sha256})
        log.assets.shared = SharedFile(file, log._index.metadata[MODELS_METADATA])
        log.write_sound(new)
    file.with_suffix(".new").replace(file)


@pytest.mark.slow
def test_models_are_in_one_file_beside_the_recordings(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = models(runs).read_bytes()
    assert models(runs).name == f"models-{hashlib.sha256(content).hexdigest()[:12]}.mcap"
    for number in (1, 2):
        with Recording(run(runs, number)) as log:
            assert log.assets.shared is not None
            assert len(log.assets) > 2
            assert log.complete
            assert verify(log).problem is None
        code, out, err = answer(capsys, "info", run(runs, number))
        assert (code, err) == (0, "")
        assert f"or in {models(runs).name} in the same folder" in out
    with Recording(run(runs, 2)) as log:  # what the first run didn't load is its own
        assert any(name.endswith("milk.stl") or "milk" in name for name in log._index.attachments)
        world = log.world_at(log.final_step())
        assert world.get_objects_by_type("other")
        world.exit()


@pytest.mark.slow
def test_a_recording_without_its_models_says_what_is_missing(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    name = models(folder).name
    models(folder).unlink()
    for words in (
        ["verify"],
        ["render", "last", "-o", tmp_path / "x.png"],
        ["info"],
        ["pack"],
        ["restore", "last", "--shell"],
    ):
        verb, *rest = words
        code, _, err = answer(capsys, verb, run(folder), *rest)
        assert code == 3, (words, err)
        assert f"{name}: No such file or directory" in err, words
    assert not list(folder.glob("*.whole.mcap"))
    for verb in ("log", "tree", "state"):  # what needs none
        assert answer(capsys, verb, run(folder), *(["last"] if verb == "state" else []))[0] == 0, verb


def digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _link(folder: Path) -> None:
    there = models(folder)
    there.rename(folder.parent / there.name)
    there.symlink_to(folder.parent / there.name)


def _other(folder: Path) -> None:
    content = models(folder).read_bytes()
    models(folder).write_bytes(content[:-1] + bytes([content[-1] ^ 1]))


def _pipe(folder: Path) -> None:
    there = models(folder)
    there.unlink()
    os.mkfifo(there)


def _folder(folder: Path) -> None:
    there = models(folder)
    there.unlink()
    there.mkdir()


def _elsewhere(folder: Path) -> None:
    there = models(folder)
    there.rename(folder.parent / there.name)
    renamed(run(folder), f"../{there.name}", digest(folder.parent / there.name))


def _absolute(folder: Path) -> None:
    there = models(folder)
    there.rename(folder.parent / there.name)
    renamed(run(folder), str(folder.parent / there.name), digest(folder.parent / there.name))


def _no_name(folder: Path) -> None:
    there = models(folder)
    there.rename(folder / "else.mcap")
    renamed(run(folder), "else.mcap", digest(folder / "else.mcap"))


def _empty(folder: Path) -> None:
    models(folder).unlink()
    renamed(run(folder), "", "")


def _zero(folder: Path) -> None:
    models(folder).unlink()
    renamed(run(folder), "models-\0.mcap", "\0")


@pytest.mark.slow
@pytest.mark.parametrize("change", [_link, _other, _pipe, _folder, _elsewhere, _absolute, _no_name, _empty, _zero])
def test_nothing_else_is_opened(
    folder: Path, change: Callable[[Path], None], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    change(folder)
    with Recording(run(folder)) as log, pytest.raises(MissingModels):
        log.render("last")
    code, _, err = answer(capsys, "verify", run(folder))
    assert code == 3
    assert "its models are missing" in err
    assert "Traceback" not in err
    assert "\0" not in err


@pytest.mark.slow
def test_a_packed_recording_goes_anywhere(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "elsewhere" / "whole.mcap"
    target.parent.mkdir()
    code, out, err = answer(capsys, "pack", run(folder, 2), "-o", target)
    assert (code, err) == (0, "")
    assert models(folder).name in out
    with Recording(run(folder, 2)) as log, Recording(target) as whole:
        assert whole.assets.shared is None
        assert {name: whole.assets[name] for name in whole.assets} == {name: log.assets[name] for name in log.assets}
        assert list(whole.records()) == list(log.records())
        assert verify(whole).problem is None
        assert not whole.metadata.get("pycram.repair.by")
        pixels = log.render("last").tobytes()
        assert whole.render("last").tobytes() == pixels
    code, _, err = answer(capsys, "pack", run(folder, 2), "-o", target)
    assert code == 2
    assert "exists; name another file" in err


@pytest.mark.slow
def test_a_damaged_recording_is_repaired_with_its_models(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = run(folder)
    cut.write_bytes(cut.read_bytes()[:-3000])
    code, _, err = answer(capsys, "pack", cut)
    assert code == 3
    assert "use repair" in err
    sound = tmp_path / "sound.mcap"
    answer(capsys, "repair", cut, "-o", sound)
    with Recording(sound) as log:
        assert log.assets.shared is None
        assert not log.assets.damaged
        log.render("last")


@pytest.mark.slow
def test_the_file_of_models_is_no_recording(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = answer(capsys, "info", models(runs))
    assert code == 2
    assert "contains the shared models of a sweep, and isn't a recording" in err


@pytest.mark.slow
def test_a_link_to_a_recording_is_followed_by_its_user(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = tmp_path / "latest.mcap"
    link.symlink_to(run(folder))
    assert answer(capsys, "verify", link)[0] == 0
