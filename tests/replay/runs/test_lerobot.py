"""Runs as a LeRobotDataset: read with pandas and `datasets`, it has the runs' numbers."""

from __future__ import annotations

import json
import os
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from replay.cli.main import main
from replay.restore.render import DrawnWorld
from tests.replay.documented import REPO
from tests.replay.runs.seeded import CABINET
from tests.smooth_motions import move

if TYPE_CHECKING:
    from pathlib import Path

DRAWER = "drawer_joint"
#: LeRobot needs another release of the viewer than PyCRAM: `make test-lerobot` sets up an environment of its own.
LEROBOT = REPO / ".venv-lerobot" / "bin" / "python"
#: Opens a data set as a training does; keeps the first and last frame of each episode, and a batch in any order.
READING = """
import sys
import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

folder, file = sys.argv[1:]
runs = LeRobotDataset("local/runs", root=folder, video_backend="pyav")
first = [runs[row["dataset_from_index"]] for row in runs.meta.episodes]
last = [runs[row["dataset_to_index"] - 1] for row in runs.meta.episodes]
second = LeRobotDataset("local/runs", root=folder, video_backend="pyav", episodes=[1], delta_timestamps={"action": [0, 1 / runs.fps]})
np.savez(
    file,
    counts=[len(runs), runs.num_episodes, len(second)],
    tasks=[each["task"] for each in last],
    states=torch.stack([each["observation.state"] for each in last]),
    begun=torch.stack([each["observation.images.camera"] for each in first]),
    pictures=torch.stack([each["observation.images.camera"] for each in last]),
    actions=second[0]["action"],
    batch=next(iter(torch.utils.data.DataLoader(runs, batch_size=4, shuffle=True)))["observation.images.camera"],
)
"""


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
@pytest.mark.needs("datasets")
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
@pytest.mark.needs("PyAV")
def test_videos_show_what_a_camera_sees(opened: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import av  # noqa: PLC0415  of an extra

    out = tmp_path / "set"
    assert main(["export", str(opened), "--to", "lerobot", str(out), "--images"]) == 2
    assert "the robot has no camera; name a frame of the robot" in capsys.readouterr().err
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
            scene = DrawnWorld(log, log.final_step())
            seen = np.asarray(scene.picture(camera="drawer", size=frames[0].shape[1::-1]).convert("RGB"), float)
        last = frames[first + row["length"] - 1]
        assert np.abs(last - seen).mean() < 3, "the last frame, but for what the codec loses"
        assert np.abs(last - frames[first]).mean() > 3, "the camera moves with the drawer"
    mean = json.loads((out / "meta" / "stats.json").read_text())["observation.images.camera"]["mean"]
    assert np.array(mean).ravel() == pytest.approx(np.mean(frames, axis=(0, 1, 2)) / 255, abs=0.02)


@pytest.mark.long
@pytest.mark.needs("PyAV")
@pytest.mark.skipif(not LEROBOT.exists(), reason="LeRobot isn't there: `make test-lerobot` installs it")
def test_lerobots_own_reader_gives_what_the_runs_had(opened: Path, tmp_path: Path) -> None:
    out, read = tmp_path / "set", tmp_path / "read.npz"
    assert main(["export", str(opened), "--to", "lerobot", str(out), "--images", "drawer"]) == 0
    alone = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "cache")}
    subprocess.run([LEROBOT, "-P", "-c", READING, out, read], env=os.environ | alone, check=True)
    info = json.loads((out / "meta" / "info.json").read_text())
    drawer = info["features"]["observation.state"]["names"].index(DRAWER)
    episodes = pd.read_parquet(out / "meta" / "episodes")
    given = np.load(read)
    assert given["counts"].tolist() == [info["total_frames"], 2, episodes["length"][1]]
    assert given["tasks"].tolist() == ["open", "open"]
    for name, state, picture in zip(episodes["run"], given["states"], given["pictures"], strict=True):
        with replay.open(opened / name) as log:
            final = log.state_at(log.final_step()).world("lab").body("cabinet")
            assert state[drawer] == pytest.approx(final.joint(DRAWER), abs=2e-5)
            scene = DrawnWorld(log, log.final_step())
            seen = np.asarray(scene.picture(camera="drawer", size=picture.shape[:0:-1]).convert("RGB"), float)
        assert np.abs(picture.transpose(1, 2, 0) * 255 - seen).mean() < 3, "but for what the codec loses"
    first, second = given["begun"] * 255
    assert np.abs(first - second).mean() < 3, "all begin with the drawer closed"
    assert np.abs(given["pictures"] * 255 - first).mean((1, 2, 3)).min() > 3, "the camera moves with the drawer"
    frames = pd.read_parquet(out / "data").query("episode_index == 1")
    assert given["actions"] == pytest.approx(np.stack(frames["action"][:2]))
    assert given["batch"].shape == (4, 3, *info["features"]["observation.images.camera"]["shape"][:2])
