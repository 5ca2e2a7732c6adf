"""The process module that opens and closes drawers and doors by their handles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

from pycram.foundation.failures import (
    AccessFailed,
    BadArgument,
    CollisionPair,
    HandleBlocked,
    HandleUnreachable,
    MissingPart,
    NoPath,
    PostureInCollision,
    phrases,
)
from pycram.models.robots.description import Arm
from pycram.motions.designator import Designator
from pycram.motions.process_module import FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import Choice, choosing
from pycram.reasoning.collision.checker import DEPTH
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping.handles import (
    DeadEnd,
    Handle,
    HandlePath,
    arms_in_the_way,
    plan_path,
    plan_path_with_torso,
    remedies,
)
from pycram.reasoning.rejections import Touching
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.world import BulletWorld

_STEP: Final = 0.1  # maximum motion in m or rad of the joint between two postures
_STILL: Final = 0.01  # maximum motion in m or rad of the joint while the hand approaches


class Accessing(SimulatedModule):
    """Opens or closes a drawer or door by its handle, up to a distance; a distance of 0 means closed.

    The whole motion is planned before anything moves, so a failure of planning changes nothing.
    """

    failures = (AccessFailed, HandleUnreachable, HandleBlocked, MissingPart)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        arm = self.description(robot).arm(solution["arm"])
        container, joint, link = solution["part-of"], solution["drawer-joint"], solution["drawer-handle"]
        with self.execution.whole(robot.world):
            with robot.world.lock:
                start = container.get_joint_position(joint)
                container.check_link(link)
                if link not in attachment.moved_links(container.urdf, [joint]):
                    raise BadArgument("drawer-handle", link, f"a link that {joint} moves")
                held = self.held(robot, arm)
                if held is not None:
                    raise AccessFailed(joint, f"the {arm.name} gripper holds {held.name}", handle=link, arm=arm.name)
                handle = Handle(container, joint, link)
                upper = container.joint_limits(joint)[1]
                end = handle.closed + solution["distance"]
                if end > upper + 1e-9:
                    reason = f"its upper limit is {upper:g}, less than {end:g}"
                    raise AccessFailed(joint, reason, handle=link, arm=arm.name, asked=end)
                steps = max(1, math.ceil(abs(end - start) / _STEP))
                values = [start + (end - start) * i / steps for i in range(steps + 1)]
                with choosing(
                    "handle_path", robot.world, object=container, joint=joint, handle=link, arm=arm.name, to=end
                ) as choice:
                    path = self._path(robot, arm, handle, values, choice)
                    reach = self.execution.approach(
                        robot,
                        arm,
                        path.postures[0],
                        (-1.0, 0.0, 0.0),
                        opened=arm.gripper.positions("open"),
                        ignored_links=[(container, link)],
                    )
                    pull = self.execution.pull(robot, container, joint, path.values, path.postures)
            reach()
            with robot.world.lock:
                now = container.get_joint_position(joint)
                if abs(now - start) > _STILL:
                    reason = f"the joint moved from {start:.3f} to {now:.3f} while the hand approached; try again"
                    raise AccessFailed(joint, reason, handle=link, arm=arm.name, asked=end)
                close = self.execution.turn_fingers(robot, arm, 0)
            close()
            pull()
            with robot.world.lock:
                release = self.execution.turn_fingers(robot, arm, 1)
            release()
            with robot.world.lock:
                retreat = self.execution.retreat(robot, arm, [(container, link)])
            if retreat is not None:
                retreat()

    @staticmethod
    def _path(robot: Object, arm: Arm, handle: Handle, values: Sequence[float], choice: Choice) -> HandlePath:
        """Return the arm's path, if need be with another torso height; raise HandleUnreachable or HandleBlocked."""
        found = plan_path(robot, arm, handle, values, choice=choice)
        swept = list(_swept(handle, values))
        if swept:
            pairs = [pair for _, pair in swept]
            choice.reject(choice.chosen or "any path", Touching(pairs))
            details = {"handle": handle.link, "arm": arm.name, "asked": values[-1], "value": swept[0][0]}
            raise HandleBlocked(handle.joint, _in_the_way(pairs), pairs=pairs, **details)
        if not isinstance(found, DeadEnd):
            return found
        lifted = plan_path_with_torso(robot, arm, handle, values, choice)
        if lifted is not None:
            return lifted
        with choosing("remedy", robot.world, object=handle.container, joint=handle.joint, to=values[-1]) as other:
            hints = arms_in_the_way(robot, arm, handle, values, found.pairs)
            hints += [remedy.phrase() for remedy in remedies(robot, arm, handle, values, other)]
        if found.reached is not None and found.reached != values[0]:
            hints.insert(0, f"from here the arm could move the joint to {found.reached:.3f}")
        raise _failure(arm, handle, values[-1], found, hints or ["other arms and nearby places don't help"])


def _failure(arm: Arm, handle: Handle, asked: float, end: DeadEnd, hints: Sequence[str]) -> AccessFailed:
    details = {
        "handle": handle.link,
        "arm": arm.name,
        "asked": asked,
        "value": end.value,
        "reached": end.reached,
        "orientation": end.orientation,
        "remedies": hints,
    }
    if end.pairs:
        return HandleBlocked(handle.joint, _in_the_way(end.pairs), pairs=end.pairs, **details)
    if end.distance is None:
        reason = "the arm would have to change its posture while it holds the handle"
    else:
        reason = f"the nearest posture found stays {end.distance:.3f} m and {math.degrees(end.turn):.0f} degrees away"
    return HandleUnreachable(handle.joint, reason, target=end.position, distance=end.distance, turn=end.turn, **details)


def _in_the_way(pairs: Sequence[CollisionPair]) -> str:
    return f"{', '.join(sorted({pair.body for pair in pairs}))} would be in the way: {phrases(pairs)}"


def _swept(handle: Handle, values: Sequence[float]) -> Iterator[tuple[float, CollisionPair]]:
    """Yield obstacles that a drawer or door would push, and the joint's positions at the contact.

    Contents of the container aren't obstacles, because they move with it. Objects in hands are obstacles.
    """
    container = handle.container
    clone = clone_of(container.world, "reach")
    clone.sync()
    along = {container, *handle.contents}
    others = [body for body in container.world.objects if not body.fixed and attachment.root_of(body) not in along]
    known: set[str] = set()
    try:
        for value, link in itertools.product(values[1:], handle.moved):
            if len(known) == len(others):
                return
            part = clone.link(container, link)
            clone.engine.set_pose(part, handle.pose(value, link))
            for body in others:
                points = clone.engine.closest_points(part, clone.body(body.name)) if body.name not in known else ()
                deepest = min(points, key=lambda point: point.distance, default=None)
                if deepest is not None and deepest.distance < -DEPTH:
                    known.add(body.name)
                    yield value, CollisionPair(container.name, link, body.name, deepest.link_b, -deepest.distance)
    finally:
        clone.invalidate(container.name)
