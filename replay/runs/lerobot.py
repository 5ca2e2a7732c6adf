"""Runs as a data set in LeRobot's format v3.0. Each episode is a run, with 30 frames per second of simulated time.

``observation.state`` of a frame is the robot's base pose and joints, ``action`` is the state of the next frame, and
``observation.environment_state`` has the poses of all bodies that move in a run. Only runs with ``--motion continuous``
have trajectories; in other runs, nothing moves between two changes. Every second frame of a video is a key frame,
because training reads single frames at random.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from recorder.packages import needed
from recorder.tracing.interrupts import partial_folder
from replay.errors import ReplayError
from replay.file.record_reader import RecordReader

if TYPE_CHECKING:
    import av
    from av.container import OutputContainer
    from av.video.stream import VideoStream

    from replay.runs.folder import Runs

FPS: Final = 30
_FILE_SIZE: Final = 100  # maximum size of a data file in MB
_FILES: Final = 1000  # maximum number of files in a folder
_DATA: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO: Final = "observation.images.camera"
_VIDEO_PATH: Final = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_MAX_VIDEO: Final = 200  # size in MB of a video file after which the next episode begins a new file
_PICTURE: Final = (320, 240)  # width and height of pictures in pixels
_FORMAT: Final = "yuv420p"
_CODECS: Final = {"libsvtav1": {"g": "2", "crf": "30", "preset": "8"}, "libx264": {"g": "2", "crf": "23"}}
_EPISODES: Final = "meta/episodes/chunk-000/file-000.parquet"
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_QUANTILES: Final = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_STATE, _ACTION, _ENVIRONMENT = "observation.state", "action", "observation.environment_state"

#: A function that draws a camera's picture, from: recording, step, world, moment within the next step or None, size.
#: The moment is simulated time in s; the size is in pixels. Callers pass this function, because this package doesn't
#: import rendering.
Draw: TypeAlias = "Callable[[RecordReader, int, str, float | None, tuple[int, int]], NDArray[np.uint8]]"


@dataclass(frozen=True, slots=True)
class Exported:
    """A written data set."""

    folder: Path
    episodes: tuple[str, ...]  # names of the recordings, in the order of the episodes
    frames: int
    left_out: tuple[str, ...]  # names of recordings in which no robot moves


def export(runs: Runs, names: Sequence[str], folder: Path, draw: Draw | None = None) -> Exported:
    """Export runs of a robot into a new folder. ``names`` are recordings. Without ``draw``, there is no video.

    If no robot moves, if the runs have several robots, or if the folder can't be written, ReplayError is raised.
    """
    if draw is not None:
        with needed("video"):
            import av  # noqa: F401, PLC0415
    if folder.exists():
        raise ReplayError(f"{folder} already exists; a data set needs a new folder")
    rows = runs.sql(
        "SELECT run, arg_max(body, step) FROM mutations m WHERE command = 'set_robot' AND body <> '' "
        "AND EXISTS (SELECT 1 FROM joints j WHERE j.run = m.run AND j.body = m.body) GROUP BY run ORDER BY run"
    )
    wanted = set(names)
    robots = {run: robot for run, robot in rows.rows() if run in wanted}
    if not robots:
        raise ReplayError(f"{runs.path}: no robot moves in these runs, so they have no data to learn from")
    kinds = sorted(set(robots.values()))
    if len(kinds) > 1:
        raise ReplayError(f"{runs.path}: the runs have different robots ({', '.join(kinds)}); a data set has one robot")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with partial_folder(folder) as partial:
            with ExitStack() as files:
                videos = None
                if draw is not None:
                    videos = files.enter_context(closing(_Videos(partial, runs, kinds[0], draw)))
                frames = _Writer(partial, runs, list(robots), kinds[0], videos).write()
            partial.chmod(0o755)
            partial.rename(folder)
    except OSError as error:
        raise ReplayError(f"{folder}: can't be written: {error.strerror or error}") from error
    return Exported(folder, tuple(robots), frames, tuple(name for name in names if name not in robots))


class _Writer:
    def __init__(self, folder: Path, runs: Runs, names: Sequence[str], robot: str, videos: _Videos | None) -> None:
        self.folder, self.runs, self.names, self.robot, self.videos = folder, runs, names, robot, videos
        self.joints = self._common("joint", "joints", "body = ?", [robot])
        in_all = self._common("body", "poses", "body <> ?", [self.robot])
        rows = self.runs.sql(
            "SELECT DISTINCT body FROM (SELECT run, body FROM poses WHERE list_contains(?, run) GROUP BY run, body "
            "HAVING max(x) - min(x) + max(y) - min(y) + max(z) - min(z) > 1e-4)",
            [self.names],
        )
        moving = {body for (body,) in rows.rows()}
        self.bodies = [body for body in in_all if body in moving]
        self.state = [*(f"base.{axis}" for axis in _POSE), *self.joints]
        self.environment = [f"{body}.{axis}" for body in self.bodies for axis in _POSE]

    def write(self) -> int:
        """Write the data set, and return the number of frames."""
        tables: list[pa.Table] = []
        episodes: list[dict[str, Any]] = []
        index = file = 0
        for number, name in enumerate(self.names):
            moments, frames = self._frames(name)
            length = len(frames["timestamp"])
            frames |= {
                "frame_index": np.arange(length),
                "episode_index": np.full(length, number),
                "index": np.arange(index, index + length),
                "task_index": np.zeros(length, np.int64),
            }
            tables.append(_table(frames))
            episodes.append(
                {
                    "episode_index": number,
                    "tasks": [self.task],
                    "length": length,
                    "dataset_from_index": index,
                    "dataset_to_index": index + length,
                    "data/chunk_index": file // _FILES,
                    "data/file_index": file % _FILES,
                    "meta/episodes/chunk_index": 0,
                    "meta/episodes/file_index": 0,
                    "run": name,
                    **{
                        f"stats/{key}/{what}": value
                        for key, of in _statistics(frames).items()
                        for what, value in of.items()
                    },
                    **({} if self.videos is None else self.videos.write(name, moments)),
                }
            )
            index += length
            if sum(table.nbytes for table in tables) > _FILE_SIZE * 1e6:
                self._write_data(tables, file)
                tables, file = [], file + 1
        if tables:
            self._write_data(tables, file)
        self._write_meta(episodes, index)
        return index

    @property
    def task(self) -> str:
        """The description of the task, which is the plan's name."""
        (plan,) = self.runs.sql("SELECT plan FROM runs WHERE run = ?", [self.names[0]]).rows()[0]
        return str(plan)

    def _common(self, what: str, table: str, condition: str, values: Sequence[object]) -> list[str]:
        """Return the names in a table that all runs have."""
        rows = self.runs.sql(
            f"SELECT {what} FROM {table} WHERE {condition} AND list_contains(?, run) "  # noqa: S608  the names are ours
            f"GROUP BY 1 HAVING count(DISTINCT run) = ? ORDER BY 1",
            [*values, self.names, len(self.names)],
        )
        return [name for (name,) in rows.rows()]

    def _frames(self, run: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        poses = self._series(run, "poses", "body", _POSE)
        joints = self._series(run, "joints", "joint", ("position",), self.robot)
        times = [time for moments, _ in [*poses.values(), *joints.values()] for time in (moments[0], moments[-1])]
        start, end = min(times), max(times)
        moments = np.arange(math.floor((end - start) * FPS + 1e-6) + 1) / FPS + start
        own = [_at(poses[self.robot], moments), *(_at(joints[name], moments) for name in self.joints)]
        state = np.concatenate(own, 1)
        around = [_at(poses[body], moments) for body in self.bodies]
        last = np.arange(len(moments)) == len(moments) - 1
        (succeeded,) = self.runs.sql("SELECT succeeded FROM runs WHERE run = ?", [run]).rows()[0]
        frames = {_STATE: state, _ACTION: np.concatenate([state[1:], state[-1:]])}
        if around:
            frames[_ENVIRONMENT] = np.concatenate(around, 1)
        return moments, frames | {
            "next.done": last,
            "next.success": last & bool(succeeded),
            "timestamp": (moments - start).astype(np.float32),
        }

    def _series(
        self, run: str, table: str, key: str, columns: Sequence[str], body: str | None = None
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return times and values, by name. If there are several values at a time, the last value counts."""
        rows = self.runs.sql(
            f"SELECT {key}, sim_seconds, {', '.join(columns)} FROM {table} WHERE run = ? AND (? IS NULL OR body = ?) "  # noqa: S608  the names are ours
            "ORDER BY step, sim_seconds",
            [run, body, body],
        )
        found: dict[str, list[tuple[float, ...]]] = {}
        for name, *numbers in rows.rows():
            found.setdefault(name, []).append(tuple(numbers))
        arrays = {name: np.array(values) for name, values in found.items()}
        return {name: (np.maximum.accumulate(array[:, 0]), array[:, 1:]) for name, array in arrays.items()}

    # --- files -------------------------------------------------------------------------------------------------------

    def _write_data(self, tables: Sequence[pa.Table], file: int) -> None:
        path = self.folder / _DATA.format(chunk_index=file // _FILES, file_index=file % _FILES)
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.concat_tables(tables), path)

    def _write_meta(self, episodes: list[dict[str, Any]], frames: int) -> None:
        path = self.folder / _EPISODES
        path.parent.mkdir(parents=True)
        parquet.write_table(pa.Table.from_pylist(episodes), path)
        tasks = pa.table({"task_index": pa.array([0]), "task": pa.array([self.task])})
        columns = [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, (kind, numpy) in {"task_index": ("int64", "int64"), "task": ("unicode", "object")}.items()
        ]
        index = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.2.0"}
        tasks = tasks.replace_schema_metadata({"pandas": json.dumps(index)})
        parquet.write_table(tasks, self.folder / "meta" / "tasks.parquet")
        info = {
            "codebase_version": "v3.0",
            "robot_type": self.robot,
            "total_episodes": len(episodes),
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": _FILES,
            "data_files_size_in_mb": _FILE_SIZE,
            "video_files_size_in_mb": _MAX_VIDEO if self.videos else 0,
            "fps": FPS,
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": _DATA,
            "video_path": _VIDEO_PATH if self.videos else None,
            "features": self._features() | ({_VIDEO: self.videos.feature()} if self.videos else {}),
        }
        (self.folder / "meta" / "info.json").write_text(json.dumps(info, indent=2), encoding="utf-8")
        whole: dict[str, Any] = _statistics(dict(self._columns()))
        if self.videos:
            whole[_VIDEO] = self.videos.statistics(frames)
        (self.folder / "meta" / "stats.json").write_text(json.dumps(whole, indent=2), encoding="utf-8")

    def _features(self) -> dict[str, Any]:
        named = {_STATE: self.state, _ACTION: self.state} | ({_ENVIRONMENT: self.environment} if self.bodies else {})
        features: dict[str, Any] = {
            key: {"dtype": "float32", "shape": [len(names)], "names": names} for key, names in named.items()
        }
        simple = {"next.done": "bool", "next.success": "bool", "timestamp": "float32"}
        simple |= dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
        features |= {key: {"dtype": kind, "shape": [1], "names": None} for key, kind in simple.items()}
        return {key: feature | {"fps": FPS} for key, feature in features.items()}

    def _columns(self) -> Iterator[tuple[str, np.ndarray]]:
        for name in self._features():
            column = parquet.read_table(self.folder / "data", columns=[name])[name].combine_chunks()
            is_vector = pa.types.is_fixed_size_list(column.type)
            yield name, np.asarray(column.flatten()).reshape(len(column), -1) if is_vector else np.asarray(column)


def _at(series: tuple[np.ndarray, np.ndarray], moments: np.ndarray) -> np.ndarray:
    """Return the values at moments. Before the first value, moments have the first value."""
    times, values = series
    return values[np.maximum(np.searchsorted(times, moments + 1e-9, side="right") - 1, 0)]


def _table(frames: Mapping[str, np.ndarray]) -> pa.Table:
    columns = {}
    for name, values in frames.items():
        if values.ndim == 1:
            columns[name] = pa.array(values)
        else:
            flat = pa.array(values.astype(np.float32).ravel())
            columns[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return pa.table(columns)


def _statistics(columns: Mapping[str, np.ndarray]) -> dict[str, dict[str, list[float]]]:
    """Return LeRobot's statistics for normalisation: each is a list with a number for each component of a feature."""
    found = {}
    for name, values in columns.items():
        rows = values.astype(np.float64).reshape(len(values), -1)
        of = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
        of |= {quantile: np.quantile(rows, share, 0) for quantile, share in _QUANTILES.items()}
        found[name] = {what: array.tolist() for what, array in of.items()} | {"count": [len(rows)]}
    return found


# --- video ------------------------------------------------------------------------------------------------------------


class _Videos:
    """Writes a data set's videos, with the view of the robot's camera."""

    def __init__(self, folder: Path, runs: Runs, robot: str, draw: Draw) -> None:
        self._folder, self._runs, self._robot, self._draw = folder, runs, robot, draw
        self._file = -1
        self._frames = 0  # number of frames in the present file
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._counts = np.zeros((3, 256), np.int64)  # number of pixels by channel and value, in all episodes
        import av  # noqa: PLC0415  an extra

        self._av = av
        self._name, self._options = next((name, o) for name, o in _CODECS.items() if name in av.codecs_available)

    def write(self, run: str, moments: np.ndarray) -> dict[str, Any]:
        """Write the frames of a run at some moments (simulated time in s). Return the run's entries about its video.

        If the robot has no camera, or if the view isn't recorded, ReplayError is raised.
        """
        if self._container is None or self._path.stat().st_size > _MAX_VIDEO * 1e6:
            self.close()
            self._file += 1
            self._path.parent.mkdir(parents=True, exist_ok=True)
            os.environ.setdefault("SVT_LOG", "1")  # otherwise the codec prints its configuration
            self._container = self._av.open(str(self._path), "w")
            stream = cast("VideoStream", self._container.add_stream(self._name, rate=FPS, options=self._options))
            stream.width, stream.height = _PICTURE
            stream.pix_fmt = _FORMAT
            self._stream = stream
            self._frames = 0
        begin, counts = self._frames, np.zeros_like(self._counts)
        for picture in self._pictures(run, moments):
            frame = self._av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = self._frames
            self._encode(frame)
            self._frames += 1
            counts += [np.bincount(picture[..., channel].ravel(), minlength=256) for channel in range(3)]
        self._counts += counts
        facts: dict[str, Any] = {
            "chunk_index": self._file // _FILES,
            "file_index": self._file % _FILES,
            "from_timestamp": begin / FPS,
            "to_timestamp": self._frames / FPS,
        }
        return {f"videos/{_VIDEO}/{name}": value for name, value in facts.items()} | {
            f"stats/{_VIDEO}/{name}": value for name, value in _picture_statistics(counts, self._frames - begin).items()
        }

    def feature(self) -> dict[str, Any]:
        """Return the description of the videos for the data set."""
        width, height = _PICTURE
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
        return _picture_statistics(self._counts, frames)

    @property
    def _path(self) -> Path:
        chunk, file = divmod(self._file, _FILES)
        return self._folder / _VIDEO_PATH.format(video_key=_VIDEO, chunk_index=chunk, file_index=file)

    def _pictures(self, run: str, moments: np.ndarray) -> Iterator[NDArray[np.uint8]]:
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
        still = -1  # index of the last change; -1 during motions
        with RecordReader(self._runs.path / run) as log:
            for moment in moments:
                at = max(int(np.searchsorted(times, moment + 1e-9, side="right")) - 1, 0)
                moves = at + 1 < len(times) and bool(times[at] < moment - 1e-9)  # moment within the next change
                if drawn is None or moves or at != still:
                    drawn = self._draw(log, steps[at], world, float(moment) if moves else None, _PICTURE)
                    still = -1 if moves else at
                yield drawn

    def _encode(self, frame: av.VideoFrame | None) -> None:
        if self._stream is not None and self._container is not None:
            self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        if self._container is not None:
            self._encode(None)  # flush the codec
            self._container.close()
            self._container = None


def _picture_statistics(counts: NDArray[np.int64], frames: int) -> dict[str, Any]:
    """Return LeRobot's statistics of pixel values from 0 to 1, for each channel.

    ``counts`` contains the number of pixels by channel and value (0 to 255).
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
    for name, share in _QUANTILES.items():
        numbers[name] = values[(shares >= share - 1e-12).argmax(1)][:, None]
    return {name: array[..., None].tolist() for name, array in numbers.items()} | {"count": [frames]}
