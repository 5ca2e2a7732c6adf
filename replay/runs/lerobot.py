"""Runs as a data set in LeRobot's format v3.0: an episode per run, with 30 frames per second of simulated time.

A frame has the robot's base pose and joints (``observation.state``), those of the next frame (``action``), and the
poses of all bodies that move in any run (``observation.environment_state``). Between two changes nothing moves. So only
runs whose motions take time (execution environment ``continuous``) have trajectories. A camera's picture can be drawn
for each frame (:mod:`replay.runs.video`). The folder is written under a temporary name and renamed when it is complete.
"""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from replay.errors import ReplayError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from replay.file.record_reader import RecordReader
    from replay.runs.folder import Runs
    from replay.runs.video import Videos

FPS: Final = 30
_FILE_SIZE: Final = 100  # MB of a data file
FILES: Final = 1000  # files in a folder
_DATA: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO: Final = "observation.images.camera"
VIDEO_PATH: Final = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
VIDEO_SIZE: Final = 200  # MB of a video file, after which the next episode begins a new one
_EPISODES: Final = "meta/episodes/chunk-000/file-000.parquet"
_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
QUANTILES: Final = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_STATE, _ACTION, _ENVIRONMENT = "observation.state", "action", "observation.environment_state"


#: Draws the picture of a camera in a world after a step, or at a moment within the next step (s of simulated time). The
#: size is width and height in pixels. The caller provides this function: the room doesn't import rendering.
Draw: TypeAlias = "Callable[[RecordReader, int, str, float | None, tuple[int, int]], NDArray[np.uint8]]"


@dataclass(frozen=True, slots=True)
class Exported:
    """A data set that was written."""

    folder: Path
    episodes: tuple[str, ...]  # names of the recordings, in the order of the episodes
    frames: int
    left_out: tuple[str, ...]  # names of recordings in which no robot moves


def export(runs: Runs, names: Sequence[str], folder: Path, draw: Draw | None = None) -> Exported:
    """Export runs of one robot, by the names of their recordings, into a new folder; without ``draw``, without video.

    Raises:
        ReplayError: no robot moves in any run, the runs are of several robots, or the folder can't be written.
    """
    if draw is not None:
        from replay.runs.video import Videos  # noqa: PLC0415  needs an extra
    if folder.exists():
        raise ReplayError(f"{folder}: already exists; a data set needs a new folder")
    robots = _robots(runs, names)
    if not robots:
        raise ReplayError(f"{runs.path}: no robot moves in these runs, so they have no data to learn from")
    kinds = sorted(set(robots.values()))
    if len(kinds) > 1:
        raise ReplayError(f"{runs.path}: the runs have the robots {', '.join(kinds)}; a data set has one robot")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            with ExitStack() as files:
                videos = None
                if draw is not None:
                    videos = files.enter_context(Videos(partial, runs, kinds[0], draw))
                frames = _Writer(partial, runs, list(robots), kinds[0], videos).write()
            partial.chmod(0o755)
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)  # if it wasn't renamed
    except OSError as error:
        raise ReplayError(f"{folder}: can't be written: {error.strerror or error}") from error
    return Exported(folder, tuple(robots), frames, tuple(name for name in names if name not in robots))


def _robots(runs: Runs, names: Sequence[str]) -> dict[str, str]:
    """Return the last robot of each run with recorded joints."""
    rows = runs.sql(
        "SELECT run, arg_max(body, step) FROM mutations m WHERE command = 'set_robot' AND body <> '' "
        "AND EXISTS (SELECT 1 FROM joints j WHERE j.run = m.run AND j.body = m.body) GROUP BY run ORDER BY run"
    )
    wanted = set(names)
    return {run: robot for run, robot in rows.rows() if run in wanted}


