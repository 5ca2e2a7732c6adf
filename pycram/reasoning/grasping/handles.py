"""Handles of doors and drawers: how a gripper holds a handle, and the path of an arm that moves the handle.

A handle is a bar. The gripper takes the bar of a closed door or drawer from the front, with the fingers across the bar.
The gripper may turn about the bar during the motion, and may hold the bar off its middle. If an arm has no path,
:func:`remedies` finds another arm or another place of the robot.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.failures import CollisionPair
from pycram.models.shapes import shapes_of
from pycram.models.surfaces import closed_position
from pycram.physics.body import LoadedBody
from pycram.reasoning.choosing import UNRECORDED, Choice
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.checker import DEPTH, CollisionChecker, PostureCandidate
from pycram.reasoning.collision.ray_cast import half_extent
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping.grasps import grasp_orientation
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.rejections import Contorted, OutOfReach, Rejection, Touching
from pycram.world import attachment
from recorder import geometry
from recorder.geometry import Array, Pose, Quaternion, Vector

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm, Gripper
    from pycram.world.object import Object


ANGLES: Final = tuple(math.radians(angle) for angle in range(-90, 91, 30))
"""Allowed turns in rad of a gripper about the bar of a handle; at 0 the gripper comes from the front."""

#: Places of the gripper on the bar, as shares of the distance from the bar's middle to the last possible place.
_SHIFTS: Final = {"middle": 0.0, "one side": 0.5, "other side": -0.5}
_MAX_TURN: Final = math.radians(31)  # largest turn in rad about the bar between successive joint positions
_MAX_JUMP: Final = 1.6  # largest motion in rad of an arm's joint between successive joint positions
_TURNED: Final = 1.0  # cost of a gripper's angle about the bar, per square rad; a joint's motion costs 1 per square rad
_TURNING: Final = 1.0  # cost of a gripper's turn about the bar between successive joint positions, per square rad
_APPROACH: Final = 0.01  # cost of a joint's motion from the present to the first posture, per square rad
_MAX_PATHS: Final = 40  # maximum number of checked paths
_MAX_QUICK_PATHS: Final = 8  # maximum number of checked paths in a quick search
_SAME_HEIGHT: Final = 0.02  # maximum difference in m between equal torso heights
_STEP: Final = 0.15  # distance in m between tried places of the robot
_STEPS: Final = 5  # number of tried places on each side
_MAX_PLACES: Final = 4  # maximum number of places for which a path is searched


@dataclass(frozen=True, slots=True)
class Grip:
    """A way in which a gripper holds a handle."""

    name: str  # name of the grasped part of the bar
    position: Vector  # middle of the grasped part in the handle's frame, m
    axis: Vector  # direction of the bar in the handle's frame
    front: Quaternion  # orientation of a tool that comes from the front, in the handle's frame
    back: float  # distance in m between the tool and ``position``

    def tool(self, angle: float) -> Pose:
        """Return the pose of the tool in the handle's frame after a turn about the bar by an angle in rad."""
        sine = math.sin(angle / 2)
        x, y, z = self.axis
        turn = geometry.product((x * sine, y * sine, z * sine, math.cos(angle / 2)), self.front)
        return geometry.transform((self.position, turn), (-self.back, 0.0, 0.0)), turn


