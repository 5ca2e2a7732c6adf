"""What the recorded descriptions of robots say of tool frames and cameras; nothing where they don't say it."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Pose
    from recorder.records import LoadBody


def table(robot: LoadBody, name: str) -> Mapping[str, Any]:
    """A table of a robot's description; empty if there is none."""
    try:
        found = tomllib.loads(robot.robot_description).get(name, {})
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def offset(described: Mapping[str, Any], name: str) -> Pose:
    """A described pose in a link; by default the link's own."""
    found = described.get(name, {})
    x, y, z = found.get("xyz", (0.0, 0.0, 0.0))
    return (x, y, z), geometry.from_rpy(*found.get("rpy", (0.0, 0.0, 0.0)))