class _Writer:
    """Writes a data set into a folder."""

    def __init__(self, folder: Path, runs: Runs, names: Sequence[str], robot: str, videos: Videos | None) -> None:
        self.folder, self.runs, self.names, self.robot, self.videos = folder, runs, names, robot, videos
        self.joints = self._common("joint", "joints", "body = ?", [robot])
        self.bodies = self._moving()
        self.state = [*(f"base.{axis}" for axis in _POSE), *self.joints]
        self.environment = [f"{body}.{axis}" for body in self.bodies for axis in _POSE]

    def write(self) -> int:
        """Write everything, and return the number of frames."""
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
                    "data/chunk_index": file // FILES,
                    "data/file_index": file % FILES,
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
        """The task's description: the plan's name."""
        (plan,) = self.runs.sql("SELECT plan FROM runs WHERE run = ?", [self.names[0]]).rows()[0]
        return str(plan)

    def _common(self, what: str, table: str, condition: str, values: Sequence[object]) -> list[str]:
        """Return the names that all runs have in a table."""
        rows = self.runs.sql(
            f"SELECT {what} FROM {table} WHERE {condition} AND list_contains(?, run) "  # noqa: S608  the names are ours
            f"GROUP BY 1 HAVING count(DISTINCT run) = ? ORDER BY 1",
            [*values, self.names, len(self.names)],
        )
        return [name for (name,) in rows.rows()]

    def _moving(self) -> list[str]:
        """Return the bodies that all runs have and that move in any run, without the robot."""
        in_all = self._common("body", "poses", "body <> ?", [self.robot])
        rows = self.runs.sql(
            "SELECT DISTINCT body FROM (SELECT run, body FROM poses WHERE list_contains(?, run) GROUP BY run, body "
            "HAVING max(x) - min(x) + max(y) - min(y) + max(z) - min(z) > 1e-4)",
            [self.names],
        )
        moving = {body for (body,) in rows.rows()}
        return [body for body in in_all if body in moving]

    def _frames(self, run: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the times of an episode's frames, in s of simulated time, and its columns."""
        poses = self._series(run, "poses", "body", _POSE)
        joints = self._series(run, "joints", "joint", ("position",), self.robot)
        times = [time for moments, _ in [*poses.values(), *joints.values()] for time in (moments[0], moments[-1])]
        start, end = min(times), max(times)
        moments = np.arange(math.floor((end - start) * FPS + 1e-6) + 1) / FPS + start
        state = np.concatenate(
            [_at(poses[self.robot], moments), *(_at(joints[name], moments) for name in self.joints)], 1
        )
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
        """Return times and values by name; the last of several values at one time counts."""
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
        path = self.folder / _DATA.format(chunk_index=file // FILES, file_index=file % FILES)
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.concat_tables(tables), path)

    def _write_meta(self, episodes: list[dict[str, Any]], frames: int) -> None:
        path = self.folder / _EPISODES
        path.parent.mkdir(parents=True)
        parquet.write_table(pa.Table.from_pylist(episodes), path)
        tasks = pa.table({"task_index": pa.array([0]), "task": pa.array([self.task])})
        kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
        columns = [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, (kind, numpy) in kinds.items()
        ]
        index = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.2.0"}
        parquet.write_table(
            tasks.replace_schema_metadata({"pandas": json.dumps(index)}), self.folder / "meta" / "tasks.parquet"
        )
        info = {
            "codebase_version": "v3.0",
            "robot_type": self.robot,
            "total_episodes": len(episodes),
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": FILES,
            "data_files_size_in_mb": _FILE_SIZE,
            "video_files_size_in_mb": VIDEO_SIZE if self.videos else 0,
            "fps": FPS,
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": _DATA,
            "video_path": VIDEO_PATH if self.videos else None,
            "features": self._features() | ({VIDEO: self.videos.feature()} if self.videos else {}),
        }
        (self.folder / "meta" / "info.json").write_text(json.dumps(info, indent=2), encoding="utf-8")
        whole: dict[str, Any] = _statistics(dict(self._columns()))
        if self.videos:
            whole[VIDEO] = self.videos.statistics(frames)
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
        """Yield the columns of all data files, one at a time."""
        files = sorted((self.folder / "data").rglob("*.parquet"))
        for name in self._features():
            parts = []
            for file in files:
                column = parquet.ParquetFile(file).read([name])[name].combine_chunks()
                is_vector = pa.types.is_fixed_size_list(column.type)
                parts.append(np.asarray(column.flatten()).reshape(len(column), -1) if is_vector else np.asarray(column))
            yield name, np.concatenate(parts)


def _at(series: tuple[np.ndarray, np.ndarray], moments: np.ndarray) -> np.ndarray:
    """Return the values at given moments; before the first value, the first value."""
    times, values = series
    return values[np.maximum(np.searchsorted(times, moments + 1e-9, side="right") - 1, 0)]


def _table(frames: Mapping[str, np.ndarray]) -> pa.Table:
    """Return an episode as a table, with vectors as fixed-size lists."""
    columns = {}
    for name, values in frames.items():
        if values.ndim == 1:
            columns[name] = pa.array(values)
        else:
            flat = pa.array(values.astype(np.float32).ravel())
            columns[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return pa.table(columns)


def _statistics(columns: Mapping[str, np.ndarray]) -> dict[str, dict[str, list[float]]]:
    """Return the statistics by which LeRobot normalises, each as a list of one number per component of a feature."""
    found = {}
    for name, values in columns.items():
        rows = values.astype(np.float64).reshape(len(values), -1)
        of = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
        of |= {quantile: np.quantile(rows, share, 0) for quantile, share in QUANTILES.items()}
        found[name] = {what: array.tolist() for what, array in of.items()} | {"count": [len(rows)]}
    return found