class Handle:
    """A handle of a door or drawer, in the present state of the furniture."""

    def __init__(self, container: Object, joint: str, link: str) -> None:
        self.container, self.joint, self.link = container, joint, link
        self._root = container.get_position_and_orientation()
        self._now = container.get_joint_positions()
        self.closed = closed_position(container.urdf.joint(joint))

    def pose(self, value: float, link: str | None = None) -> Pose:
        """Return the pose of the handle, or of another link, in the world at a position of the joint."""
        at = self.container.urdf.forward_kinematics({**self._now, self.joint: value}, link or self.link)
        return geometry.multiply(self._root, at)

    @cached_property
    def moved(self) -> Sequence[str]:
        """The links with shapes that the joint moves."""
        solid = shapes_of(self.container.model.path, "collision").links
        return [link for link in attachment.moved_links(self.container.urdf, [self.joint]) if link in solid]

    @cached_property
    def contents(self) -> Mapping[Object, tuple[str, Pose]]:
        """Objects on or in the moved links, with the link that carries each object and the object's pose in it."""
        moved = attachment.moved_links(self.container.urdf, [self.joint])
        found = {}
        for body, link in attachment.supported_bodies(self.container, moved).items():
            link_T_world = geometry.invert(self.pose(self._now[self.joint], link))
            found[body] = link, geometry.multiply(link_T_world, body.get_position_and_orientation())
        return found

    def grips(self, robot: Object, gripper: Gripper, base: Pose | None = None) -> Sequence[Grip]:
        """Return the ways in which a gripper can hold the handle, the most natural way first."""
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
        """Return the lowest and highest corner of the handle in its frame; without shapes, both are the origin."""
        shapes = shapes_of(self.container.model.path, "collision")
        if self.link not in shapes.links:
            return np.zeros(3), np.zeros(3)
        number = shapes.links.index(self.link)
        return shapes.low[number], shapes.high[number]

    @staticmethod
    def _front(robot: Object, turn: Quaternion, size: np.ndarray, base: Pose | None) -> Quaternion:
        """Return the orientation of the tool in the world, from the front and with the fingers across the bar."""
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
        width = np.ptp(corners @ geometry.to_matrix(turn).T, axis=0)
        tool = grasp_orientation("front", robot, base)
        _, y, _ = geometry.rotate(tool, (0.0, 1.0, 0.0))
        across = abs(y) * width[1] + math.sqrt(max(0.0, 1 - y * y)) * width[0]
        if across > width[2]:  # a horizontal bar
            tool = geometry.product(tool, geometry.from_rpy(math.pi / 2, 0.0, 0.0))
        return tool


@dataclass(frozen=True, slots=True)
class HandlePath:
    """Postures of an arm, and of the torso if the torso must move: one for each position of the handle's joint."""

    values: Sequence[float]
    postures: Sequence[Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class DeadEnd:
    """Why there is no path of an arm."""

    value: float  # position of the handle's joint that the arm doesn't reach
    reached: float | None  # the last position that the arm reaches; None if the arm reaches no position
    position: Vector  # position of the tool at ``value``, in the world, m
    orientation: Quaternion  # orientation of the tool from the front at ``value``, xyzw
    distance: float | None = None  # distance in m from the tool to its goal in the nearest posture; None at the goal
    turn: float = 0.0  # angle in rad between the tool and its goal in the nearest posture
    pairs: Sequence[CollisionPair] = ()  # links that would touch if the arm reaches ``value``

    def rejection(self) -> Rejection:
        """Return the reason for a rejection of the path."""
        if self.pairs:
            return Touching(self.pairs)
        return Contorted(self.value) if self.distance is None else OutOfReach(self.distance, self.turn)


@dataclass(frozen=True, slots=True)
class _Layer:
    """Postures for one position of the handle's joint: the nodes of one layer in the graph of the search."""

    joints: Array  # (n, joints) joint positions of the arm, rad or m
    angles: Array  # (n,) angles of the gripper about the bar, rad


def plan_path(
    robot: Object,
    arm: Arm,
    handle: Handle,
    values: Sequence[float],
    base: Pose | None = None,
    *,
    others: Mapping[str, float] | None = None,
    quick: bool = False,
    choice: Choice = UNRECORDED,
) -> HandlePath | DeadEnd:
    """Return the path of an arm that holds a handle while the handle's joint moves through positions, rad or m.

    The first of these ``values`` is the joint's present position. ``others`` are assumed positions of other joints,
    such as the torso, rad or m; joints without a position don't move.
    """
    ignored = {(handle.container, link) for link in attachment.moved_links(handle.container.urdf, [handle.joint])}
    kept = arm.gripper.positions("open") | dict(others or {})
    joints = [*arm.joints, *kept]
    grips = handle.grips(robot, arm.gripper, base)
    ends: list[DeadEnd] = []
    try:
        with CollisionChecker(robot, joints, handle.contents, ignored_links=ignored) as checker:
            search = _Search(robot, arm, handle, values, base, kept, checker, quick=quick)
            holds = [(grips[0], ANGLES)] if quick else [(grip, angles) for angles in ((0.0,), ANGLES) for grip in grips]
            for grip, angles in holds:
                name = f"{grip.name}, {'from the front' if len(angles) == 1 else 'turned'}"
                if not choice.admits(name):
                    continue
                found = search.path(grip, angles)
                if isinstance(found, HandlePath):
                    choice.take(name)
                    return found
                choice.reject(name, found.rejection())
                ends.append(found)
    finally:
        clone_of(robot.world, "reach").invalidate(handle.container.name, *(body.name for body in handle.contents))
    return max(ends, key=lambda end: -1.0 if end.reached is None else abs(end.reached - values[0]))


def plan_path_with_torso(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], choice: Choice = UNRECORDED
) -> HandlePath | None:
    """Return a path with the torso at another height: the nearest height that allows a path; see :func:`plan_path`."""
    torso = robot.description.torso if robot.description else None
    if torso is None:
        return None
    lower, upper = robot.joint_limits(torso.joint)
    now = robot.get_joint_position(torso.joint)
    for height in sorted((lower, (lower + upper) / 2, upper), key=lambda height: abs(height - now)):
        if abs(height - now) > _SAME_HEIGHT:
            path = plan_path(robot, arm, handle, values, others={torso.joint: height}, choice=choice)
            if isinstance(path, HandlePath):
                return path
    return None


