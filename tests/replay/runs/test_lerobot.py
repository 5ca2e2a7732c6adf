"""Runs as a LeRobotDataset: read with pandas and `datasets`, it has the runs' numbers."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from replay.cli.main import main
from replay.restore.render import Scene
from tests.replay.runs.seeded import CABINET
from tests.smooth_motions import move

if TYPE_CHECKING:
    from pathlib import Path

DRAWER = "drawer_joint"


@pytest.fixture
def opened(tmp_path: Path) -> Path:
    """Two runs in which a drawer opens in 0.5 s."""
    folder = tmp_path / "runs"
    folder.mkdir()
    for number, goal in enumerate((0.1, 0.2)):
        with recorder.record(folder / f"{number}.mcap", name="open"), BulletWorld(name="lab") as world:
            Object("cup", "cup", "cup.stl", [1, 0, 1.6])
            world.set_robot(cabinet := Object("cabinet", "robot", CABINET, [1, 0, 1]))
            world.simulate(0.1)
            move(cabinet, {DRAWER: goal}, 0.5)
    return folder


@pytest.mark.slow
def test_frames_are_where_the_robot_was(opened: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert main(["export", str(opened), "--to", "lerobot", str(out)]) == 0
    info = json.loads((out / "meta" / "info.json").read_text())
    names = info["features"]["observation.state"]["names"]
    frames = pd.read_parquet(out / "data")
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 30, 2)
    assert len(frames) == info["total_frames"]
    assert pd.read_parquet(out / "meta" / "tasks.parquet").index.tolist() == ["open"]
    episodes = pd.read_parquet(out / "meta" / "episodes")
    for number, row in episodes.iterrows():
        of = frames.iloc[row["dataset_from_index"] : row["dataset_to_index"]]
        assert set(of["episode_index"]) == {number}
        drawer = [state[names.index(DRAWER)] for state in of["observation.state"]]
        with replay.open(opened / row["run"]) as log:
            for at, step in ((8, f"{8 / 30 + 1e-4:.4f}s"), (len(of) - 1, log.final_step())):
                state = log.state_at(step).world("lab").body("cabinet")
                assert drawer[at] == pytest.approx(state.joint(DRAWER), abs=2e-5)
        assert [a[names.index(DRAWER)] for a in of["action"]][:-1] == drawer[1:]
        assert of["next.done"].tolist() == [False] * (len(of) - 1) + [True]
    assert main(["export", str(opened), "--to", "lerobot", str(out)]) == 2, "nothing is overwritten"


@pytest.mark.long
def test_the_library_reads_it(opened: Path, tmp_path: Path) -> None:
    import datasets  # noqa: PLC0415  takes seconds

    out = tmp_path / "set"
    assert main(["export", str(opened), "--to", "lerobot", str(out)]) == 0
    read = datasets.load_dataset(
        "parquet", data_dir=str(out / "data"), split="train", cache_dir=str(tmp_path / "cache")
    )
    assert len(read) == json.loads((out / "meta" / "info.json").read_text())["total_frames"]
    assert {"observation.state", "action", "timestamp", "episode_index"} <= set(read.features)


@pytest.mark.long
def test_videos_show_what_a_camera_sees(opened: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import av  # noqa: PLC0415  of an extra

    out = tmp_path / "set"
    assert main(["export", str(opened), "--to", "lerobot", str(out), "--images"]) == 2
    assert "the robot has no camera; name one of its frames" in capsys.readouterr().err
    assert not out.exists()
    assert main(["export", str(opened), "--to", "lerobot", str(out), "--images", "drawer"]) == 0
    info = json.loads((out / "meta" / "info.json").read_text())
    feature = info["features"]["observation.images.camera"]
    episodes = pd.read_parquet(out / "meta" / "episodes")
    path = info["video_path"].format(video_key="observation.images.camera", chunk_index=0, file_index=0)
    with av.open(str(out / path)) as video:
        stream = video.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24").astype(float) for frame in video.decode(stream)]
        assert (stream.codec_context.name, stream.average_rate) == ("libdav1d", info["fps"])
    assert list(frames[0].shape) == feature["shape"]
    assert len(frames) == info["total_frames"]
    for _, row in episodes.iterrows():
        first = round(row["videos/observation.images.camera/from_timestamp"] * info["fps"])
        assert first == row["dataset_from_index"]
        with replay.open(opened / row["run"]) as log:
            scene = Scene(log, log.final_step())
            seen = np.asarray(scene.picture(camera="drawer", size=frames[0].shape[1::-1]).convert("RGB"), float)
        last = frames[first + row["length"] - 1]
        assert np.abs(last - seen).mean() < 3, "the last frame, but for what the codec loses"
        assert np.abs(last - frames[first]).mean() > 3, "the camera moves with the drawer"
    mean = json.loads((out / "meta" / "stats.json").read_text())["observation.images.camera"]["mean"]
    assert np.array(mean).ravel() == pytest.approx(np.mean(frames, axis=(0, 1, 2)) / 255, abs=0.02)
