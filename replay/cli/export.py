"""``export``: what a recording has, as a table for other programs; many, as a data set for training."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Final, get_type_hints

from replay.cli.console import print_message, print_result
from replay.errors import ReplayError
from replay.state.motion_table import MotionRow, rows

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from replay.file.record_reader import RecordReader
    from replay.recording import Recording
    from replay.runs.lerobot import Draw
    from replay.runs.runs import Runs

_FORMATS: Final = ("csv", "parquet")
_DATA_SETS: Final = ("lerobot",)


def add(parser: argparse.ArgumentParser) -> None:
    """Add what to export, and where to."""
    parser.add_argument(
        "--trajectories",
        action="store_true",
        help="of a recording, where each joint and base was to be, and where it was: a row a moment",
    )
    parser.add_argument(
        "--to",
        nargs=2,
        metavar=("FORMAT", "OUT"),
        help="of a folder of recordings, a data set for training policies: lerobot, and the folder that it gets",
    )
    parser.add_argument(
        "--plan", metavar="NAME", help="of a folder, this plan's runs (default: of the plan that most are of)"
    )
    parser.add_argument("--succeeded", action="store_true", help="of a folder, only runs that succeeded")
    parser.add_argument(
        "--images",
        nargs="?",
        const="",
        metavar="FRAME",
        help="of a data set, with what the robot's camera sees, or one at this frame of it, as video (extra: video)",
    )
    parser.add_argument("-o", dest="file", metavar="FILE", help="the table (default: CSV to standard output)")
    parser.add_argument("--format", choices=_FORMATS, help="of the file (default: by its name's end, else csv)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Write the table."""
    if not options.trajectories or options.to or options.images is not None:
        raise ReplayError("of a recording there are --trajectories; of a folder of recordings a data set: --to lerobot")
    suffix = Path(options.file or "").suffix.removeprefix(".")
    form = options.format or (suffix if suffix in _FORMATS else "csv")
    if form == "parquet" and options.file is None:
        raise ReplayError("a Parquet table needs a file: -o FILE.parquet")
    table = list(rows(log))
    if not table:
        print_message(f"{log.path}: nothing followed a trajectory")
    if options.file is None:
        print_result(lambda: [row._asdict() for row in table], _csv(table).splitlines(), as_json=options.json)
        return 0
    try:
        if form == "parquet":
            _write_parquet(table, options.file)
        else:
            Path(options.file).write_text(_csv(table), encoding="utf-8")
    except OSError as error:
        raise ReplayError(f"{options.file}: can't be written: {error}") from error
    data = {"file": options.file, "format": form, "rows": len(table)}
    print_result(lambda: data, [f"{options.file}: {len(table)} rows"], as_json=options.json)
    return 0


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    """Write the data set."""
    from replay.runs.lerobot import export  # noqa: PLC0415  what it needs is an extra
    from replay.runs.statistics import names_of, plan_of  # noqa: PLC0415  as above

    form, out = options.to or ("", "")
    if form not in _DATA_SETS or options.trajectories or options.file:
        raise ReplayError("of a folder of recordings there is a data set: --to lerobot OUT")
    plan, _ = plan_of(runs, options.plan)
    names = names_of(runs, plan)
    if options.succeeded:
        good = {run for (run,) in runs.sql("SELECT run FROM runs WHERE succeeded").rows()}
        names = tuple(name for name in names if name in good)
    done = export(runs, names, Path(out), None if options.images is None else _camera(options.images))
    if done.left_out:
        print_message(f"left out: {len(done.left_out)} runs in which no robot moves, as {done.left_out[0]}")
    data = {"folder": str(done.folder), "format": form, "episodes": list(done.episodes), "frames": done.frames}
    print_result(lambda: data, [f"{out}: {len(done.episodes)} episodes, {done.frames} frames"], as_json=options.json)
    return 0


def _camera(frame: str) -> Draw:
    """Return what draws what the robot's camera sees, or one at another frame of it."""
    import numpy as np  # noqa: PLC0415  slow to import

    from replay.restore.render import DrawnWorld  # noqa: PLC0415  what it needs is an extra

    def draw(
        log: RecordReader, step: int, world: str, moment: float | None, size: tuple[int, int]
    ) -> NDArray[np.uint8]:
        scene = DrawnWorld(log, step, world, moment)
        if not (camera := frame or scene.camera):
            raise ReplayError(f"{log.path}: the robot has no camera; name one of its frames")
        return np.asarray(scene.picture(camera=camera, size=size).convert("RGB"))

    return draw


def _csv(table: Iterable[MotionRow]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(MotionRow._fields)
    writer.writerows(table)
    return text.getvalue()


def _write_parquet(table: list[MotionRow], file: str) -> None:
    import pyarrow as pa  # noqa: PLC0415  comes with the viewer, and is slow to import
    from pyarrow import parquet  # noqa: PLC0415

    kinds = {str: pa.string(), int: pa.int64()}
    schema = pa.schema([(name, kinds.get(kind, pa.float64())) for name, kind in get_type_hints(MotionRow).items()])
    parquet.write_table(pa.Table.from_pylist([row._asdict() for row in table], schema), file)