class _Search:
    """The search for a path; see :func:`plan_path`. ``kept`` has the positions of joints outside the arm."""

    def __init__(
        self,
        robot: Object,
        arm: Arm,
        handle: Handle,
        values: Sequence[float],
        base: Pose | None,
        kept: dict[str, float],
        checker: CollisionChecker,
        *,
        quick: bool,
    ) -> None:
        self._robot, self._arm, self._handle = robot, arm, handle
        self._quick = quick
        self._values, self._base, self._checker = values, base, checker
        self._clone = clone_of(robot.world, "reach")
        self._solver = Solver(robot, arm.tool_frame)
        torso = robot.description.torso if robot.description else None
        self._torso = torso.joint if torso is not None and torso.joint in kept else None
        self._lifted = base if self._torso is None else self._base_lifted(self._torso, kept[self._torso])
        self._poses = [handle.pose(value) for value in values]
        now = robot.get_joint_positions()
        self._now = np.array([now[name] for name in arm.joints])
        self._endless = np.array([not math.isfinite(robot.joint_limits(name)[1]) for name in arm.joints])
        self._kept = kept
        self._links = set(attachment.moved_links(robot.urdf, arm.joints))
        self._hand = checker.links_beyond(arm.joints)

    def _base_lifted(self, torso: str, height: float) -> Pose:
        """Return the pose of the base at which the arm is where the torso at a height in m would bring the arm."""
        robot, joint = self._robot, self._robot.urdf.joint(torso)
        base = robot.get_position_and_orientation()
        below = geometry.multiply(geometry.invert(base), robot.get_link_position_and_orientation(joint.parent))
        lift = geometry.multiply(joint.pose(height), geometry.invert(joint.pose(robot.get_joint_position(torso))))
        lift = geometry.multiply(geometry.multiply(below, lift), geometry.invert(below))
        return geometry.multiply(self._base or base, lift)

    def path(self, grip: Grip, angles: Sequence[float]) -> HandlePath | DeadEnd:
        """Return a path for a grip, or the dead end of the longest path."""
        layers = self._rigid(grip) if len(angles) == 1 else self._turning(grip, angles)
        edges = [self._edges(before, after) for before, after in itertools.pairwise(layers)]
        free = [np.zeros(len(layer.angles)) for layer in layers]  # infinity for nodes with a collision
        obstacles: dict[int, list[CollisionPair]] = {}
        nodes: list[int] = []
        checked: set[tuple[int, int]] = set()  # steps and nodes of the path; paths share most of their nodes
        for _ in range(_MAX_QUICK_PATHS if self._quick else _MAX_PATHS):
            nodes = self._cheapest(layers, edges, free)
            rows = (layers[step].joints[node].tolist() for step, node in enumerate(nodes))
            postures = [dict(zip(self._arm.joints, row, strict=True)) | self._kept for row in rows]
            unchecked = [step for step, node in enumerate(nodes) if (step, node) not in checked]
            checked.update((step, nodes[step]) for step in unchecked)
            touching = False
            candidates = self._checker.predict([postures[step] for step in unchecked], self._base)
            for step, candidate in zip(unchecked, candidates, strict=True):
                pairs = self._touching(candidate, self._values[step])
                if pairs:
                    touching = True
                    obstacles.setdefault(step, pairs)
                    free[step][self._alike(layers[step], nodes[step], pairs)] = np.inf
            if not touching and len(nodes) == len(layers):
                moved = [*self._arm.joints, *([self._torso] if self._torso else [])]
                return HandlePath(self._values, [{name: posture[name] for name in moved} for posture in postures])
            if not touching:
                break
        else:
            nodes = nodes[: min(obstacles)]
        return self._end(grip, layers, len(nodes), obstacles)

    def _alike(self, layer: _Layer, node: int, pairs: Sequence[CollisionPair]) -> Sequence[int]:
        """Return the nodes in which the touching links have the same pose: all nodes if no link belongs to the arm."""
        robot = self._robot.name
        own = ([pair.link, pair.body_link] if pair.body == robot else [pair.link] for pair in pairs)
        if any(self._links.isdisjoint(links) for links in own):
            return range(len(layer.angles))
        hand = any(pair.link in self._hand for pair in pairs)  # the gripper's angle determines the pose of the hand
        return np.flatnonzero(layer.angles == layer.angles[node]).tolist() if hand else [node]

    def _rigid(self, grip: Grip) -> list[_Layer]:
        """Return layers of postures with the gripper from the front; each search starts at the layer before."""
        layers = []
        seed = None
        for pose in self._poses:
            position, orientation = geometry.multiply(pose, grip.tool(0.0))
            target = position, orientation, self._lifted
            (found,) = self._solver.closed_form([target], seed)
            if not found:  # the arm has no closed form, or can't reach the pose
                (found,) = self._solver.search([target], seed=seed)
            rows = [posture.positions for posture in found if posture.reaches()]
            layers.append(self._layer([(row, 0.0) for row in rows]))
            if not rows:
                break
            seed = rows[0]
        return layers + [self._layer([])] * (len(self._poses) - len(layers))

    def _turning(self, grip: Grip, angles: Sequence[float]) -> list[_Layer]:
        """Return layers with the gripper at several angles about the bar."""
        tools = [geometry.multiply(pose, grip.tool(angle)) for pose in self._poses for angle in angles]
        targets = [(*tool, self._lifted) for tool in tools]
        found = self._solver.closed_form(targets)
        if not any(found) and not (self._quick and self._solver.in_closed_form):  # a search may find more
            found = self._solver.search(targets, quick=True)
        layers = []
        for start in range(0, len(found), len(angles)):
            rows = zip(angles, found[start : start + len(angles)], strict=True)
            good = [(each.positions, angle) for angle, some in rows for each in some if each.reaches()]
            layers.append(self._layer(good))
        return layers

    def _layer(self, found: Sequence[tuple[Mapping[str, float], float]]) -> _Layer:
        rows = [[positions[name] for name in self._arm.joints] for positions, _ in found]
        joints = np.array(rows, dtype=np.float64).reshape(-1, len(self._arm.joints))
        return _Layer(joints, np.array([angle for _, angle in found]))

    def _edges(self, before: _Layer, after: _Layer) -> Array:
        """Return the costs between the nodes of two successive layers; infinity for impossible steps."""
        change = self._change(before.joints, after.joints)
        turning = after.angles - before.angles[:, None]
        costs: Array = (change**2).sum(axis=2) + _TURNING * turning**2
        costs[(np.abs(change) > _MAX_JUMP).any(axis=2) | (np.abs(turning) > _MAX_TURN)] = np.inf
        return costs

    def _cheapest(self, layers: Sequence[_Layer], edges: Sequence[Array], free: Sequence[Array]) -> list[int]:
        """Return the nodes of the cheapest path through all layers, or through as many layers as possible."""
        first = _APPROACH * (self._change(self._now[None], layers[0].joints) ** 2).sum(axis=2)[0]
        costs = [first + _TURNED * layers[0].angles ** 2 + free[0]]
        origins: list[NDArray[np.intp]] = []
        while np.isfinite(costs[-1]).any():
            step = len(costs)
            if step == len(layers) or not len(layers[step].angles):
                break
            sums = costs[-1][:, None] + edges[step - 1]
            origins.append(sums.argmin(axis=0))
            costs.append(sums.min(axis=0) + _TURNED * layers[step].angles ** 2 + free[step])
        reached = [cost for cost in costs if np.isfinite(cost).any()]
        if not reached:
            return []
        nodes = [int(reached[-1].argmin())]
        for origin in reversed(origins[: len(reached) - 1]):
            nodes.append(int(origin[nodes[-1]]))
        return nodes[::-1]

    def _change(self, before: Array, after: Array) -> Array:
        """Return the changes (n, m, joints) between postures (n, joints) and (m, joints), rad or m."""
        change: Array = after - before[:, None]
        change[..., self._endless] = (change[..., self._endless] + math.pi) % (2 * math.pi) - math.pi
        return change

    def _touching(self, candidate: PostureCandidate, value: float) -> list[CollisionPair]:
        """Return the links that would touch at a position of the joint, also links of the moved door or drawer."""
        robot = self._robot.name
        pairs = [collision["pair"] for collision in self._checker.touched(candidate).values()]
        for body, link, part, pose in self._moving_along(value) if not pairs else ():
            self._clone.engine.set_pose(part, pose)
            depths: dict[str, float] = {}  # a pair of links may touch with several shapes
            for touch in self._checker.closest_points(candidate, part):
                if touch.distance <= -DEPTH and not (link == self._handle.link and touch.link_a in self._hand):
                    depths[touch.link_a] = max(depths.get(touch.link_a, 0.0), -touch.distance)
            pairs += [CollisionPair(robot, own, body, link, depth) for own, depth in depths.items()]
        pairs.sort(key=lambda pair: -pair.depth)
        return pairs or self._checker.self_collisions(candidate)

    def _moving_along(self, value: float) -> Iterator[tuple[str, str, LoadedBody, Pose]]:
        """Yield each link or object that the joint moves: name, link, copy, and pose at a position of the joint."""
        container = self._handle.container
        for link in self._handle.moved:
            yield container.name, link, self._clone.link(container, link), self._handle.pose(value, link)
        for body, (link, pose) in self._handle.contents.items():
            yield body.name, "", self._clone.body(body.name), geometry.multiply(self._handle.pose(value, link), pose)

    def _end(
        self, grip: Grip, layers: Sequence[_Layer], step: int, obstacles: Mapping[int, list[CollisionPair]]
    ) -> DeadEnd:
        position, orientation = geometry.multiply(self._poses[step], grip.tool(0.0))
        reached = self._values[step - 1] if step else None
        if not len(layers[step].angles):
            nearest = self._solver.search([(position, orientation, self._lifted)], quick=self._quick)[0][0]
            miss = nearest.position_error, nearest.turn_error
            return DeadEnd(self._values[step], reached, position, orientation, *miss)
        return DeadEnd(self._values[step], reached, position, orientation, pairs=obstacles.get(step, ()))


