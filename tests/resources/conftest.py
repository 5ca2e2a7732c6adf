"""A bench for resources: the physics engine by itself, with things loaded as their tables say."""

from __future__ import annotations

import tomllib
from importlib.metadata import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pybullet
import pytest
import trimesh

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

RESOURCES = Path(__file__).resolve().parents[2] / "resources"


class Bench:
    """A physics client of its own. Poses are those of link frames, not of centres of mass."""

    def __init__(self, scratch: Path) -> None:
        self.scratch = scratch
        self.client = pybullet.connect(pybullet.DIRECT)
        self.table: dict[str, Any] = tomllib.loads((RESOURCES / "objects.toml").read_text(encoding="utf-8"))
        pybullet.setGravity(0, 0, -9.81, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, physicsClientId=self.client)

    def close(self) -> None:
        pybullet.disconnect(self.client)

    def fixed(self, path: Path) -> int:
        """Load a robot or a piece of the environment."""
        return int(pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=self.client))

    def names(self, body: int) -> tuple[dict[str, int], dict[str, int]]:
        """Joint and link indices by name."""
        infos = [pybullet.getJointInfo(body, i, physicsClientId=self.client) for i in range(self.joint_count(body))]
        root = pybullet.getBodyInfo(body, physicsClientId=self.client)[0].decode()
        return {info[1].decode(): info[0] for info in infos}, {root: -1, **{i[12].decode(): i[0] for i in infos}}

    def joint_count(self, body: int) -> int:
        return int(pybullet.getNumJoints(body, physicsClientId=self.client))

    def info(self, body: int, joint: int) -> Any:
        return pybullet.getJointInfo(body, joint, physicsClientId=self.client)

    def set_joint(self, body: int, joint: int, value: float) -> None:
        pybullet.resetJointState(body, joint, value, physicsClientId=self.client)

    def thing(self, name: str, position: Sequence[float], turn: Sequence[float] = (0.0, 0.0, 0.0)) -> int:
        """Load a household object at a position in metres, turned by roll, pitch, yaw."""
        row = self.table[name]
        mesh = trimesh.load_mesh(RESOURCES / f"{name}.stl")
        inertia = mesh.moment_inertia * row["mass"] / mesh.volume
        x, y, z = mesh.center_mass
        visuals = "".join(
            f'<visual><geometry><mesh filename="{RESOURCES / part["mesh"]}"/></geometry>'
            f'<material name="m{k}"><color rgba="{" ".join(map(str, part["rgba"]))}"/></material></visual>'
            for k, part in enumerate(row["visual"])
        )
        path = self.scratch / f"{name}.urdf"
        path.write_text(
            f'<robot name="{name}"><link name="{name}">'
            f'<contact><lateral_friction value="{row["friction"]}"/></contact>'
            f'<inertial><origin xyz="{x} {y} {z}"/><mass value="{row["mass"]}"/>'
            f'<inertia ixx="{inertia[0, 0]}" iyy="{inertia[1, 1]}" izz="{inertia[2, 2]}" '
            f'ixy="{inertia[0, 1]}" ixz="{inertia[0, 2]}" iyz="{inertia[1, 2]}"/></inertial>{visuals}'
            f'<collision><geometry><mesh filename="{RESOURCES / name}.collision.obj"/></geometry></collision>'
            "</link></robot>",
            encoding="utf-8",
        )
        turned = pybullet.getQuaternionFromEuler(turn)
        return int(pybullet.loadURDF(str(path), list(position), turned, physicsClientId=self.client))

    def pose(self, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Position in metres and rotation matrix of a body's base frame."""
        position, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=self.client)
        local = pybullet.getDynamicsInfo(body, -1, physicsClientId=self.client)[3:5]
        position, turn = pybullet.multiplyTransforms(position, turn, *pybullet.invertTransform(*local))
        return np.array(position), np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)

    def link_position(self, body: int, link: int) -> np.ndarray:
        if link < 0:
            return self.pose(body)[0]
        state = pybullet.getLinkState(body, link, computeForwardKinematics=True, physicsClientId=self.client)
        return np.array(state[4])

    def place(self, body: int, position: Sequence[float], yaw: float) -> None:
        """Put the base of a robot somewhere, turned about z by radians."""
        turn = pybullet.getQuaternionFromEuler([0, 0, yaw])
        pybullet.resetBasePositionAndOrientation(body, list(position), turn, physicsClientId=self.client)

    def simulate(self, seconds: float) -> None:
        for _ in range(round(seconds * 240)):
            pybullet.stepSimulation(physicsClientId=self.client)

    def gap(self, a: int, b: int, link_a: int | None = None, link_b: int | None = None, reach: float = 0.05) -> float:
        """Distance of two bodies or links in metres, negative if they overlap, ``reach`` if they are farther."""
        kwargs = {} if link_a is None else {"linkIndexA": link_a, "linkIndexB": link_b}
        points = pybullet.getClosestPoints(a, b, reach, physicsClientId=self.client, **kwargs)
        return float(min((point[8] for point in points), default=reach))

    def touched_below(self, x: float, y: float, start: float) -> float:
        """Height in metres at which a ray downwards from ``start`` hits something."""
        hit = pybullet.rayTest([x, y, start], [x, y, start - 3.0], physicsClientId=self.client)[0]
        assert hit[0] >= 0
        return float(hit[3][2])

    def extent(self, body: int, link: int) -> np.ndarray:
        """Bounding box of a link in the world, shape (2, 3)."""
        return np.array(pybullet.getAABB(body, link, physicsClientId=self.client))

    def picture(self, eye: Sequence[float], target: Sequence[float]) -> np.ndarray:
        """Colours of an image of 128 x 128 pixels, shape (128 * 128, 3), 0 to 255."""
        view = pybullet.computeViewMatrix(list(eye), list(target), [0, 0, 1])
        lens = pybullet.computeProjectionMatrixFOV(40, 1.0, 0.01, 10)
        image = pybullet.getCameraImage(
            128, 128, view, lens, shadow=0, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self.client
        )
        return np.reshape(image[2], (-1, 4))[:, :3].astype(int)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture(scope="session")
def resources() -> Path:
    return RESOURCES


@pytest.fixture(scope="session")
def pr2() -> Path:
    for file in files("example-robot-data") or []:
        if str(file).endswith("pr2_description/urdf/pr2.urdf"):
            return Path(str(file.locate())).resolve()
    raise FileNotFoundError("pr2.urdf of example-robot-data")
