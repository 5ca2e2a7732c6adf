"""Attachments: the pairs of a carrier and a carried object, and the objects that move along with a moving object.

An attached body keeps its pose relative to the carrier's link: without simulation it is moved with the carrier; in
simulation, a fixed constraint holds it. A link supports a body if the body rests on the link, hangs just above its
floor, or rests on a supported body. Bodies that a drawer supports move with the drawer. If a hand takes a body, bodies
in or on this body are attached loosely (:func:`taken_along`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import AttachmentError
from pycram.models.robots.description import Arm
from pycram.physics.body import ClosestPoint
from pycram.world.overlaps import DEEP
from pycram.world.transaction import Transaction
from recorder import geometry, records
from recorder.geometry import Pose
from recorder.urdf import Urdf

if TYPE_CHECKING:
    from pycram.world.object import Object

_CONTACT_GAP: Final = 0.003  # largest distance in m between a resting body and its support; half a millimetre is usual
_DROP_HEIGHT: Final = 0.03  # largest height in m of a body above the floor of the drawer that contains it
_GRIP_GAP: Final = 0.001  # distance in m between a body and a finger that holds it
_SLIGHT: Final = 2e-3  # maximum overlap in m of bodies that move apart without pushing each other
_BELOW: Final = -0.1  # maximum z of a contact's unit normal if a body touches another body from above


class StillHeld(UserWarning):
    """An object was detached, but closed fingers still hold the object by friction in simulation."""


@dataclass(frozen=True, slots=True)
class BodyAttachment:
    """An object that another object carries."""

    carrier: Object
    carrier_link: str
    body: Object
    body_link: str  # the carrier's link that holds the body
    pose: Pose  # pose of the body's base link in the carrier's link: position in m, orientation xyzw
    constraint: int  # the engine's id of the constraint that holds the body in simulation
    loose: bool = False  # whether the body only lies in or on the carrier, and is released with the carrier
    left: Sequence[Object] = ()  # bodies that don't collide with the held body in simulation

    def other(self, side: Object) -> Object:
        """Return the other object of the attachment."""
        return self.body if side is self.carrier else self.carrier

    def record(self) -> records.Attachment:
        """Return the attachment as a record."""
        return records.Attachment(
            carrier=self.carrier.name,
            carrier_link=self.carrier_link,
            body=self.body.name,
            body_link=self.body_link,
            position=self.pose[0],
            orientation=self.pose[1],
            loose=self.loose,
        )


def attach(
    carrier: Object,
    body: Object,
    link: str | None,
    body_link: str | None,
    pose: Pose | None = None,
    *,
    along: Sequence[Object] = (),
    left: Sequence[Object] = (),
    loose: bool = False,
) -> None:
    """Make an object carry another object; see :meth:`pycram.world.object.Object.attach`.

    If only the body has a fixed base, as robots and furniture have, the body becomes the carrier.

    Args:
        link: The carrier's link; None for its base link.
        body_link: The held link of the body; None for its base link.
        pose: Pose of the body's base link in the carrier's link; None for the present pose.
        along: Bodies in or on the body that move along until the body is released; see :func:`taken_along`.
        left: Bodies that stay, but overlap the moving bodies or lean on them. In simulation, both don't collide.
        loose: Whether the body only lies in or on the carrier, and is released with the carrier.
    """
    if body in carrier.attachments:
        return
    if body.fixed and not carrier.fixed and pose is None:
        carrier, body, link, body_link = body, carrier, body_link, link
    world, carrier_link, held_link = carrier.world, carrier.check_link(link), body.check_link(body_link)
    command = records.AttachBody(
        carrier=carrier.name,
        carrier_link=carrier_link,
        body=body.name,
        body_link=held_link,
        along=[load.name for load in along],
        left=[other.name for other in left],
    )
    with world.transactions.begin(records.Mutation(attach_body=command)) as transaction:
        _check(carrier, body)
        _hold(carrier, carrier_link, body, held_link, transaction, pose, left=left, loose=loose)
        transaction.fire(world.get_attachment_event(), carrier, body)
        for load in along:
            _check(body, load)
            _hold(body, held_link, load, load.base_link, transaction, left=left, loose=True)
            transaction.fire(world.get_attachment_event(), body, load)


def detach(side: Object, other: Object) -> None:
    """End the attachment between two objects, without moving them; raise AttachmentError if there is none."""
    command = records.Mutation(detach_body=records.DetachBody())
    with side.world.transactions.begin(command) as transaction:
        attachment = next((held for held in side.attachments.values() if held.other(side) is other), None)
        if attachment is None:
            raise AttachmentError(side.name, other.name, "the objects are not attached to each other")
        command.detach_body.carrier, command.detach_body.body = attachment.carrier.name, attachment.body.name
        end(attachment, transaction)


def put_back(carrier: Object, body: Object, saved: records.Attachment, transaction: Transaction) -> None:
    """Restore a saved attachment in a transaction; both objects are at their saved poses."""
    held = carrier.attachments.get(body)
    if held is not None:
        carrier.world.engine.unfix(held.constraint)
    x, y, z = saved.position
    i, j, k, w = saved.orientation
    pose = ((x, y, z), (i, j, k, w))
    left = held.left if held is not None else ()
    _hold(carrier, saved.carrier_link, body, saved.body_link, transaction, pose, left=left, loose=saved.loose)
    if held is None:
        transaction.fire(carrier.world.get_attachment_event(), carrier, body)


def renew(body: Object, transaction: Transaction) -> None:
    """Update the pose of a carried object relative to its carrier after a move without the carrier."""
    carrier = body.carrier
    if carrier is not None:
        old = carrier.attachments[body]
        carrier.world.engine.unfix(old.constraint)
        _hold(carrier, old.carrier_link, body, old.body_link, transaction, left=old.left, loose=old.loose)


def end(attachment: BodyAttachment, transaction: Transaction) -> None:
    """End an attachment in a transaction, and release the objects that lie loosely in or on the body."""
    carrier, body = attachment.carrier, attachment.body
    if carrier.attachments.get(body) is not attachment:
        return  # the attachment has already ended together with another attachment of its carrier
    del carrier._attachments[body], body._attachments[carrier]  # noqa: SLF001  both objects refer to the attachment
    for held in body.carried:
        if held.loose:
            end(held, transaction)
    _pass_through(body, attachment.left, enable=False)
    world = carrier.world
    world.engine.unfix(attachment.constraint)
    world.engine.pass_through(
        carrier.handle, attachment.carrier_link, body.handle, robot=carrier.is_robot, enable=False
    )
    transaction.detached.append(attachment)
    transaction.fire(world.get_detachment_event(), carrier, body)


def _hold(
    carrier: Object,
    link: str,
    body: Object,
    body_link: str,
    transaction: Transaction,
    pose: Pose | None = None,
    *,
    left: Sequence[Object],
    loose: bool,
) -> None:
    engine = carrier.world.engine
    base = engine.pose(body.handle)
    if pose is None:
        pose = geometry.multiply(geometry.invert(engine.link_pose(carrier.handle, link)), base)
    held = engine.link_pose(body.handle, body_link)
    held_pose = geometry.multiply(pose, geometry.multiply(geometry.invert(base), held))
    constraint = engine.fix(carrier.handle, link, body.handle, body_link, held_pose)
    engine.pass_through(carrier.handle, link, body.handle, robot=carrier.is_robot, enable=True)
    _pass_through(body, left, enable=True)
    attachment = BodyAttachment(carrier, link, body, body_link, pose, constraint, loose, left)
    carrier._attachments[body] = body._attachments[carrier] = attachment  # noqa: SLF001  as in end()
    transaction.attached[carrier.name, body.name] = attachment


def _pass_through(body: Object, others: Iterable[Object], *, enable: bool) -> None:
    for other in others:
        for link in other.links if other.alive else ():
            body.world.engine.pass_through(other.handle, link, body.handle, robot=False, enable=enable)


def _check(carrier: Object, body: Object) -> None:
    if carrier is body:
        raise AttachmentError(carrier.name, body.name, "an object can't carry itself")
    if carrier.world is not body.world:
        raise AttachmentError(carrier.name, body.name, f"{body.name} is in {body.world.name}, another world")
    if body.fixed:
        raise AttachmentError(carrier.name, body.name, f"{body.name} has a fixed base")
    if body.carrier is not None:
        raise AttachmentError(carrier.name, body.name, f"{body.carrier.name} carries {body.name}; detach them first")
    if root_of(carrier) is body:
        raise AttachmentError(carrier.name, body.name, f"{body.name} carries {carrier.name} already")


def move_attached(carrier: Object, transaction: Transaction) -> None:
    """Move all carried objects to their relative poses, after their carrier or one of its joints has moved."""
    engine = carrier.world.engine
    for attachment in carrier.carried:
        body = attachment.body
        pose = geometry.multiply(engine.link_pose(carrier.handle, attachment.carrier_link), attachment.pose)
        engine.set_pose(body.handle, pose)
        transaction.mark_modified(body)
        move_attached(body, transaction)


def gripping(robot: Object, body: Object) -> str:
    """Return the name of the arm that holds an object between its fingers; "" if no arm holds it."""
    engine = robot.world.engine
    for arm in robot.description.arms.values() if robot.description else ():
        normals = [
            min(points, key=lambda point: point.distance).normal
            for finger in (arm.gripper.fingers if arm.hand else ())
            if (points := engine.link_closest_points(robot.handle, finger, body.handle, _GRIP_GAP))
        ]
        if any(sum(a * b for a, b in zip(*pair, strict=True)) < 0.0 for pair in itertools.combinations(normals, 2)):
            return arm.name
    return ""


def attached_to(carrier: Object, link: str) -> Object | None:
    """Return an object that is attached to a link of the carrier; None without such an object."""
    return next((attachment.body for attachment in carrier.carried if attachment.carrier_link == link), None)


def held(robot: Object, arm: Arm | None = None) -> list[Object]:
    """Return the objects that a robot carries, also indirectly; with an arm, only objects on its tool frame."""
    found = [each.body for each in robot.carried if arm is None or each.carrier_link == arm.tool_frame]
    for body in found:
        found.extend(each.body for each in body.carried)
    return found


def root_of(body: Object) -> Object:
    """Return the last carrier in an object's chain of carriers; the object itself without a carrier."""
    while body.carrier is not None:
        body = body.carrier
    return body