@dataclass(frozen=True, slots=True)
class Remedy:
    """An arm that could move the handle, perhaps from another place of the robot."""

    arm: str  # name of the arm
    base: Vector | None = None  # place of the robot with its present heading, m; None if the robot needn't move
    distance: float = 0.0  # distance in m from the robot's present place

    def __str__(self) -> str:
        place = "here" if self.base is None else f"[{', '.join(f'{part:.2f}' for part in self.base[:2])}]"
        return f"{self.arm} arm from {place}"

    def phrase(self) -> str:
        """Return the remedy as text."""
        if self.base is None:
            return f"the {self.arm} arm can move the handle from here"
        place = ", ".join(f"{part:.2f}" for part in self.base)
        return f"the {self.arm} arm can move the handle with the robot at [{place}], {self.distance:.2f} m from here"


def arms_in_the_way(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], pairs: Sequence[CollisionPair]
) -> list[str]:
    """Return texts about the arms that block an arm's path: whether parking them helps; see :func:`plan_path`."""
    found: list[str] = []
    for other in robot.description.arms.values() if robot.description else ():
        if other is not arm and any(_meets(robot, other, pair) for pair in pairs):
            path = plan_path(robot, arm, handle, values, others=other.posture("park"))
            helps = f"the {arm.name} arm can move the handle from here if the {other.name} arm is parked"
            no_help = f"the {other.name} arm is in the way even if it is parked"
            found.append(helps if isinstance(path, HandlePath) else no_help)
    return found


