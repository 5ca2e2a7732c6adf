"""``pycram describe``: writes a first description to stdout, or checks one; of furniture, what is found in it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pycram.describing import furniture
from pycram.describing.check import check
from pycram.describing.describe import describe
from pycram.foundation.failures import AssetError
from pycram.models import load, robot_urdfs
from pycram.models.robots.description import RobotDescription
from pycram.world.object import Object
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    import argparse

    from pycram.models.load import Model

_FINE, _FAILED, _WRONG_USAGE = 0, 1, 2  # exit codes


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code: 0 if all is well, 1 if a check failed, 2 for wrong usage."""
    if options.file is None and options.check is None:
        return _refused("it takes a URDF, or --check with a description")
    try:
        if options.file and not options.check and furniture.is_furniture(model := load.load(options.file)):
            return _furniture(model, options)
        text = None if options.check else describe(options.file)
        if options.check:
            description = RobotDescription.load(options.check)
        else:
            description = RobotDescription.parse(text or "", "the first description")
        return _check(description, options) if options.check else _write(text or "", description, options)
    except AssetError as error:
        return _refused(str(error))


def _write(text: str, description: RobotDescription, options: argparse.Namespace) -> int:
    print(text, end="")
    if options.picture:
        with BulletWorld() as world:
            _draw(_loaded(description, options.file, world), options.picture)
    return _FINE


def _furniture(model: Model, options: argparse.Namespace) -> int:
    print(furniture.describe(model, options.file), end="")
    if options.picture:
        with BulletWorld() as world:
            _draw(Object(model.urdf.name or "furniture", "environment", options.file, world=world), options.picture)
    return _FINE


def _check(description: RobotDescription, options: argparse.Namespace) -> int:
    urdf = options.file or _urdf_of(description)
    if urdf is None:
        return _refused(f"{options.check} describes {description.robot}, which isn't in the box: name its URDF, too")
    with BulletWorld() as world:
        robot = _loaded(description, urdf, world)
        failed = 0
        for finding in check(robot, description):
            print(finding)
            failed += not finding.passed
        if options.picture:
            _draw(robot, options.picture)
    print(f"{failed} of the checks failed" if failed else "all checks passed", file=sys.stderr)
    return _FAILED if failed else _FINE


def _loaded(description: RobotDescription, urdf: str, world: BulletWorld) -> Object:
    """Load a robot high above the ground, where nothing holds it; its arms are parked."""
    robot = Object(description.robot, "robot", urdf, [0.0, 0.0, 1.0], world=world, description=description)
    for arm in description.arms.values():
        if "park" in arm.poses:
            robot.set_joint_positions(arm.posture("park"))
    return robot


def _draw(body: Object, file: Path) -> None:
    from pycram.describing.picture import draw  # noqa: PLC0415  needs the extra for pictures

    try:
        draw(body, file)
    except (OSError, ValueError) as error:  # ValueError: of a name that is no picture's
        raise AssetError(file, str(error)) from error
    print(f"picture in {file}", file=sys.stderr)


def _urdf_of(description: RobotDescription) -> str | None:
    """Return the URDF in the box of a robot with that name."""
    for name in robot_urdfs.NAMES:
        if description.robot in (Path(name).stem, f"{Path(name).stem}_with_gripper"):
            return name
    return None


def _refused(reason: str) -> int:
    print(f"pycram describe: {reason}", file=sys.stderr)
    return _WRONG_USAGE
