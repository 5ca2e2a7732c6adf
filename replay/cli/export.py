"""``export``: a recording for Foxglove, its trajectories as a table, or a folder of recordings as a data set.

The table contains planned and driven positions of joints over time. Driven positions are the samples of simulations, 30
per simulated second. Velocities of joints come from the engine. Bases move from pose to pose, without velocities.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from recorder import geometry
from recorder.records import STEPS_PER_SECOND, BeginTrajectory, BodyState, Keyframe, Mutation
from recorder.records.fold import FoldedWorld, apply
from recorder.records.motion import BASE_COORDINATES, has_ended, time_of
from replay.cli.console import print_message, print_result
from replay.cli.repair import write_copy
from replay.errors import Damaged, ReplayError
from replay.file.record_reader import RecordReader
from replay.recording import Recording
from replay.report.report import write
from replay.state.fold import world_of
from replay.state.state import Body, World

if TYPE_CHECKING:
    from replay.runs.folder import Runs
    from replay.runs.lerobot import Draw

_FORMATS: Final = ("csv", "parquet")


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--trajectories", action="store_true", help="write a recording's planned and driven positions")
    parser.add_argument(
        "--to",
        nargs=2,
        metavar=("FORMAT", "OUT"),
        help="'foxglove' OUT.mcap: a recording for Foxglove, with a layout in OUT.layout.json; 'lerobot' OUT: a folder "
        "of recordings as a data set for training policies, in a new folder",
    )
    parser.add_argument("--plan", metavar="NAME", help="for a folder: the runs' plan (default: the most frequent plan)")
    parser.add_argument("--succeeded", action="store_true", help="for a folder: only successful runs")
    parser.add_argument(
        "--images",
        nargs="?",
        const="",
        metavar="FRAME",
        help="for a data set: add a video from the robot's camera, or from a frame of the robot (extra: video)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the existing files for Foxglove")
    parser.add_argument("-o", dest="file", metavar="FILE", help="the table's file (default: CSV on standard output)")
    parser.add_argument("--format", choices=_FORMATS, help="format of the file (default: its suffix, otherwise csv)")


def run(log: Recording, options: argparse.Namespace) -> None:
    form, out = options.to or ("", "")
    if form == "foxglove" and not (options.trajectories or options.file or options.images):
        _to_foxglove(log, Path(out), options)
        return
    if not options.trajectories or options.to or options.images is not None:
        raise ReplayError("a recording needs --trajectories or --to foxglove OUT.mcap; a folder needs --to lerobot OUT")
    suffix = Path(options.file or "").suffix.removeprefix(".")
    form = options.format or (suffix if suffix in _FORMATS else "csv")
    if form == "parquet" and options.file is None:
        raise ReplayError("a Parquet table needs a file: -o FILE.parquet")
    table = list(motion_rows(log))
    if not table:
        print_message(f"{log.path}: nothing followed a trajectory")
    if options.file is None:
        print_result(lambda: [row._asdict() for row in table], _csv(table).splitlines(), as_json=options.json)
        return
    write(options.file, _parquet(table) if form == "parquet" else _csv(table).encode())
    data = {"file": options.file, "format": form, "rows": len(table)}
    print_result(lambda: data, [f"{options.file}: {len(table)} rows"], as_json=options.json)


def _to_foxglove(log: Recording, out: Path, options: argparse.Namespace) -> None:
    from replay.foxglove import FoxgloveTranslator  # noqa: PLC0415  loads numpy

    layout = out.with_suffix(".layout.json")
    if layout.exists() and not options.overwrite:
        raise ReplayError(f"{layout} exists; name another file, or add --overwrite")

    def translate(file: BinaryIO) -> tuple[dict[str, object], int]:
        translator = FoxgloveTranslator(log, file)
        return translator.translate(), translator.messages

    content, messages = write_copy(log, out, translate, overwrite=options.overwrite)
    layout.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    data = {"file": str(out), "format": "foxglove", "messages": messages, "layout": str(layout)}
    print_result(lambda: data, [f"{out}: {messages} messages", f"{layout}: layout for Foxglove"], as_json=options.json)


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    from replay.runs.lerobot import export  # noqa: PLC0415  needs an extra
    from replay.runs.statistics import names_of, plan_of  # noqa: PLC0415  as above

    form, out = options.to or ("", "")
    if form != "lerobot" or options.trajectories or options.file:
        raise ReplayError("a folder of recordings needs --to lerobot OUT, without --trajectories and -o")
    plan, _ = plan_of(runs, options.plan)
    names = names_of(runs, plan)
    if options.succeeded:
        good = {run for (run,) in runs.sql("SELECT run FROM runs WHERE succeeded").rows()}
        names = tuple(name for name in names if name in good)
    done = export(runs, names, Path(out), None if options.images is None else _camera(options.images))
    if done.left_out:
        print_message(f"left out: {len(done.left_out)} runs in which no robot moves, such as {done.left_out[0]}")
    data = {"folder": str(done.folder), "format": form, "episodes": list(done.episodes), "frames": done.frames}
    print_result(lambda: data, [f"{out}: {len(done.episodes)} episodes, {done.frames} frames"], as_json=options.json)


def _camera(frame: str) -> Draw:
    """Return a function that draws the view from a frame of the robot; by default, from the camera's frame."""
    from replay.restore.render import DrawnWorld  # noqa: PLC0415  needs an extra

    def draw(
        log: RecordReader, step: int, world: str, moment: float | None, size: tuple[int, int]
    ) -> NDArray[np.uint8]:
        scene = DrawnWorld(log, step, world, moment)
        if not (camera := frame or scene.camera):
            raise ReplayError(f"{log.path}: the robot has no camera; name a frame of the robot")
        return np.asarray(scene.picture(camera=camera, size=size).convert("RGB"))

    return draw


