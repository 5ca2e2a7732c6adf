"""``state``: poses, joints, attachments and beliefs of robots after a step; ``diff``: the difference between states."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from recorder.records import STEPS_PER_SECOND, Plain
from recorder.records.motion import time_of
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE, opened
from replay.compare import NOTABLE_METRES, compare_recordings, comparison_lines, difference, difference_lines
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import phrases, report
from replay.state.fold import last_open_step
from replay.state.json_data import state_data
from replay.state.state import Body, State, World

if TYPE_CHECKING:
    from recorder.geometry import Pose
    from replay.runs.folder import Runs


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("step", metavar="STEP", help=HINT)
    parser.add_argument("object", metavar="OBJECT", nargs="?", help="print only this object, with its joints")
    parser.add_argument("--world", metavar="NAME", help="print only this world")
    parser.add_argument("--links", action="store_true", help="also print the pose of each link in the world")


def run(log: Recording, options: argparse.Namespace) -> None:
    state = log.state_at(options.step)
    if not any(world.open for world in state.worlds.values()):
        shown = last_open_step(log, state.step, options.world)
        if shown != state.step:
            print_message(f"no world is open after step {state.step}; this is the state after step {shown}")
            state = log.state_at(shown)
    if options.object is not None:
        state.body(options.object, options.world)
    elif options.world is not None:
        state.world(options.world)
    if state.uncertainty:
        print_message(state.uncertainty)
    details, links = options.object is not None, options.links
    lines = [f"after step {state.step}" if state.sampled is None else phrases.sampled(state.sampled)]
    for world, bodies in _shown(state, options.object, options.world):
        lines += _world(state, world, bodies, details=details, links=links)
    print_result(lambda: _data(state, options.object, options.world, links=links), lines, as_json=options.json)


def _data(state: State, only: str | None, name: str | None, *, links: bool) -> dict[str, Plain]:
    data = state_data(state, only, name)
    if links:
        data["links"] = {
            world.name: {
                body.name: {
                    link: {"position": list(position), "orientation": list(turn)}
                    for link, (position, turn) in state.link_poses(body).items()
                }
                for body in bodies
            }
            for world, bodies in _shown(state, only, name)
        }
    return data


def _shown(state: State, only: str | None, name: str | None) -> Iterator[tuple[World, list[Body]]]:
    """Yield the selected worlds with their selected bodies."""
    for world in state.worlds.values():
        if name in (None, world.name) and (only is None or only in world.bodies):
            yield world, [body for body in world.bodies.values() if only in (None, body.name)]


def _world(state: State, world: World, bodies: list[Body], *, details: bool, links: bool) -> Iterator[str]:
    if not world.open:
        yield f"{world.title}: closed"
        return
    gravity = ", ".join(f"{part:g}" for part in world.gravity)
    robot = f", robot {world.robot}" if world.robot else ""
    yield f"{world.title}: {world.seconds:.3f} s simulated, gravity [{gravity}]{robot}"
    width = max((len(name) for name in world.bodies), default=0)
    for body in bodies:
        yield from _body(world, body, width, details=details)
        for following in world.following.values():
            begin = following.begin
            if begin.body == body.name:
                end = begin.trajectory.times[-1] if begin.trajectory.times else 0.0
                at = f"at {time_of(following, world.sim_step):.3f} of {end:.3f} s"
                moved = ", ".join(begin.trajectory.joints) or "base"
                slowing = ", slowing down" if following.stopped else ""
                yield f"    follows trajectory {begin.number} {at}{slowing}: {moved}"
        if links:
            yield from (f"    {_pose(link, 48, pose)}" for link, pose in state.link_poses(body).items())
    shown = {body.name for body in bodies}
    for belief in reversed(world.believed()):
        if {belief.robot, belief.object}.isdisjoint(shown):
            continue
        source, since = phrases.learned(belief.source, belief.step), belief.sim_step / STEPS_PER_SECOND
        away = math.dist(belief.position, world.bodies[belief.object].position)
        wrong = f"; its true position is {away:.3f} m away" if away >= NOTABLE_METRES else ""
        position = ", ".join(f"{part:.4f}" for part in belief.position)
        yield f"  {belief.robot} believes {belief.object} at [{position}]: {source}, at {since:.3f} s{wrong}"


def _pose(name: str, width: int, pose: Pose) -> str:
    position = ", ".join(f"{part:8.4f}" for part in pose[0])
    return f"{name:{width}}  [{position}]  [{', '.join(f'{part:7.4f}' for part in pose[1])}]"


def _body(world: World, body: Body, width: int, *, details: bool) -> Iterator[str]:
    held = world.carrier(body.name)
    by = f"  held by {phrases.carrier(held)}" if held else ""
    yield f"  {_pose(body.name, width, body.pose)}{by}"
    if details:
        yield f"    type {body.type}{', fixed base' if body.fixed_base else ''}"
        if any(body.velocity):
            yield "    velocity [" + ", ".join(f"{part:.4f}" for part in body.velocity) + "]"
        for carried in world.carried(body.name):
            yield f"    holds {carried.body}" + (f" with {carried.carrier_link}" if carried.carrier_link else "")
        for joint, value in body.joints.items():
            yield f"    {joint:48} {value:9.5f}"


def add_diff(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: success. 1: the two recordings, or folders, differ. 3: a recording is incomplete."
    parser.add_argument("first", metavar="STEP|LOG", help=f"the first step ({HINT}), or the other recording or folder")
    parser.add_argument("second", metavar="STEP", nargs="?", help="the second step")
    parser.add_argument("--all", action="store_true", help="also print every joint, and small moves of objects")
    parser.add_argument("--tolerance", type=_tolerance, default=0.0, metavar="X", help="ignore differences up to X")


def _tolerance(text: str) -> float:
    value = float(text)
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} isn't a tolerance: expected a number of at least 0")
    return value


def run_diff(log: Recording, options: argparse.Namespace) -> int:
    if options.second is not None:
        delta = difference(log.state_at(options.first), log.state_at(options.second))
        print_result(lambda: report.data(delta), difference_lines(delta, whole=options.all), as_json=options.json)
        return FINE
    if not Path(options.first).exists():
        raise ReplayError(f"{options.first}: no such recording; to compare two steps of this recording, give both")
    with Recording(options.first) as other:
        compared = compare_recordings(log, other, options.tolerance)
        problems = other.problems  # these problems are known only after reading the whole recording
    print_result(lambda: report.data(compared), comparison_lines(compared, whole=options.all), as_json=options.json)
    if problems:
        print_message(f"{other.path} is incomplete: {problems}")
    if problems or log.problems:  # the difference may come from lost records
        return INCOMPLETE
    return FAILED if compared.divergence is not None or compared.difference else FINE


def run_folder_diff(runs: Runs, options: argparse.Namespace) -> int:
    from replay.runs.statistics import compare_folders, lines  # noqa: PLC0415  needs an extra

    if options.second is not None or not Path(options.first).is_dir():
        raise ReplayError("diff compares two folders, two recordings, or two steps of a recording")
    with opened(options.first) as second:
        found = compare_folders(runs, second)
        for left_out in second.skipped:
            print_message(f"left out: {second.path}: {left_out.name}: {left_out.reason}")
        print_result(lambda: report.data(found), lines(found, runs.path, second.path), as_json=options.json)
        return INCOMPLETE if second.skipped else FAILED if found else FINE