def _meets(robot: Object, arm: Arm, pair: CollisionPair) -> bool:
    """Return whether a pair contains a link of an arm, or an object in its hand."""
    links = attachment.moved_links(robot.urdf, arm.joints)
    own = {pair.link} if pair.mover == robot.name else set()
    own |= {pair.body_link} if pair.body == robot.name else set()
    holds = any(held.body.name == pair.body and held.carrier_link in links for held in robot.carried)
    return holds or pair.gripper == arm.name or not own.isdisjoint(links)


def remedies(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], choice: Choice = UNRECORDED
) -> list[Remedy]:
    """Return remedies for an arm without a path, with places near the robot, nearest first; see :func:`plan_path`."""
    description = robot.description
    arms = description.arms.values() if description else ()
    free = [other for other in arms if attachment.attached_to(robot, other.tool_frame) is None]
    found: list[Remedy] = []
    for other in free:
        if other is not arm:
            remedy, path = Remedy(other.name), plan_path(robot, other, handle, values)
            if isinstance(path, HandlePath) or plan_path_with_torso(robot, other, handle, values) is not None:
                found.append(remedy)
            else:
                choice.reject(str(remedy), path.rejection())
    drives = description is not None and description.drives
    for other in sorted(free if drives else (), key=lambda other: other is not arm):
        elsewhere = _from_elsewhere(robot, other, handle, values, choice)
        if elsewhere is not None:
            found.append(elsewhere)
            break
    if found:
        choice.take(str(found[0]))
    return found


