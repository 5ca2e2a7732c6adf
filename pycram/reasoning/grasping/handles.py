"""Handles of doors and drawers: where they are at each value of their joint, and how a gripper may hold them.

A handle is a bar. A gripper takes it from the front, as the robot faces it when it is closed, the fingers across the
bar; what was opened is closed in the same way. The gripper may be turned about the bar, also while it moves, and sit
beside its middle.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.surfaces import closed_position
from pycram.models.visual import shapes_of
from pycram.reasoning.collision.ray_cast import half_extent
from pycram.reasoning.grasping.sides import grasp_orientation
from pycram.world import carried
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.models.robots.description import Gripper
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion, Vector

ANGLES: Final = tuple(math.radians(angle) for angle in range(-90, 91, 30))
"""Rad about the bar, by which a gripper may be turned from the front."""

#: Of the way from the bar's middle to where the gripper would reach over its end.
_SHIFTS: Final = {"middle": 0.0, "one side": 0.5, "other side": -0.5}


@dataclass(frozen=True, slots=True)
class Grip:
    """How a gripper holds a handle.

    Attributes:
        name: which part of the bar it holds.
        position: of the middle of what it holds, in the handle's frame, m.
        axis: along the bar, in the handle's frame.
        front: orientation of the tool in the handle's frame when it comes from the front.
        back: m that the tool stays before the position.
    """

    name: str
    position: Vector
    axis: Vector
    front: Quaternion
    back: float

    def tool(self, angle: float) -> Pose:
        """Return the pose of the tool in the handle's frame, turned about the bar by an angle in rad."""
        sine = math.sin(angle / 2)
        x, y, z = self.axis
        turn = geometry.product((x * sine, y * sine, z * sine, math.cos(angle / 2)), self.front)
        return geometry.transform((self.position, turn), (-self.back, 0.0, 0.0)), turn


class Handle:
    """A handle of a door or drawer.

    Args:
        container: the furniture.
        joint: its joint.
        link: the handle.
    """

    def __init__(self, container: Object, joint: str, link: str) -> None:
        self.container, self.joint, self.link = container, joint, link
        self._root = container.get_position_and_orientation()
        self._now = container.get_joint_positions()
        self._poses: dict[tuple[float, str], Pose] = {}  # each is asked for in many postures of an arm
        self.closed = closed_position(container.urdf.joint(joint))

    def pose(self, value: float, link: str | None = None) -> Pose:
        """Return the pose of the handle, or of another link, in the world when its joint is at a value."""
        key = value, link or self.link
        if key not in self._poses:
            at = self.container.urdf.forward_kinematics({**self._now, self.joint: value}, key[1])
            self._poses[key] = geometry.multiply(self._root, at)
        return self._poses[key]

    @cached_property
    def moved(self) -> Sequence[str]:
        """The links with shapes that the joint moves."""
        solid = shapes_of(self.container.model.path, "collision").links
        return [link for link in carried.moved_links(self.container.urdf, [self.joint]) if link in solid]

    @cached_property
    def contents(self) -> Mapping[Object, tuple[str, Pose]]:
        """What lies in or on what the joint moves, and moves along: the link that carries each, and its pose there."""
        carrying = carried.supported_bodies(self.container, carried.moved_links(self.container.urdf, [self.joint]))
        found = {}
        for body, link in carrying.items():
            link_T_world = geometry.invert(self.pose(self._now[self.joint], link))
            found[body] = link, geometry.multiply(link_T_world, body.get_position_and_orientation())
        return found

    def grips(self, robot: Object, gripper: Gripper, base: Pose | None = None) -> Sequence[Grip]:
        """Return how a gripper may hold it, the most natural first.

        Args:
            robot: the robot.
            gripper: its gripper.
            base: pose that the robot's base is taken to have; where it stands by default.
        """
        low, high = self._box()
        middle = (low + high) / 2
        bar = int(np.argmax(high - low))
        axis = np.eye(3)[bar]
        closed = self.pose(self.closed)
        handle_T_world = geometry.invert(closed)
        front = geometry.product(handle_T_world[1], self._front(robot, closed[1], high - low, base))
        forward = geometry.rotate(front, (1.0, 0.0, 0.0))
        back = max(half_extent(low.tolist(), high.tolist(), forward) - gripper.depth, 0.0)
        beside = max((high - low)[bar] / 2 - gripper.underside, 0.0)
        x, y, z = axis.tolist()
        grips = []
        for name, shift in _SHIFTS.items() if beside else (("middle", 0.0),):
            at = middle + shift * beside * axis
            grips.append(Grip(name, (float(at[0]), float(at[1]), float(at[2])), (x, y, z), front, back))
        return grips

    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner of its shapes in its frame; a point if it has none."""
        shapes = shapes_of(self.container.model.path, "collision")
        if self.link not in shapes.links:
            return np.zeros(3), np.zeros(3)
        number = shapes.links.index(self.link)
        return shapes.low[number], shapes.high[number]

    @staticmethod
    def _front(robot: Object, turn: Quaternion, size: np.ndarray, base: Pose | None) -> Quaternion:
        """Return the orientation of the tool in the world: from the front, the fingers across the bar."""
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
        width = np.ptp(corners @ geometry.to_matrix(turn).T, axis=0)
        tool = grasp_orientation("front", robot, base)
        _, y, _ = geometry.rotate(tool, (0.0, 1.0, 0.0))
        across = abs(y) * width[1] + math.sqrt(max(0.0, 1 - y * y)) * width[0]
        if across > width[2]:  # a bar that lies
            tool = geometry.product(tool, geometry.from_rpy(math.pi / 2, 0.0, 0.0))
        return tool
