"""The viewer's file: when it is kept, and which errors are reported if it is missing or incomplete."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder.mcap_sink import McapSink
from recorder.records import TOPICS, Task
from recorder.records.values import AssetFile
from replay.cli.main import main
from replay.errors import ReplayError
from tests.recorder.viewer.shown import Shown, in_front, small, view

REPO = Path(__file__).parents[3]


@pytest.fixture
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder for caches."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("PYCRAM_CACHE", str(folder))
    return folder


@pytest.mark.usefixtures("cache")
def test_a_file_for_the_viewer_is_kept_for_its_recording_alone(tmp_path: Path) -> None:
    from replay.view import cached  # noqa: PLC0415

    log = small(tmp_path / "log.mcap")
    with replay.open(log) as recording:
        kept = cached(recording)
        assert kept == tmp_path / "log.mcap.rrd"
        made = kept.stat().st_mtime_ns
        assert cached(recording).stat().st_mtime_ns == made
    assert [file.name for file in sorted(tmp_path.iterdir())] == ["log.mcap", "log.mcap.rrd"]
    with recorder.record(log, overwrite=True), BulletWorld(name="w"):
        Object("milk", "milk", "milk.stl", [1, 0, 1])
    os.utime(log, ns=(made - 10**12, made - 10**12))  # another run, of which the date says that it is older
    with replay.open(log) as recording:
        rows = Shown(cached(recording)).rows
    assert "/w/bodies/milk" in rows
    assert "/w/bodies/cup" not in rows


@pytest.mark.slow
@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("planted", ["another's", "changed"])
def test_a_file_that_this_user_has_not_made_is_not_shown(tmp_path: Path, planted: str) -> None:
    from replay.view import cached  # noqa: PLC0415

    log, other = small(tmp_path / "log.mcap"), tmp_path / "other.mcap"
    with recorder.record(other), BulletWorld(name="w"):
        Object("milk", "milk", "milk.stl", [1, 0, 1])
    beside = tmp_path / "log.mcap.rrd"
    with replay.open(log) as recording, replay.open(other) as stranger:
        content = cached(recording).read_bytes()
        beside.write_bytes(cached(stranger).read_bytes() if planted == "another's" else content[:-1] + b"x")
        rows = Shown(cached(recording)).rows
    assert "/w/bodies/cup" in rows
    assert "/w/bodies/milk" not in rows


def test_a_file_of_an_earlier_release_of_the_software_is_not_kept(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from replay import view as rrd  # noqa: PLC0415

    with replay.open(small(tmp_path / "log.mcap")) as recording:
        made = rrd.cached(recording).stat().st_mtime_ns
        monkeypatch.setattr(rrd.rr, "__version__", "0.1.0")
        assert rrd.cached(recording).stat().st_mtime_ns > made
    assert len(list((cache / "rrd").iterdir())) == 2


@pytest.mark.parametrize("whose", ["somebody else's", "everybody's", "a link"])
def test_a_temporary_folder_that_others_can_write_into_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    from replay.view import temporary_file  # noqa: PLC0415

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    user = 12345
    folder = tmp_path / f"pycram-{user}"
    if whose == "a link":
        (tmp_path / "theirs").mkdir()
        folder.symlink_to(tmp_path / "theirs")
    else:
        folder.mkdir()
    if whose == "everybody's":
        folder.chmod(0o777)
    elif os.getuid() == 0:  # root's is trusted
        os.chown(folder, 54321, -1, follow_symlinks=False)
    monkeypatch.setattr(os, "getuid", lambda: user)
    with pytest.raises(ReplayError, match=f"pycram-{user} isn't yours alone: .* set TMPDIR"):
        temporary_file("x.rrd")


@pytest.mark.costly
def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    log = small(tmp_path / "log.mcap")
    for words in ([], ["--save", "log.rrd"]):
        command = [sys.executable, "-m", "replay", "view", str(log), *words]
        process = subprocess.run(
            ["bash", "-c", 'ulimit -f 8 && exec "$@"', "bash", *command],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": str(REPO)},
        )
        assert process.returncode == 2
        assert "log.rrd: can't be written" in process.stderr.replace(".mcap", "")
        assert "Traceback" not in process.stderr
    assert [*tmp_path.iterdir()] == [log], "nothing that is half there is kept"


def test_view_works_where_the_environment_switches_viewers_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    file = tmp_path / "log.rrd"
    assert "/w/bodies/cup" in view(small(tmp_path / "log.mcap"), file).rows
    assert "w" in in_front(file)
    assert os.environ["RERUN"] == "off"


def test_users_of_one_recording_have_temporary_files_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from replay import view as rrd  # noqa: PLC0415

    monkeypatch.setattr(rrd, "is_own", lambda _: True)  # users are names only here
    log, temporary = small(tmp_path / "log.mcap"), tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setattr(os, "access", lambda *_: False)  # the recording lies where nobody may write
    made = set()
    for user in (1, 2):
        monkeypatch.setattr(os, "getuid", lambda user=user: user)
        with replay.open(log) as recording:
            file = rrd.cached(recording)
        assert file.stat().st_size
        assert file.parent.parent == temporary
        assert file.parent.stat().st_mode & 0o777 == 0o700
        made.add(file)
    assert len(made) == 2


def test_a_file_for_the_viewer_that_was_made_of_half_a_recording_is_not_kept(tmp_path: Path) -> None:
    from replay.view import cached  # noqa: PLC0415

    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w"):
        Object("milk", "milk", "milk.stl", [1, 0, 1])  # its model goes to the file at once, and what was before
        half = replay.open(log)
        Object("cup", "cup", "cup.stl", [0, 0, 1])
    os.utime(log, ns=(half.written_ns + 10**7, half.written_ns + 10**7))  # however coarse the clock is
    with half:
        assert "/w/bodies/cup" not in Shown(cached(half)).rows, "the plan ended after it had been opened"
    with replay.open(log) as recording:
        assert "/w/bodies/cup" in Shown(cached(recording)).rows


def test_an_invalid_model_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, file = tmp_path / "log.mcap", tmp_path / "log.rrd"
    sink = McapSink(log, {})
    sink._frames.add_urdf = lambda *_: None  # it would refuse
    sink.attach(AssetFile("cup.urdf", b"no model"))
    sink.write("/task", Task(), b"")
    sink.close()
    assert main(["view", str(log), "--save", str(file)]) == 3
    assert "cup.urdf is damaged: the content is inconsistent" in capsys.readouterr().err


def test_missing_models_are_reported_each_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from replay.view import cached  # noqa: PLC0415

    complete, log = small(tmp_path / "complete.mcap"), tmp_path / "log.mcap"
    sink = McapSink(log, {})
    with replay.open(complete) as recording:
        for record in recording:
            sink.write(TOPICS[type(record)], record, record.SerializeToString())
    sink.close()
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd")]) == 3
    assert "/cup.urdf is damaged (it isn't there)" in capsys.readouterr().err
    for _ in range(2):
        with replay.open(log) as recording:
            cached(recording)
            assert "cup.urdf" in recording.problems, "said again, although it was translated before"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--save", "there.png"], "opens .rrd files only"),
        (["--save", "no/such/folder/x.rrd"], "can't be written"),
        (["--at", "99999", "--save", "x.rrd"], "no step"),
        (["--web", "--save", "x.rrd"], "it can't be combined"),
        (["--connect", "rerun+http://127.0.0.1:1/proxy"], "no viewer answers"),
        (["--connect", "somewhere"], "isn't the address of a viewer"),
        (["--connect", "spawn"], "isn't the address of a viewer"),
        (["--connect", "connect"], "isn't the address of a viewer"),
        (["--save", ""], "opens .rrd files only"),
        (["missing.mcap", "--save", "x.rrd"], "No such file"),
    ],
)
def test_wrong_usage_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    small(tmp_path / "log.mcap")
    assert main(["view", "log.mcap", *words]) == 2
    output = capsys.readouterr()
    assert said in output.err
    assert not output.out
    assert not list(tmp_path.glob("*.rrd"))


def test_a_truncated_recording_is_shown_as_far_as_it_goes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "log.mcap"
    with recorder.record(log), BulletWorld(name="w"):
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        for x in range(200):
            cup.set_position([x, 0, 1])
    log.write_bytes(log.read_bytes()[: -log.stat().st_size // 8])
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd"), "--json"]) == 3
    output = capsys.readouterr()
    assert json.loads(output.out) == {"file": str(tmp_path / "log.rrd")}
    assert "incomplete" in output.err
    assert len(Shown(tmp_path / "log.rrd").rows["/w/bodies/cup"]) > 50
