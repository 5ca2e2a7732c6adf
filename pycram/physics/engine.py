"""A physics client: the only module that calls PyBullet.

Its functions take names of bodies, links and joints, and poses of link frames as in the URDF. PyBullet doesn't check
arguments, so callers check them. Overlapping pairs are ordered, so simulations repeat bit for bit.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.failures import AssetError
from pycram.foundation.redirect import silenced
from pycram.physics.body import ClosestPoint, Contact, LoadedBody, MovableJoint, Snapshot
from pycram.physics.loading import MOTOR_GAIN, NOW, Load, Loading, holding_forces, least_forces
from recorder import geometry
from recorder.geometry import IDENTITY, Pose, Vector
from recorder.packages import needed
from recorder.records import STEPS_PER_SECOND
from recorder.tracing import journal

with needed(), silenced(1, 2):  # the import of PyBullet prints its build time
    import pybullet as bullet

if len(list(Path(bullet.__file__).parent.glob("pybullet*-*.dist-info"))) > 1:
    warnings.warn(
        "pybullet and pybullet-arm64 are both installed and overwrite each other's files; uninstall both, then install "
        "pybullet-arm64",
        stacklevel=2,
    )

__all__ = ["Engine", "bullet", "decompose"]

# Bits of the collision filter. Two bodies collide if the mask of either body has the group of the other body. Both
# masks must therefore exclude a pair that doesn't collide.
_DYNAMIC_GROUP: Final = 1
_STATIC_GROUP: Final = 2
_HELD_GROUP: Final = 32
_ROBOT_GROUP: Final = 64
_ALL: Final = -1

_BUTTON: Final = 2  # kind of a mouse event: a button was pressed or released

_KINDS: Final = {bullet.JOINT_REVOLUTE: "revolute", bullet.JOINT_PRISMATIC: "prismatic"}

_NEXT_TO_NOTHING: Final = 1e-9  # distance in m that replaces an exact 0
_FAR: Final = 1e4  # length in m of the vectors with which PyBullet describes the picture


def decompose(source: Path, target: Path) -> None:
    """Split a concave OBJ mesh into convex pieces with V-HACD; the target has a group for each piece."""
    journal.flush()  # V-HACD takes seconds
    with silenced(1):
        bullet.vhacd(str(source), str(target), str(target.with_suffix(".log")), resolution=200_000)


class Engine:
    """A physics client, with or without PyBullet's window."""

    def __init__(self, *, window: bool = False) -> None:
        self.has_window = window  # whether a user sees the simulation, and can drag objects
        self._grip: tuple[int, int] | None = None  # the body and the link that the mouse drags
        self._known: dict[int, list[Snapshot]] = {}  # states of bodies by id, one or none; threads share the lists
        with silenced(1) if window else nullcontext():
            self._client: int = bullet.connect(bullet.GUI if window else bullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet has no free physics client; too many worlds may be open")
        # PyBullet caches files by name; the names of models contain the hash of their content.
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=1 / STEPS_PER_SECOND, deterministicOverlappingPairs=1, physicsClientId=self._client
        )

    # --- bodies ------------------------------------------------------------------------------------------------------

    def load(
        self,
        urdf: Path,
        pose: Pose,
        *,
        fixed: bool,
        robot: bool = False,
        loading: Loading = NOW,
        start: Mapping[str, float] | None = None,
    ) -> LoadedBody:
        """Load a checked URDF file.

        Args:
            pose: Pose of the base link in the world.
            robot: Whether the links pass through objects that a robot holds.
            start: Positions of joints in rad or m by name; other joints start at 0.

        Raises:
            AssetError: PyBullet rejects the file.
        """
        c = self._client
        flags = bullet.URDF_USE_INERTIA_FROM_FILE if robot and loading.inertia else 0
        if not self.has_window:  # cameras render the model's own meshes instead
            flags |= bullet.URDF_IGNORE_VISUAL_SHAPES
        journal.flush()  # loading takes up to 90 ms, and a process that is killed then writes nothing
        try:
            number = bullet.loadURDF(str(urdf), *pose, useFixedBase=fixed, flags=flags, physicsClientId=c)
        except bullet.error as error:  # the model of a damaged recording may pass all checks
            raise AssetError(str(urdf), f"PyBullet rejects the model: {error}") from error
        base = bullet.getBodyInfo(number, physicsClientId=c)[0].decode()
        links = {base: -1}
        joints = {}
        parents = []
        for index in range(bullet.getNumJoints(number, physicsClientId=c)):
            info = bullet.getJointInfo(number, index, physicsClientId=c)
            parents.append(info[16])
            link = info[12].decode()
            links[link] = index
            if info[2] in _KINDS:
                lower, upper = (info[8], info[9]) if info[9] >= info[8] else (-np.inf, np.inf)
                joints[info[1].decode()] = MovableJoint(info[1].decode(), index, _KINDS[info[2]], lower, upper, link)
        offset = bullet.getDynamicsInfo(number, -1, physicsClientId=c)[3:5]
        indices = tuple(joint.index for joint in joints.values())
        gain, forces = (
            (loading.gain, holding_forces(joints.values(), self._loads(number, parents), loading.strength))
            if robot
            else (MOTOR_GAIN, least_forces(joints.values()))
        )
        body = LoadedBody(number, links, joints, None if offset == IDENTITY else offset, indices, gain, forces)
        if robot or fixed:
            self.reset_collision_filter(body, fixed=fixed, robot=robot)
        self.set_pose(body, pose)
        for joint in joints.values():
            if loading.undamped:
                bullet.changeDynamics(number, joint.index, jointDamping=0.0, physicsClientId=c)
            if robot and loading.armature:
                moments = bullet.getDynamicsInfo(number, joint.index, physicsClientId=c)[2]
                least = [max(moment, loading.armature) for moment in moments]
                bullet.changeDynamics(number, joint.index, localInertiaDiagonal=least, physicsClientId=c)
            self._hold(body, joint, 0.0)
        if start:
            self.set_joints(body, start)
        return body

    def _loads(self, number: int, parents: Sequence[int]) -> list[Load]:
        loads = []
        for index, parent in enumerate(parents):
            place = bullet.getLinkState(number, index, physicsClientId=self._client)[4]
            mass, _, _, center, *_ = bullet.getDynamicsInfo(number, index, physicsClientId=self._client)
            loads.append(Load(parent, place, mass, math.hypot(*center)))
        return loads

    def reset_collision_filter(self, body: LoadedBody, *, fixed: bool, robot: bool = False) -> None:
        """Set the collision filter of a loaded body's links (see :meth:`load`); the engine drops cached contacts."""
        if robot:  # the base of a fixed body must not collide with static bodies
            self._filter(body, _ROBOT_GROUP, ~_HELD_GROUP & ~_STATIC_GROUP, links=(-1,))
            self._filter(body, _ROBOT_GROUP, ~_HELD_GROUP, links=[index for index in body.links.values() if index >= 0])
        elif fixed:  # furniture doesn't collide with the floor, so the solver has fewer contacts
            self._filter(body, _STATIC_GROUP, ~_STATIC_GROUP)
        else:
            self._filter(body, _DYNAMIC_GROUP, _ALL)

    def ghost(self, body: LoadedBody) -> None:
        """Let a body pass through all bodies permanently; contact and distance queries still include the body."""
        self._filter(body, 0, 0)

    def _filter(self, body: LoadedBody, group: int, mask: int, links: Iterable[int] | None = None) -> None:
        for index in body.links.values() if links is None else links:
            bullet.setCollisionFilterGroupMask(body.id, index, group, mask, physicsClientId=self._client)

    def remove(self, body: LoadedBody) -> None:
        """Remove a body, which must have no constraints."""
        bullet.removeBody(body.id, physicsClientId=self._client)
        self._forget(body)

    def snapshot(self, body: LoadedBody) -> Snapshot:
        """Return the state of a body: the same Python object as before if the state hasn't changed."""
        known = self._known.setdefault(body.id, [])
        if not known:
            known.append(Snapshot(self.pose(body), self.velocity(body), *self.joints(body)))
        return known[0]

    def _forget(self, body: LoadedBody) -> None:
        self._known[body.id] = []

    def pose(self, body: LoadedBody) -> Pose:
        """Return the pose of the base link in the world."""
        known = self._known.get(body.id)
        if known:
            return known[0].pose
        pose = self.center_pose(body)
        return pose if body.offset is None else geometry.multiply(pose, geometry.invert(body.offset))

    def set_pose(self, body: LoadedBody, pose: Pose) -> None:
        """Set the pose of the base link; its velocity becomes 0."""
        self.set_center_pose(body, pose if body.offset is None else geometry.multiply(pose, body.offset))

    def center_pose(self, body: LoadedBody) -> Pose:
        """Return the pose of the base's centre of mass in the world, without the rounding errors of :meth:`pose`."""
        pose: Pose = bullet.getBasePositionAndOrientation(body.id, physicsClientId=self._client)
        return pose

    def set_center_pose(self, body: LoadedBody, pose: Pose) -> None:
        """Set the pose of the base's centre of mass; its velocity becomes 0."""
        bullet.resetBasePositionAndOrientation(body.id, *pose, physicsClientId=self._client)
        self._forget(body)

    def velocity(self, body: LoadedBody) -> tuple[float, ...]:
        """Return the linear (m/s) and angular (rad/s) velocity of the base's centre of mass as 6 values."""
        linear, angular = bullet.getBaseVelocity(body.id, physicsClientId=self._client)
        return (*linear, *angular)

    def set_velocity(self, body: LoadedBody, velocity: Sequence[float]) -> None:
        """Set the linear (m/s) and angular (rad/s) velocity of the base's centre of mass as 6 values."""
        bullet.resetBaseVelocity(body.id, velocity[:3], velocity[3:], physicsClientId=self._client)
        self._forget(body)

    def joints(self, body: LoadedBody) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the positions (rad or m) and velocities (rad/s or m/s) of the movable joints in order."""
        if not body.indices:
            return (), ()
        states = bullet.getJointStates(body.id, body.indices, physicsClientId=self._client)
        positions, velocities, *_ = zip(*states, strict=True)
        return positions, velocities

    def joint(self, body: LoadedBody, name: str) -> float:
        """Return the position of a movable joint in rad or m."""
        position: float = bullet.getJointState(body.id, body.joints[name].index, physicsClientId=self._client)[0]
        return position

    def set_joints(
        self, body: LoadedBody, positions: Mapping[str, float], speeds: Mapping[str, float] | None = None
    ) -> None:
        """Set joints to positions (rad or m), with speeds (rad/s or m/s) or at rest. Motors hold them."""
        for name, position in positions.items():
            joint, speed = body.joints[name], speeds[name] if speeds else 0.0
            bullet.resetJointState(body.id, joint.index, position, speed, physicsClientId=self._client)
            self._hold(body, joint, position)
        self._forget(body)

    def pose_joints(
        self, body: LoadedBody, positions: Mapping[str, float], speeds: Iterable[float] | None = None
    ) -> None:
        """Set joints to positions (rad or m), with speeds (rad/s or m/s) or at rest.

        This is ten times as fast as :meth:`set_joints`, because motors aren't set.
        """
        bullet.resetJointStatesMultiDof(
            body.id,
            [body.joints[name].index for name in positions],
            [[position] for position in positions.values()],
            [[0.0]] * len(positions) if speeds is None else [[speed] for speed in speeds],
            physicsClientId=self._client,
        )
        self._forget(body)

    def set_targets(self, body: LoadedBody, targets: Mapping[str, float]) -> None:
        """Set the positions (rad or m) that motors hold, by joint name, without moving the joints."""
        for name, position in targets.items():
            self._hold(body, body.joints[name], position)

    def drive(
        self, body: LoadedBody, joints: Sequence[MovableJoint], start: Sequence[float], end: Sequence[float]
    ) -> None:
        """Command motors to move joints in one step from planned positions to the next positions (rad or m).

        The motor gets the difference as a velocity, and its gain corrects a remaining error.
        """
        bullet.setJointMotorControlArray(  # this call keeps the velocity limit that ``_hold`` has set
            body.id,
            [joint.index for joint in joints],
            bullet.POSITION_CONTROL,
            targetPositions=start,
            targetVelocities=[(b - a) * STEPS_PER_SECOND for a, b in zip(start, end, strict=True)],
            forces=[body.forces[joint.name] for joint in joints],
            positionGains=[body.gain] * len(joints),
            velocityGains=[1.0] * len(joints),
            physicsClientId=self._client,
        )

    def positions(self, body: LoadedBody, joints: Sequence[MovableJoint]) -> list[float]:
        """Return the positions of these joints in rad or m."""
        indices = [joint.index for joint in joints]
        return [state[0] for state in bullet.getJointStates(body.id, indices, physicsClientId=self._client)]

    def _hold(self, body: LoadedBody, joint: MovableJoint, position: float) -> None:
        body.targets[joint.name] = position
        bullet.setJointMotorControl2(
            body.id,
            joint.index,
            bullet.POSITION_CONTROL,
            targetPosition=position,
            targetVelocity=0.0,
            force=body.forces[joint.name],
            positionGain=body.gain,
            velocityGain=1.0,
            maxVelocity=100.0,  # if this call sets no limit, the engine uses an earlier limit
            physicsClientId=self._client,
        )

    def link_pose(self, body: LoadedBody, link: str) -> Pose:
        """Return the pose of a link's frame in the world. The pose is up to date without a simulation step."""
        index = body.links[link]
        if index < 0:
            return self.pose(body)
        state = bullet.getLinkState(body.id, index, computeForwardKinematics=1, physicsClientId=self._client)
        return state[4], state[5]

    def link_frames(self, body: LoadedBody, links: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the frames of links in the world: (n, 3) positions in m, (n, 4) orientations xyzw."""
        indices = [body.links[link] for link in links]
        moving = sorted({index for index in indices if index >= 0})
        states = (
            bullet.getLinkStates(body.id, moving, computeForwardKinematics=1, physicsClientId=self._client)
            if moving
            else ()
        )
        at, turn = self.pose(body)
        poses = np.array([(*at, *turn), *((*state[4], *state[5]) for state in states)])
        rows = {index: row for row, index in enumerate((-1, *moving))}
        found = poses[[rows[index] for index in indices]]
        return found[:, :3], found[:, 3:]

    def boxes(self, links: Iterable[tuple[LoadedBody, str]]) -> list[tuple[Vector, Vector]]:
        """Return the axis-aligned bounds of links' shapes in the world. The bounds need no simulation step."""
        return [bullet.getAABB(body.id, body.links[link], physicsClientId=self._client) for body, link in links]

    def set_color(self, body: LoadedBody, color: Sequence[float]) -> None:
        """Set the colour of all links to RGBA values from 0 to 1."""
        for index in body.links.values():
            bullet.changeVisualShape(body.id, index, rgbaColor=color, physicsClientId=self._client)

    def center_of_mass(self, body: LoadedBody) -> tuple[Vector, float]:
        """Return the centre of mass of all links in the world in m, and their mass in kg."""
        c = self._client
        masses = [bullet.getDynamicsInfo(body.id, index, physicsClientId=c)[0] for index in body.links.values()]
        centers = [
            bullet.getBasePositionAndOrientation(body.id, physicsClientId=c)[0]
            if index < 0
            else bullet.getLinkState(body.id, index, computeForwardKinematics=1, physicsClientId=c)[0]
            for index in body.links.values()
        ]
        x, y, z = np.average(centers, axis=0, weights=masses).tolist()
        return (x, y, z), sum(masses)

    # --- attachments -------------------------------------------------------------------------------------------------

    def fix(self, carrier: LoadedBody, link: str, body: LoadedBody, body_link: str, pose: Pose) -> int:
        """Join two bodies by a fixed constraint that holds a pose of the body's link in the carrier's link."""
        c = self._client
        parent = self._to_inertial(carrier, link, pose)
        child = self._to_inertial(body, body_link, IDENTITY)
        ends = carrier.id, carrier.links[link], body.id, body.links[body_link]
        frames = parent[0], child[0], parent[1], child[1]
        number: int = bullet.createConstraint(*ends, bullet.JOINT_FIXED, [0, 0, 0], *frames, physicsClientId=c)
        bullet.changeConstraint(number, maxForce=1e4, physicsClientId=c)
        return number

    def _to_inertial(self, body: LoadedBody, link: str, pose: Pose) -> Pose:
        """Return a pose in a link's frame relative to the link's inertial frame, for constraints."""
        at, turn = bullet.getDynamicsInfo(body.id, body.links[link], physicsClientId=self._client)[3:5]
        return pose if (at, turn) == IDENTITY else geometry.multiply(geometry.invert((at, turn)), pose)

    def unfix(self, constraint: int) -> None:
        """Remove a constraint."""
        bullet.removeConstraint(constraint, physicsClientId=self._client)

    def pass_through(self, carrier: LoadedBody, link: str, body: LoadedBody, *, robot: bool, enable: bool) -> None:
        """Let a held body pass through its carrier in simulation, or collide with its carrier again."""
        if robot:
            group, mask = (_HELD_GROUP, ~_ROBOT_GROUP) if enable else (_DYNAMIC_GROUP, _ALL)
            self._filter(body, group, mask)
            return
        for index in body.links.values():
            pair = carrier.id, body.id, carrier.links[link], index
            bullet.setCollisionFilterPair(*pair, int(not enable), physicsClientId=self._client)

    # --- physics -----------------------------------------------------------------------------------------------------

    def set_gravity(self, gravity: Sequence[float]) -> None:
        """Set gravity in m/s^2."""
        bullet.setGravity(*gravity, physicsClientId=self._client)

    def step(self, steps: int) -> None:
        """Simulate steps of 1/240 s each."""
        client = self._client
        for _ in range(steps):
            bullet.stepSimulation(physicsClientId=client)
        self._known = {}

    def sleep(self, body: LoadedBody, *, asleep: bool) -> None:
        """Put a body to sleep until an awake body comes near, or wake the body and keep it awake."""
        state = (
            bullet.ACTIVATION_STATE_ENABLE_SLEEPING | bullet.ACTIVATION_STATE_SLEEP
            if asleep
            else bullet.ACTIVATION_STATE_DISABLE_SLEEPING | bullet.ACTIVATION_STATE_WAKE_UP
        )
        bullet.changeDynamics(body.id, -1, activationState=state, physicsClientId=self._client)

    def dragged(self, bodies: Iterable[LoadedBody]) -> list[tuple[LoadedBody, str]]:
        """Return the bodies and links that the mouse has dragged since the last call.

        PyBullet doesn't report drags. The mouse grips the body under the pointer when the left button is pressed, and
        releases it with the button. If Alt or Control is pressed, the mouse turns the camera.
        """
        if not self.has_window:
            return []
        grips = [self._grip]
        for kind, x, y, button, state in bullet.getMouseEvents(physicsClientId=self._client):
            if kind == _BUTTON and button == 0:
                self._grip = self._under_pointer(x, y) if state & bullet.KEY_IS_DOWN else None
                grips.append(self._grip)
        known = {body.id: body for body in bodies}
        found = [(known[grip[0]], grip[1]) for grip in dict.fromkeys(grips) if grip is not None and grip[0] in known]
        return [(body, next(name for name, index in body.links.items() if index == link)) for body, link in found]

    def _under_pointer(self, x: float, y: float) -> tuple[int, int] | None:
        keys = bullet.getKeyboardEvents(physicsClientId=self._client)
        if any(keys.get(key, 0) & bullet.KEY_IS_DOWN for key in (bullet.B3G_ALT, bullet.B3G_CONTROL)):
            return None
        camera = bullet.getDebugVisualizerCamera(physicsClientId=self._client)
        width, height, *_ = camera  # x and y begin at the upper left corner
        forward, horizontal, vertical, target = (np.array(camera[index], float) for index in (5, 6, 7, 11))
        eye = target - camera[10] * forward
        start, end = eye, eye + _FAR * forward + (x / width - 0.5) * horizontal + (0.5 - y / height) * vertical
        body, link, *_ = bullet.rayTest(start, end, physicsClientId=self._client)[0]
        return (body, link) if body >= 0 else None

    def closest_points(self, a: LoadedBody, b: LoadedBody, distance: float = 0.0) -> list[ClosestPoint]:
        """Return the closest points of each two links of two bodies, if the links are at most ``distance`` m apart."""
        return _named(a, b, bullet.getClosestPoints(a.id, b.id, distance, physicsClientId=self._client))

    def deepest(self, a: LoadedBody, b: LoadedBody) -> ClosestPoint | None:
        """Return the closest points where two bodies overlap most; None if they don't touch."""
        return min(self.closest_points(a, b), key=lambda point: point.distance, default=None)

    def link_closest_points(
        self, a: LoadedBody, link: str, b: LoadedBody, distance: float = 0.0, *, link_b: str | None = None
    ) -> list[ClosestPoint]:
        """Return the closest points of a link of the first body and all links, or one link, of the second body."""
        client = self._client
        if link_b is None:
            return _named(a, b, bullet.getClosestPoints(a.id, b.id, distance, a.links[link], physicsClientId=client))
        if a is b:  # for a distance of exactly 0, PyBullet finds no contacts between boxes of one body
            distance = max(distance, _NEXT_TO_NOTHING)
        pair = a.links[link], b.links[link_b]
        points = bullet.getClosestPoints(a.id, b.id, distance, *pair, physicsClientId=client)
        return [ClosestPoint(link, link_b, *p[6:10]) for p in points or ()]

    def contacts(self, body: LoadedBody) -> list[Contact]:
        """Return the contacts with other bodies in the last simulation step."""
        points = bullet.getContactPoints(body.id, physicsClientId=self._client) or ()
        return [Contact(p[3], p[2], p[4], p[6], p[7], p[9]) for p in points]

    def friction(self, body: int, link: int) -> float:
        """Return a link's coefficient of sliding friction, by id and index; a contact has the product of both."""
        coefficient: float = bullet.getDynamicsInfo(body, link, physicsClientId=self._client)[1]
        return coefficient

    def close(self) -> None:
        """Disconnect the client; a second call does nothing."""
        if self._client >= 0:
            client, self._client = self._client, -1
            if bullet.isConnected(physicsClientId=client):
                with silenced(1) if self.has_window else nullcontext():
                    bullet.disconnect(physicsClientId=client)

    @property
    def connected(self) -> bool:
        """Whether the client is connected; a user may have closed the window."""
        return self._client >= 0 and bool(bullet.isConnected(physicsClientId=self._client))

    def pump(self) -> None:
        """Let the window handle its events."""
        bullet.configureDebugVisualizer(lightPosition=[4, -4, 6], physicsClientId=self._client)


def _named(a: LoadedBody, b: LoadedBody, points: Sequence[tuple[Any, ...]] | None) -> list[ClosestPoint]:
    if not points:
        return []
    names_a = {index: name for name, index in a.links.items()}
    names_b = {index: name for name, index in b.links.items()}
    return [ClosestPoint(names_a[p[3]], names_b[p[4]], *p[6:10]) for p in points]
