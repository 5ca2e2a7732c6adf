"""What a robot would touch in other postures or at another place (thesis 4.4.6): tried in a twin, never in the world.

One rehearsal tries many postures: the twin is brought to the world's state once. For each posture the engine's tree of
boxes says which links could touch at all; only these pairs are looked at closely, so that the cost is in what is near.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram import cargo
from pycram.reasoning.twin import twin
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from types import TracebackType

    from typing_extensions import Self

    from pycram.body import Body
    from pycram.engine import Touch
    from pycram.objects import Object
    from recorder.geometry import Pose

DEPTH: Final = 2e-3  # m of overlap below which shapes, which the engine pads, don't count as in the way
_OWN_DEPTH: Final = 0.02  # m; the robot's own shapes are hulls, which overlap where the robot doesn't
_STANDING: Final = 0.9  # of a normal's length pointing up
_FEET: Final = 0.02  # m above the ground
_BESIDE: Final = 3  # joints between links whose limits keep them apart; their hulls overlap


class Rehearsal:
    """A robot that is put into postures in a twin. Use it as a context manager, with the world's lock held.

    Args:
        robot: the robot.
        joints: names of the joints that will be moved; what they don't move isn't looked at.
        ignored: objects that don't count.
        everything: look at all links of the robot, not just those that the joints move.
    """

    def __init__(
        self,
        robot: Object,
        joints: Iterable[str],
        ignored: Iterable[Object] = (),
        *,
        everything: bool = False,
    ) -> None:
        world = robot.world
        self.robot = robot
        self._twin = twin(world, "reach")
        self._engine = self._twin.engine
        bodies = self._twin.sync()
        self._body = bodies[robot.name]
        self._joints = tuple(joints)
        moved = set(cargo.moved_links(robot.urdf, self._joints))
        self._moving = set(robot.links) if everything else moved
        self._held = [(other, bodies[other.name], link, pose) for other, link, pose in _held(robot)]
        self._movers = [(robot, self._body, [link for link in robot.links if link in self._moving])]
        self._movers += [
            (other, body, list(other.links)) for other, body, link, _ in self._held if link in self._moving
        ]
        skipped = {robot, *(other for other, *_ in self._held), *ignored}
        self._obstacles = {bodies[other.name].id: other for other in world.objects if other not in skipped}
        self._bodies = bodies
        self._names: dict[int, dict[int, str]] = {}
        self._depth = _arm_depths(robot, self._joints)
        self._near: list[tuple[Object, Body, str, int, int]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._twin.disturbed(self.robot.name, *(other.name for other, *_ in self._held))

    def take(self, positions: Mapping[str, float], base: Pose | None = None) -> None:
        """Puts the robot into a posture.

        Args:
            positions: joint values in rad or m by name; the others stay.
            base: pose of its base; it stays by default.
        """
        engine = self._engine
        if base is not None:
            engine.set_pose(self._body, base)
        engine.pose_joints(self._body, positions)
        for _, body, link, pose in self._held:
            engine.set_pose(body, geometry.multiply(engine.link_pose(self._body, link), pose))
        engine.refresh()
        self._near = [
            (mover, body, link, number, index)
            for mover, body, links in self._movers
            for link in links
            for number, index in engine.near(*engine.box(body, link))
        ]

    def touched(self) -> dict[Object, dict[str, object]]:
        """What it touches in the posture that it has taken.

        Returns:
            For each object, the robot's links that touch it, its own links, and the depth in m; deepest first. The
            floor that a robot stands on isn't in the way of its wheels; what it holds moves along and may be in the way
            of others too.
        """
        found: dict[Object, list[Touch]] = {}
        for mover, body, link, number, index in self._near:
            other = self._obstacles.get(number)
            if other is None:
                continue
            obstacle = self._bodies[other.name]
            standing = mover.is_robot and other.is_environment
            for touch in self._engine.link_touches(body, link, obstacle, link_b=self._name(obstacle, index)):
                if touch.distance <= -DEPTH and not (standing and _carries_wheels(touch)):
                    found.setdefault(other, []).append(touch)
        told = {other: _told(touches) for other, touches in found.items()}
        return dict(sorted(told.items(), key=lambda item: (-float(str(item[1]["depth"])), item[0].name)))

    def touches_itself(self) -> list[tuple[str, str]]:
        """Pairs of its own links, more than a shoulder apart, that overlap in the posture that it has taken."""
        found = []
        for mover, _, link, number, index in self._near:
            if mover is not self.robot or number != self._body.id:
                continue
            other = self._name(self._body, index)
            if other in self._moving and other <= link:
                continue  # seen from the other side
            if abs(self._depth[link] - self._depth[other]) <= _BESIDE:
                continue
            touches = self._engine.link_touches(self._body, link, self._body, link_b=other)
            if any(touch.distance <= -_OWN_DEPTH for touch in touches):
                found.append((link, other))
        return found

    def settled(self, link: str | None) -> set[str]:
        """The robot's links that are where they are whatever the joints do.

        Args:
            link: stays at one pose as well, as the hand in all postures for one grasp.
        """
        depths = {0} if link is None else {0, self._depth[link]}
        return {other for other, depth in self._depth.items() if depth in depths}

    def _name(self, body: Body, index: int) -> str:
        names = self._names.get(body.id)
        if names is None:
            names = self._names[body.id] = {number: name for name, number in body.links.items()}
        return names[index]


def _told(touches: list[Touch]) -> dict[str, object]:
    return {
        "links": sorted({touch.link_a for touch in touches}),
        "by": sorted({touch.link_b for touch in touches}),
        "depth": max(-touch.distance for touch in touches),
    }


def _arm_depths(robot: Object, joints: Iterable[str]) -> dict[str, int]:
    """How many of the joints each link hangs on."""
    named = set(joints)
    depth: dict[str, int] = {}
    for link in robot.urdf.links:  # parents come before their children
        joint = robot.urdf.parent_joint(link)
        depth[link] = 0 if joint is None else depth[joint.parent] + (joint.name in named)
    return depth


def _held(robot: Object) -> list[tuple[Object, str, Pose]]:
    """What a robot carries, directly and through other things: object, the robot's link, pose in that link."""
    held: list[tuple[Object, str, Pose]] = []
    queue = [(attachment.body, attachment.carrier_link) for attachment in robot.carried]
    while queue:
        body, link = queue.pop()
        link_T_world = geometry.invert(robot.get_link_position_and_orientation(link))
        held.append((body, link, geometry.multiply(link_T_world, body.get_position_and_orientation())))
        queue.extend((attachment.body, link) for attachment in body.carried)
    return held


def _carries_wheels(touch: Touch) -> bool:
    """Whether a robot stands there rather than bumps: a contact from below, at the height of its base's feet."""
    return touch.normal[2] > _STANDING and touch.position_b[2] < _FEET


def in_the_way(
    robot: Object,
    positions: Mapping[str, float],
    ignored: Iterable[Object] = (),
    base: Pose | None = None,
    *,
    everything: bool = False,
) -> dict[Object, dict[str, object]]:
    """What a robot would touch in one other posture or at one other place; see :meth:`Rehearsal.touched`.

    Args:
        robot: the robot.
        positions: joint values in rad or m by name that differ from the present ones.
        ignored: objects that don't count.
        base: pose of the robot's base; the present one by default.
        everything: count all links of the robot; else only those that the joints move.
    """
    with Rehearsal(robot, positions, ignored, everything=everything) as rehearsal:
        rehearsal.take(positions, base)
        return rehearsal.touched()