def moved_links(urdf: Urdf, joints: Iterable[str]) -> list[str]:
    """Return the links that move with joints, in the URDF's order: child links of the joints, and all links below."""
    moved = {urdf.joint(name).child for name in joints}
    for link in urdf.links:  # a parent comes before its children
        joint = urdf.parent_joint(link)
        if joint is not None and joint.parent in moved:
            moved.add(link)
    return [link for link in urdf.links if link in moved]


def supported_bodies(container: Object, links: Iterable[str]) -> dict[Object, str]:
    """Return the free bodies that links of an object support, also indirectly, with the supporting link of each."""
    world = container.world
    engine = world.engine
    free = [body for body in world.objects if not body.fixed and body.carrier is None]
    found: dict[Object, str] = {}
    for link in links:
        ((lower, upper),) = engine.boxes([(container.handle, link)])
        for body in free:
            if body in found:
                continue
            position = engine.pose(body.handle)[0]
            inside = all(low <= x <= high for low, x, high in zip(lower, position, upper, strict=True))
            gap = _DROP_HEIGHT if inside else _CONTACT_GAP
            if any(p.carries for p in engine.link_closest_points(container.handle, link, body.handle, gap)):
                found[body] = link
    queue = list(found)
    while queue:
        below = queue.pop()
        for body in free:
            if body not in found and any(
                point.carries for point in engine.closest_points(below.handle, body.handle, _CONTACT_GAP)
            ):
                found[body] = found[below]
                queue.append(body)
    return found


