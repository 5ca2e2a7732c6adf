"""One physics client: the only module that talks to PyBullet.

Everything above speaks of bodies, links and joints by name and of poses of link frames as URDF defines them; ids,
indices and inertial frames stay in here. Every call names its client. PyBullet accepts nonsense without a word (NaN,
dead ids, meshes without shape), so callers check first; this module only translates.

The settings of a client decide what repeats bit for bit: overlapping pairs are ordered, and nothing else is touched.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pycram.physics.body import Body, Joint
from pycram.physics.silence import quiet
from recorder import geometry
from recorder.extras import needed
from recorder.geometry import IDENTITY, Pose, Vector
from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


with needed(), quiet(1, 2):  # it announces its build time
    import pybullet as bullet

_UPWARD: Final = 0.5  # of a normal's length

# Groups of the collision filter. PyBullet lets a pair collide if either side wants to, so both have to refuse.
_ROBOT_GROUP: Final = 64
_HELD_GROUP: Final = 32
_DYNAMIC_GROUP: Final = 1
_ALL: Final = -1
_STATIC_GROUP: Final = 2

_KINDS: Final = {bullet.JOINT_REVOLUTE: "revolute", bullet.JOINT_PRISMATIC: "prismatic"}

#: Forces (N, Nm) with which joints keep their place. The PR2's torso sinks below 1e4.
_HOLD_FORCE: Final = {"revolute": 500.0, "prismatic": 1e4}


class Touch(NamedTuple):
    """Where two bodies are nearest.

    Attributes:
        link_a: link of the first body.
        link_b: link of the second.
        position_a: on the first, world frame, m.
        position_b: on the second, world frame, m.
        normal: unit vector from b to a.
        distance: m, negative inside.
        force: N along the normal, as the last step left it; 0 where nothing was stepped.
    """

    link_a: str
    link_b: str
    position_a: Vector
    position_b: Vector
    normal: Vector
    distance: float
    force: float

    @property
    def carries(self) -> bool:
        """Whether the second body rests on the first there: steeper than 60 degrees carries nothing to speak of."""
        return self.normal[2] < -_UPWARD


class Contact(NamedTuple):
    """Where a body touched another in the last step.

    Attributes:
        link: index of its link.
        other: id of the other body.
        other_link: index of the other's link.
        position: on the other, world frame, m.
        normal: unit vector from the other to it.
        force: N along the normal.
    """

    link: int
    other: int
    other_link: int
    position: Vector
    normal: Vector
    force: float


def decompose(source: Path, target: Path) -> None:
    """Splits a concave OBJ mesh into convex pieces with V-HACD.

    Args:
        source: the mesh.
        target: gets one group per piece.
    """
    with quiet(1):
        bullet.vhacd(str(source), str(target), str(target.with_suffix(".log")), resolution=200_000)


class Engine:
    """A physics client.

    Args:
        window: open PyBullet's window.
    """

    def __init__(self, *, window: bool = False) -> None:
        self._window = window
        if window:
            with quiet(1):
                self._client: int = bullet.connect(bullet.GUI)
        else:
            self._client = bullet.connect(bullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet gave no physics client; too many worlds may be open")
        # File caching goes by name: models are stored under the hash of their content, so it is right to keep it.
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=1 / STEPS_PER_SECOND, deterministicOverlappingPairs=1, physicsClientId=self._client
        )

    # --- bodies ----------------------------------------------------------------------------------------------------

    def load(self, urdf: Path, pose: Pose, *, fixed: bool, robot: bool = False) -> Body:
        """Loads a checked URDF file.

        Args:
            urdf: the file.
            pose: of its base link.
            fixed: the base doesn't move by itself.
            robot: put its links into the group that ignores what a robot holds.

        Returns:
            The body.
        """
        c = self._client
        number = bullet.loadURDF(str(urdf), *pose, useFixedBase=fixed, physicsClientId=c)
        base = bullet.getBodyInfo(number, physicsClientId=c)[0].decode()
        links = {base: -1}
        joints = {}
        for index in range(bullet.getNumJoints(number, physicsClientId=c)):
            info = bullet.getJointInfo(number, index, physicsClientId=c)
            link = info[12].decode()
            links[link] = index
            if info[2] in _KINDS:
                lower, upper = (info[8], info[9]) if info[9] >= info[8] else (-np.inf, np.inf)
                joints[info[1].decode()] = Joint(info[1].decode(), index, _KINDS[info[2]], lower, upper, link)
        at, turn = bullet.getDynamicsInfo(number, -1, physicsClientId=c)[3:5]
        body = Body(
            number,
            links,
            joints,
            None if (at, turn) == IDENTITY else (at, turn),
            tuple(joint.index for joint in joints.values()),
        )
        if robot or fixed:
            self.separate(body, fixed=fixed, robot=robot)
        self.set_pose(body, pose)
        for joint in joints.values():
            self._hold(body, joint, 0.0)
        return body

    def separate(self, body: Body, *, fixed: bool, robot: bool = False) -> None:
        """Says what a body's links collide with, as when it was loaded; the engine forgets its contacts of before.

        Args:
            body: the body.
            fixed: whether its base doesn't move by itself.
            robot: whether its links ignore what a robot holds.
        """
        for index in body.links.values():
            if robot:
                # the base of a fixed body never collides with static things
                group, mask = _ROBOT_GROUP, ~_HELD_GROUP & (~_STATIC_GROUP if index < 0 else _ALL)
            elif fixed:  # furniture stands on the floor for good: no contact to solve
                group, mask = _STATIC_GROUP, ~_STATIC_GROUP
            else:
                group, mask = _DYNAMIC_GROUP, _ALL
            bullet.setCollisionFilterGroupMask(body.id, index, group, mask, physicsClientId=self._client)

    def remove(self, body: Body) -> None:
        """Removes a body; its constraints have to be gone."""
        bullet.removeBody(body.id, physicsClientId=self._client)

    def pose(self, body: Body) -> Pose:
        """Pose of the base link in the world."""
        pose: Pose = bullet.getBasePositionAndOrientation(body.id, physicsClientId=self._client)
        if body.offset is None:
            return pose
        return geometry.multiply(pose, geometry.invert(body.offset))

    def set_pose(self, body: Body, pose: Pose) -> None:
        """Puts the base link there, at rest."""
        at, turn = pose if body.offset is None else geometry.multiply(pose, body.offset)
        bullet.resetBasePositionAndOrientation(body.id, at, turn, physicsClientId=self._client)

    def velocity(self, body: Body) -> tuple[float, ...]:
        """Linear (m/s) and angular (rad/s) velocity of the base's centre of mass: 6 numbers."""
        linear, angular = bullet.getBaseVelocity(body.id, physicsClientId=self._client)
        return (*linear, *angular)

    def set_velocity(self, body: Body, velocity: Sequence[float]) -> None:
        """Sets linear and angular velocity: 6 numbers."""
        bullet.resetBaseVelocity(body.id, velocity[:3], velocity[3:], physicsClientId=self._client)

    def joints(self, body: Body) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Positions and velocities of the movable joints, in order."""
        if not body.indices:
            return (), ()
        states = bullet.getJointStates(body.id, body.indices, physicsClientId=self._client)
        positions, velocities, *_ = zip(*states, strict=True)
        return positions, velocities

    def joint(self, body: Body, name: str) -> float:
        """Position of one movable joint."""
        index = body.joints[name].index
        position: float = bullet.getJointState(body.id, index, physicsClientId=self._client)[0]
        return position

    def set_joints(self, body: Body, positions: Mapping[str, float], speeds: Mapping[str, float] | None = None) -> None:
        """Puts joints there, at rest unless speeds (rad/s or m/s) are given, and makes them keep that place."""
        for name, position in positions.items():
            joint, speed = body.joints[name], speeds[name] if speeds else 0.0
            bullet.resetJointState(body.id, joint.index, position, speed, physicsClientId=self._client)
            self._hold(body, joint, position)

    def pose_joints(self, body: Body, positions: Mapping[str, float]) -> None:
        """As :meth:`set_joints` for a body that is never stepped: ten times as fast, its motors stay as they are."""
        bullet.resetJointStatesMultiDof(
            body.id,
            [body.joints[name].index for name in positions],
            [[position] for position in positions.values()],
            [[0.0]] * len(positions),
            physicsClientId=self._client,
        )

    def _hold(self, body: Body, joint: Joint, position: float) -> None:
        bullet.setJointMotorControl2(
            body.id,
            joint.index,
            bullet.POSITION_CONTROL,
            targetPosition=position,
            targetVelocity=0.0,
            force=_HOLD_FORCE[joint.kind],
            positionGain=0.1,
            velocityGain=1.0,
            maxVelocity=100.0,  # sticky: always said
            physicsClientId=self._client,
        )

    def link_pose(self, body: Body, link: str) -> Pose:
        """Pose of a link's frame in the world, current without a step."""
        index = body.links[link]
        if index < 0:
            return self.pose(body)
        state = bullet.getLinkState(body.id, index, computeForwardKinematics=1, physicsClientId=self._client)
        return state[4], state[5]

    def link_frames(self, body: Body, links: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Frames of several links of a body at once, in the world.

        Args:
            body: the body.
            links: names of its links.

        Returns:
            (n, 3) positions in m, (n, 4) orientations xyzw.
        """
        indices = [body.links[link] for link in links]
        distinct = sorted(set(indices))
        moving = [index for index in distinct if index >= 0]
        states = (
            bullet.getLinkStates(body.id, moving, computeForwardKinematics=1, physicsClientId=self._client)
            if moving
            else ()
        )
        poses = [(*state[4], *state[5]) for state in states]
        if len(moving) < len(distinct):
            at, turn = self.pose(body)
            poses.insert(0, (*at, *turn))
        numbers = {index: number for number, index in enumerate(distinct)}
        found = np.array(poses).reshape(-1, 7).take([numbers[index] for index in indices], axis=0)
        return found[:, :3], found[:, 3:]

    def box(self, body: Body, link: str) -> tuple[Vector, Vector]:
        """Axis-aligned bounds of a link's shape in the world, current without a step."""
        bounds: tuple[Vector, Vector] = bullet.getAABB(body.id, body.links[link], physicsClientId=self._client)
        return bounds

    def set_color(self, body: Body, color: Sequence[float]) -> None:
        """Paints all links, RGBA 0..1."""
        for index in body.links.values():
            bullet.changeVisualShape(body.id, index, rgbaColor=color, physicsClientId=self._client)

    def mass(self, body: Body, link: str) -> float:
        """Mass of a link in kg."""
        mass: float = bullet.getDynamicsInfo(body.id, body.links[link], physicsClientId=self._client)[0]
        return mass

    def center_of_mass(self, body: Body) -> tuple[Vector, float]:
        """Centre of mass of all its links in the world, m, and their mass in kg."""
        c = self._client
        masses = [bullet.getDynamicsInfo(body.id, index, physicsClientId=c)[0] for index in body.links.values()]
        places = [
            bullet.getBasePositionAndOrientation(body.id, physicsClientId=c)[0]
            if index < 0
            else bullet.getLinkState(body.id, index, computeForwardKinematics=1, physicsClientId=c)[0]
            for index in body.links.values()
        ]
        x, y, z = np.average(places, axis=0, weights=masses).tolist()
        return (x, y, z), sum(masses)

    # --- attachments -----------------------------------------------------------------------------------------------

    def fix(self, carrier: Body, link: str, body: Body, body_link: str, pose: Pose) -> int:
        """Joins a body to a carrier's link, so that simulation keeps the pose too.

        Args:
            carrier: the one that carries.
            link: its link.
            body: the carried one.
            body_link: the link of it that is held.
            pose: of that link in the carrier's link.

        Returns:
            The constraint's id.
        """
        c = self._client
        parent = self._to_inertial(carrier, link, pose)
        child = self._to_inertial(body, body_link, IDENTITY)
        number: int = bullet.createConstraint(
            carrier.id,
            carrier.links[link],
            body.id,
            body.links[body_link],
            bullet.JOINT_FIXED,
            [0, 0, 0],
            parent[0],
            child[0],
            parent[1],
            child[1],
            physicsClientId=c,
        )
        bullet.changeConstraint(number, maxForce=1e4, physicsClientId=c)
        return number

    def _to_inertial(self, body: Body, link: str, pose: Pose) -> Pose:
        """The same pose in the link's inertial frame, which constraints count from."""
        at, turn = bullet.getDynamicsInfo(body.id, body.links[link], physicsClientId=self._client)[3:5]
        return pose if (at, turn) == IDENTITY else geometry.multiply(geometry.invert((at, turn)), pose)

    def unfix(self, constraint: int) -> None:
        """Removes a constraint."""
        bullet.removeConstraint(constraint, physicsClientId=self._client)

    def pass_through(self, carrier: Body, link: str, body: Body, *, robot: bool, enable: bool) -> None:
        """Lets a held body pass through its carrier in simulation (on), or collide with it again (off).

        Contact and distance queries see both regardless.
        """
        c = self._client
        if robot:
            group, mask = (_HELD_GROUP, ~_ROBOT_GROUP) if enable else (_DYNAMIC_GROUP, _ALL)
            for index in body.links.values():
                bullet.setCollisionFilterGroupMask(body.id, index, group, mask, physicsClientId=c)
            return
        for index in body.links.values():
            bullet.setCollisionFilterPair(
                carrier.id, body.id, carrier.links[link], index, int(not enable), physicsClientId=c
            )

    def ghost(self, body: Body) -> None:
        """Lets a body pass through everything for good; contact and distance queries see it regardless."""
        for index in body.links.values():
            bullet.setCollisionFilterGroupMask(body.id, index, 0, 0, physicsClientId=self._client)

    # --- physics ---------------------------------------------------------------------------------------------------

    def set_gravity(self, gravity: Sequence[float]) -> None:
        """Sets gravity in m/s^2."""
        bullet.setGravity(*gravity, physicsClientId=self._client)

    def step(self, steps: int) -> None:
        """Simulates so many steps of 1/240 s."""
        client = self._client
        for _ in range(steps):
            bullet.stepSimulation(physicsClientId=client)

    def touches(self, a: Body, b: Body, distance: float = 0.0) -> list[Touch]:
        """The nearest points of the links of two bodies that are nearer than a distance in m."""
        points = bullet.getClosestPoints(a.id, b.id, distance, physicsClientId=self._client)
        return self._told(a, b, points)

    def link_touches(
        self, a: Body, link: str, b: Body, distance: float = 0.0, *, link_b: str | None = None
    ) -> list[Touch]:
        """As :meth:`touches`, of one link of the first body, and of one of the second if it is named."""
        client = self._client
        if link_b is None:
            points = bullet.getClosestPoints(a.id, b.id, distance, a.links[link], physicsClientId=client)
            return self._told(a, b, points)
        points = bullet.getClosestPoints(a.id, b.id, distance, a.links[link], b.links[link_b], physicsClientId=client)
        return [Touch(link, link_b, *p[5:10]) for p in points or ()]

    def contacts(self, body: Body) -> list[Contact]:
        """Contacts of the last step with other bodies."""
        points = bullet.getContactPoints(body.id, physicsClientId=self._client) or ()
        return [Contact(p[3], p[2], p[4], p[6], p[7], p[9]) for p in points]

    def friction(self, body: int, link: int) -> float:
        """Coefficient of a link's sliding friction; that of a contact is the product of both sides'.

        Args:
            body: id.
            link: index.
        """
        coefficient: float = bullet.getDynamicsInfo(body, link, physicsClientId=self._client)[1]
        return coefficient

    @staticmethod
    def _told(a: Body, b: Body, points: Sequence[tuple[Any, ...]] | None) -> list[Touch]:
        if not points:
            return []
        names_a = {index: name for name, index in a.links.items()}
        names_b = {index: name for name, index in b.links.items()}
        return [Touch(names_a[p[3]], names_b[p[4]], *p[5:10]) for p in points]

    def close(self) -> None:
        """Ends the client; a second call does nothing."""
        if self._client >= 0:
            client, self._client = self._client, -1
            if bullet.isConnected(client):
                with quiet(1) if self._window else nullcontext():
                    bullet.disconnect(client)

    @property
    def connected(self) -> bool:
        """Whether the client lives; a window may have been closed by hand."""
        return self._client >= 0 and bool(bullet.isConnected(self._client))

    def pump(self) -> None:
        """Lets a window handle its events."""
        bullet.configureDebugVisualizer(lightPosition=[4, -4, 6], physicsClientId=self._client)
