"""The videos of a LeRobotDataset v3.0: the view of a robot's camera in each run, drawn from its recording.

Episodes follow one another in AV1 files (MP4), at the frame rate of the data set. Every second frame is a key frame,
because training reads single frames. A frame is drawn only if the world has changed since the last frame.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from recorder.packages import needed
from replay.file.record_reader import RecordReader
from replay.runs.lerobot import FILES, FPS, QUANTILES, VIDEO, VIDEO_PATH, VIDEO_SIZE

with needed("video"):
    import av

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType
    from typing import Self

    from av.container import OutputContainer
    from av.video.stream import VideoStream
    from numpy.typing import NDArray

    from replay.runs.folder import Runs
    from replay.runs.lerobot import Draw

_SIZE: Final = (320, 240)  # pixels
_FORMAT: Final = "yuv420p"
_CODECS: Final = {"libsvtav1": {"g": "2", "crf": "30", "preset": "8"}, "libx264": {"g": "2", "crf": "23"}}


class Videos:
    """Writes the videos of a data set, the pictures of a robot's camera, into its folder. A context manager."""

    def __init__(self, folder: Path, runs: Runs, robot: str, draw: Draw) -> None:
        self._folder, self._runs, self._robot, self._draw = folder, runs, robot, draw
        self._file = -1
        self._frames = 0  # in the file
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._counts = np.zeros((3, 256), np.int64)  # how often each channel has each value, in all episodes
        self._name, self._options = next((name, o) for name, o in _CODECS.items() if name in av.codecs_available)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def write(self, run: str, moments: np.ndarray) -> dict[str, Any]:
        """Write a run's frames at moments in s of simulated time; return its columns in the table of episodes.

        Raises:
            ReplayError: the robot has no camera, or its view isn't recorded.
        """
        if self._container is None or self._path.stat().st_size > VIDEO_SIZE * 1e6:
            self._close()
            self._open()
        begin, counts = self._frames, np.zeros_like(self._counts)
        for picture in self._pictures(run, moments):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = self._frames
            self._encode(frame)
            self._frames += 1
            counts += [np.bincount(picture[..., channel].ravel(), minlength=256) for channel in range(3)]
        self._counts += counts
        facts: dict[str, Any] = {
            "chunk_index": self._file // FILES,
            "file_index": self._file % FILES,
            "from_timestamp": begin / FPS,
            "to_timestamp": self._frames / FPS,
        }
        columns = {f"videos/{VIDEO}/{name}": value for name, value in facts.items()}
        return columns | {
            f"stats/{VIDEO}/{name}": value for name, value in statistics(counts, self._frames - begin).items()
        }

    def feature(self) -> dict[str, Any]:
        """Return the data set's description of its videos."""
        width, height = _SIZE
        info = {
            "video.height": height,
            "video.width": width,
            "video.codec": {"libsvtav1": "av1", "libx264": "h264"}[self._name],
            "video.pix_fmt": _FORMAT,
            "video.is_depth_map": False,
            "video.fps": FPS,
            "video.channels": 3,
            "has_audio": False,
        }
        return {"dtype": "video", "shape": [height, width, 3], "names": ["height", "width", "channels"], "info": info}

    def statistics(self, frames: int) -> dict[str, Any]:
        """Return the statistics by which LeRobot normalises the pictures of all episodes."""
        return statistics(self._counts, frames)

    @property
    def _path(self) -> Path:
        chunk, file = divmod(self._file, FILES)
        return self._folder / VIDEO_PATH.format(video_key=VIDEO, chunk_index=chunk, file_index=file)

    def _pictures(self, run: str, moments: np.ndarray) -> Iterator[NDArray[np.uint8]]:
        """Yield the camera's pictures at given moments of a run."""
        (world,) = self._runs.sql(
            "SELECT arg_max(world, step) FROM mutations WHERE run = ? AND command = 'set_robot' AND body = ?",
            [run, self._robot],
        ).rows()[0]
        changes = self._runs.sql(
            "SELECT m.step, m.sim_seconds FROM mutations m JOIN runs r USING (run) WHERE run = ? AND m.world = ? "
            "AND m.step <= r.last_step ORDER BY m.step",
            [run, world],
        ).rows()
        steps, times = [step for step, _ in changes], np.maximum.accumulate([time for _, time in changes])
        drawn: NDArray[np.uint8] | None = None
        still = -1  # the change after which nothing moved before the picture
        with RecordReader(self._runs.path / run) as log:
            for moment in moments:
                at = max(int(np.searchsorted(times, moment + 1e-9, side="right")) - 1, 0)
                moves = at + 1 < len(times) and bool(times[at] < moment - 1e-9)  # within the next change
                if drawn is None or moves or at != still:
                    drawn = self._draw(log, steps[at], world, float(moment) if moves else None, _SIZE)
                    still = -1 if moves else at
                yield drawn

    def _open(self) -> None:
        self._file += 1
        self._path.parent.mkdir(parents=True, exist_ok=True)
        os.environ.setdefault("SVT_LOG", "1")  # else the codec prints its configuration
        self._container = av.open(str(self._path), "w")
        stream = cast("VideoStream", self._container.add_stream(self._name, rate=FPS, options=self._options))
        stream.width, stream.height = _SIZE
        stream.pix_fmt = _FORMAT
        self._stream = stream
        self._frames = 0

    def _encode(self, frame: av.VideoFrame | None) -> None:
        if self._stream is not None and self._container is not None:
            self._container.mux(self._stream.encode(frame))

    def _close(self) -> None:
        if self._container is not None:
            self._encode(None)  # flush the codec
            self._container.close()
            self._container = None


def statistics(counts: NDArray[np.int64], frames: int) -> dict[str, Any]:
    """Return the statistics by which LeRobot normalises pictures, for each channel, with values from 0 to 1.

    ``counts`` has the frequency of each value from 0 to 255 in each channel.
    """
    values, of = np.arange(256) / 255, counts.sum(1, keepdims=True)
    mean = (counts * values).sum(1, keepdims=True) / of
    numbers = {
        "min": np.array([[values[np.flatnonzero(each)[0]]] for each in counts]),
        "max": np.array([[values[np.flatnonzero(each)[-1]]] for each in counts]),
        "mean": mean,
        "std": np.sqrt((counts * (values - mean) ** 2).sum(1, keepdims=True) / of),
    }
    shares = counts.cumsum(1) / of
    for name, share in QUANTILES.items():
        numbers[name] = values[(shares >= share - 1e-12).argmax(1)][:, None]
    return {name: array[..., None].tolist() for name, array in numbers.items()} | {"count": [frames]}