def _csv(table: Iterable[MotionRow]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(MotionRow._fields)
    writer.writerows(table)
    return text.getvalue()


def _parquet(table: list[MotionRow]) -> bytes:
    import pyarrow as pa  # noqa: PLC0415  imported here: this optional package is slow to import
    from pyarrow import parquet  # noqa: PLC0415

    kinds = {str: pa.string(), int: pa.int64()}
    schema = pa.schema([(name, kinds.get(kind, pa.float64())) for name, kind in get_type_hints(MotionRow).items()])
    file = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist([row._asdict() for row in table], schema), file)
    return file.getvalue()


class MotionRow(NamedTuple):
    """A planned or driven position of a joint, or of a coordinate of a base."""

    world: str
    trajectory: int  # number of the trajectory in the world
    body: str
    joint: str  # name of a joint, or "x", "y" or "yaw" of the base in the world
    source: str  # "planned" or "driven"
    time: float  # time in s on the trajectory; while a body slows down, this time passes more slowly
    seconds: float  # simulated time in s of the world; planned positions don't consider stops
    position: float  # rad or m
    velocity: float | None


def motion_rows(log: RecordReader) -> Iterator[MotionRow]:
    """Yield for each trajectory the planned rows, and then the driven rows; raise Damaged for inconsistent records."""
    worlds: dict[str, FoldedWorld] = {}
    for record in log.records((Mutation, Keyframe)):
        try:
            if isinstance(record, Mutation) and record.simulate.driven and record.world in worlds:
                yield from _driven(world_of(worlds[record.world]), record)
            apply(worlds, record)
            if isinstance(record, Mutation) and record.HasField("begin_trajectory"):
                begin, start = record.begin_trajectory, record.sim_step / STEPS_PER_SECOND
                trajectory = begin.trajectory
                moments = [(time, name) for time in trajectory.times for name in _names(begin)]
                for (time, name), position, velocity in zip(
                    moments, trajectory.positions, trajectory.velocities, strict=True
                ):
                    where = record.world, begin.number, begin.body, name
                    yield MotionRow(*where, "planned", time, start + time, position, velocity)
        except (ValueError, IndexError) as error:
            raise Damaged(log.path, f"step {record.seq}", str(error)) from error


def _driven(world: World, record: Mutation) -> Iterator[MotionRow]:
    """Yield the rows of a simulation. ``world`` is the state before the simulation."""
    ends = {each.number: each.time for each in record.simulate.driven}
    followed = {number: each for number, each in world.following.items() if number in ends}
    bodies = {each.begin.body: world.bodies.get(each.begin.body) for each in followed.values()}
    # a recording may begin after a body was loaded
    values = {name: {} if body is None else _values(body) for name, body in bodies.items()}
    moments = [(sample.sim_step, sample.bodies) for sample in record.effect.samples]
    for sim_step, states in [*moments, (record.sim_step, record.effect.bodies)]:
        for state in states:
            if state.body in values:
                values[state.body].update(_values(state))
        for number, following in list(followed.items()):
            time = min(time_of(following, sim_step), ends[number])
            body = following.begin.body
            for name in _names(following.begin):
                if name in values[body]:
                    where = record.world, number, body, name
                    yield MotionRow(*where, "driven", time, sim_step / STEPS_PER_SECOND, *values[body][name])
            if has_ended(following, sim_step):
                del followed[number]


def _names(begin: BeginTrajectory) -> Sequence[str]:
    return begin.trajectory.joints or BASE_COORDINATES


def _values(state: Body | BodyState) -> dict[str, tuple[float, float | None]]:
    """Return the position and velocity of each joint and base coordinate that the state of a body contains, by name."""
    found: dict[str, tuple[float, float | None]] = {}
    if isinstance(state, Body):
        found |= {name: (position, state.joint_velocities[name]) for name, position in state.joints.items()}
    else:
        speeds = state.joint_velocities or [0.0] * len(state.joints)
        found |= dict(zip(state.joints, zip(state.joint_positions, speeds, strict=True), strict=True))
    if state.position:
        found |= {"x": (state.position[0], None), "y": (state.position[1], None)}
    if state.orientation:
        found["yaw"] = geometry.to_rpy(state.orientation)[2], None
    return found
