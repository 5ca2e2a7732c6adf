"""``state``: poses, joints and attachments after a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli.console import print_json, remark, tell
from replay.explain.step_names import HINT
from replay.state.json_data import state_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.recording import Recording
    from replay.state.state import Body, World


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step and an object."""
    parser.add_argument("step", metavar="STEP", help=HINT)
    parser.add_argument("object", metavar="OBJECT", nargs="?", help="only this one, with its joints")
    parser.add_argument("--world", metavar="NAME", help="only this world")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the state."""
    state = log.state_at(options.step)
    if options.object is not None:
        state.body(options.object, options.world)
    elif options.world is not None:
        state.world(options.world)
    if state.doubt:
        remark(state.doubt)
    told = state_data(state, options.object, options.world)
    if options.json:
        print_json(told)
        return 0
    tell(f"after step {state.step}")
    for world in state.worlds.values():
        if options.world in (None, world.name) and (options.object is None or options.object in world.bodies):
            for line in _world(world, options.object):
                tell(line)
    return 0


def _world(world: World, only: str | None) -> Iterator[str]:
    if not world.open:
        yield f"{world.title}: closed"
        return
    gravity = ", ".join(f"{part:g}" for part in world.gravity)
    robot = f", robot {world.robot}" if world.robot else ""
    yield f"{world.title}: {world.seconds:.3f} s simulated, gravity [{gravity}]{robot}"
    width = max((len(name) for name in world.bodies), default=0)
    for body in world.bodies.values():
        if only in (None, body.name):
            yield from _body(world, body, width, whole=only is not None)


def _body(world: World, body: Body, width: int, *, whole: bool) -> Iterator[str]:
    position = ", ".join(f"{part:8.4f}" for part in body.position)
    turn = ", ".join(f"{part:7.4f}" for part in body.orientation)
    held = world.carrier(body.name)
    by = f"  held by {held.carrier}" + (f" ({held.carrier_link})" if held.carrier_link else "") if held else ""
    yield f"  {body.name:{width}}  [{position}]  [{turn}]{by}"
    if whole:
        yield f"    type {body.type}{', fixed base' if body.fixed_base else ''}"
        if any(body.velocity):
            yield "    velocity [" + ", ".join(f"{part:.4f}" for part in body.velocity) + "]"
        for other in world.carried(body.name):
            yield f"    holds {other.body}" + (f" with {other.carrier_link}" if other.carrier_link else "")
        for joint, value in body.joints.items():
            yield f"    {joint:48} {value:9.5f}"
