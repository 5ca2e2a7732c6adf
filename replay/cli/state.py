"""``state``: poses, joints and attachments after a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli import formatting
from replay.cli.arguments import add_step
from replay.cli.console import print_message, print_result
from replay.state.json_data import state_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.recording import Recording
    from replay.state.state import Body, State, World


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, an object and a world."""
    add_step(parser)
    parser.add_argument("object", metavar="OBJECT", nargs="?", help="only this one, with its joints")
    parser.add_argument("--world", metavar="NAME", help="only this world")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the state."""
    state = log.state_at(options.step)
    if options.object is not None:
        state.body(options.object, options.world)
    elif options.world is not None:
        state.world(options.world)
    if state.uncertainty:
        print_message(state.uncertainty)
    print_result(
        lambda: state_data(state, options.object, options.world),
        _lines(state, options.object, options.world),
        as_json=options.json,
    )
    return 0


def _lines(state: State, body: str | None, name: str | None) -> Iterator[str]:
    yield f"after step {state.step}"
    for world in state.worlds.values():
        if name in (None, world.name) and (body is None or body in world.bodies):
            yield from _world(world, body)


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
            yield from _body(world, body, width, details=only is not None)


def _body(world: World, body: Body, width: int, *, details: bool) -> Iterator[str]:
    position = ", ".join(f"{part:8.4f}" for part in body.position)
    turn = ", ".join(f"{part:7.4f}" for part in body.orientation)
    held = world.carrier(body.name)
    by = f"  held by {formatting.carrier(held)}" if held else ""
    yield f"  {body.name:{width}}  [{position}]  [{turn}]{by}"
    if details:
        yield f"    type {body.type}{', fixed base' if body.fixed_base else ''}"
        if any(body.velocity):
            yield "    velocity [" + ", ".join(f"{part:.4f}" for part in body.velocity) + "]"
        for carried in world.carried(body.name):
            yield f"    holds {carried.body}" + (f" with {carried.carrier_link}" if carried.carrier_link else "")
        for joint, value in body.joints.items():
            yield f"    {joint:48} {value:9.5f}"
