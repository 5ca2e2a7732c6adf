"""``state``: poses, joints and attachments after a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.fold import state_at
from replay.steps import step_of

if TYPE_CHECKING:
    import argparse

    from replay.log import Log
    from replay.state import Body, World

HELP = "poses, joints and attachments after a step"


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step and an object."""
    parser.add_argument("step", metavar="STEP", help="number, -1, last, failure, or 12.5s")
    parser.add_argument("object", nargs="?", help="only this one, with its joints")


def run(log: Log, options: argparse.Namespace) -> tuple[object, str]:
    """Folds the records up to the step.

    Returns:
        The state, for machines and for people.
    """
    state = state_at(log, step_of(log, options.step))
    facts: dict[str, object] = {"step": state.step, "worlds": {}}
    lines = [f"after step {state.step}"]
    for world in state.worlds.values():
        bodies = [world.body(options.object)] if options.object else list(world.bodies.values())
        facts["worlds"] = {**dict(facts["worlds"]), world.name: _facts(world, bodies)}  # type: ignore[call-overload]
        lines.append(f"{world.name}: {world.sim_step / 240:.3f} s simulated, gravity {list(world.gravity)}")
        lines += [line for body in bodies for line in _lines(body, joints=bool(options.object))]
        lines += [
            f"  {held.carrier} holds {held.body} with {held.carrier_link}"
            for held in world.attachments.values()
            if not options.object or options.object in (held.carrier, held.body)
        ]
    return facts, "\n".join(lines)


def _facts(world: World, bodies: list[Body]) -> dict[str, object]:
    return {
        "sim_step": world.sim_step,
        "gravity": list(world.gravity),
        "robot": world.robot,
        "bodies": {
            body.name: {
                "type": body.type,
                "position": list(body.position),
                "orientation": list(body.orientation),
                "joints": body.joints,
            }
            for body in bodies
        },
        "attachments": [
            {"carrier": held.carrier, "link": held.carrier_link, "body": held.body}
            for held in world.attachments.values()
        ],
    }


def _lines(body: Body, *, joints: bool) -> list[str]:
    position = ", ".join(f"{x:8.4f}" for x in body.position)
    turn = ", ".join(f"{x:7.4f}" for x in body.orientation)
    lines = [f"  {body.name:14} [{position}]  [{turn}]"]
    if joints:
        lines += [f"    {joint:48} {value:9.5f}" for joint, value in body.joints.items()]
    return lines