def move_supported(
    container: Object, before: Mapping[str, Pose], supported: Mapping[Object, str], transaction: Transaction
) -> None:
    """Move the supported bodies with their links; ``before`` has the poses of the links before the links moved."""
    engine = container.world.engine
    for body, link in supported.items():
        moved = geometry.multiply(engine.link_pose(container.handle, link), geometry.invert(before[link]))
        engine.set_pose(body.handle, geometry.multiply(moved, engine.pose(body.handle)))
        transaction.mark_modified(body)
        move_attached(body, transaction)


def taken_along(body: Object) -> tuple[list[Object], list[Object]]:
    """Return the free objects that move along when a hand lifts an object, and the free objects that the hand leaves.

    Objects in or on the lifted object move along. An object that also rests on an object that stays only leans on the
    lifted object, and is left. Other objects that overlap the lifted object are also left.
    """
    engine, objects = body.world.engine, body.world.objects
    free = [other for other in objects if other is not body and not other.fixed and other.carrier is None]

    @cache
    def points(lower: Object, other: Object) -> list[ClosestPoint]:
        return engine.closest_points(lower.handle, other.handle, _CONTACT_GAP)

    along: list[Object] = []
    for lower in (reached := [body]):
        found = [each for each in free if each not in along and any(p.normal[2] < _BELOW for p in points(lower, each))]
        along.extend(found)
        reached.extend(found)

    def rests_elsewhere(load: Object) -> bool:
        others = [other for other in objects if other not in (body, load, *along)]
        return any(  # a shape of furniture may be a hull that contains objects
            point.carries and not (other.fixed and point.distance < -DEEP)
            for other in others
            for point in points(other, load)
        )

    while leaning := [load for load in along if rests_elsewhere(load)]:
        along = [load for load in along if load not in leaning]
    left = [
        other
        for other in free
        if other not in along
        and any(p.carries or p.distance < -_SLIGHT for moved in (body, *along) for p in points(moved, other))
    ]
    return along, left
