"""What a recorded robot's description says of its arms, torso and head; nothing where it isn't on record."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from replay.state.state import Body


def hands(robot: Body | None) -> dict[str, str]:
    """Return the tool frames of a robot's arms, by the arms' names."""
    return {name: str(arm.get("tool_frame", "")) for name, arm in _arms(_description(robot)).items()}


def joints_of(robot: Body | None, part: str) -> tuple[str, ...]:
    """Return the joints of the torso, the head or an arm."""
    description = _description(robot)
    found = description.get(part) or _arms(description).get(part) or {}
    joints = [*found.get("joints", ()), found.get("joint"), found.get("pan"), found.get("tilt")]
    return tuple(str(name) for name in joints if name)


def _description(robot: Body | None) -> dict[str, Any]:
    try:
        return tomllib.loads(robot.loaded.robot_description) if robot is not None else {}
    except tomllib.TOMLDecodeError:
        return {}


def _arms(description: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {name: arm for name, arm in description.get("arms", {}).items() if isinstance(arm, dict)}