def _from_elsewhere(robot: Object, arm: Arm, handle: Handle, values: Sequence[float], choice: Choice) -> Remedy | None:
    """Return the nearest place on a grid around the robot from which an arm has a path, with the present heading."""
    position, heading = robot.get_position_and_orientation()
    now: Pose = (position[0], position[1], position[2]), (heading[0], heading[1], heading[2], heading[3])
    steps = [_STEP * step for step in range(-_STEPS, _STEPS + 1)]
    nearby = sorted(itertools.product(steps, steps), key=lambda at: math.hypot(*at))[1:]  # without the present place
    bases: list[Pose] = [(geometry.transform(now, (x, y, 0.0)), now[1]) for x, y in nearby]
    tried = 0
    for base in _promising(robot, arm, handle, values, bases):
        remedy = Remedy(arm.name, base[0], math.dist(base[0], position))
        touched = checker.touched(robot, {}, base, all_links=True)
        if touched:
            choice.reject(str(remedy), Touching([collision["pair"] for collision in touched.values()]))
            continue
        path = plan_path(robot, arm, handle, values, base, quick=True)
        if isinstance(path, HandlePath):
            return remedy
        choice.reject(str(remedy), path.rejection())
        tried += 1
        if tried == _MAX_PLACES:
            break
    return None


def _promising(
    robot: Object, arm: Arm, handle: Handle, values: Sequence[float], bases: Sequence[Pose]
) -> Iterator[Pose]:
    """Yield places from which the arm can reach the handle at the first, the middle and the last joint position."""
    solver = Solver(robot, arm.tool_frame)
    grip = handle.grips(robot, arm.gripper)[0]
    picked = sorted({0, len(values) // 2, len(values) - 1})
    tools = [geometry.multiply(handle.pose(values[number]), grip.tool(angle)) for number in picked for angle in ANGLES]
    for base in bases:
        found = solver.closed_form([(*tool, base) for tool in tools])
        if np.array([bool(each) for each in found]).reshape(len(picked), len(ANGLES)).any(axis=1).all():
            yield base
