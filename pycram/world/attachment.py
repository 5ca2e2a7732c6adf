"""Attachments: which object carries which, and with what relative pose.

The carrier is the object whose ``attach`` was called. What it carries keeps its full pose relative to the carrier's
link whenever the carrier, its joints or the carrier's own carrier move; no simulation is needed. In simulation a fixed
constraint of the engine keeps it there.

``attach`` and ``detach`` are changes; ``renew`` and ``end`` are the parts that other changes are made of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.foundation.failures import AttachmentError
from recorder import geometry, records

if TYPE_CHECKING:
    from pycram.world.object import Object
    from pycram.world.transaction import Change
    from recorder.geometry import Pose


@dataclass(frozen=True, slots=True)
class Attachment:
    """One object carried by another.

    Attributes:
        carrier: the object that carries.
        carrier_link: its link, the base link if none was named.
        body: the carried object.
        body_link: the link by which it is held, its base link if none was named.
        pose: of the carried object's base in the carrier's link: position in m, orientation xyzw.
        constraint: the engine's id of the joint that holds it in simulation.
    """

    carrier: Object
    carrier_link: str
    body: Object
    body_link: str
    pose: Pose
    constraint: int

    def other(self, side: Object) -> Object:
        """The other one of the two."""
        return self.body if side is self.carrier else self.carrier

    def record(self) -> records.Attachment:
        """As records carry it."""
        return records.Attachment(
            carrier=self.carrier.name,
            carrier_link=self.carrier_link,
            body=self.body.name,
            body_link=self.body_link,
            position=self.pose[0],
            orientation=self.pose[1],
        )


def attach(carrier: Object, body: Object, link: str | None, body_link: str | None, pose: Pose | None = None) -> None:
    """Makes an object carry another; an attachment that exists already is left as it is.

    Args:
        carrier: the object that carries.
        body: the object to carry; it keeps its full relative pose.
        link: the carrier's link; its base link for None.
        body_link: the link by which the body is held; its base link for None.
        pose: of the body's base in the carrier's link; None for the one that it has now.

    Raises:
        UnknownName: there is no such link.
        AttachmentError: it makes no sense, see :func:`_check`.
    """
    if body in carrier.attachments:
        return
    world, carrying, held = carrier.world, carrier.check_link(link), body.check_link(body_link)
    command = records.AttachBody(carrier=carrier.name, carrier_link=carrying, body=body.name, body_link=held)
    with world.transactions.change(records.Mutation(attach_body=command)) as change:
        _check(carrier, body)
        _hold(carrier, carrying, body, held, change, pose)
        change.events.append(lambda: world.get_attachment_event().prepare(carrier, body))


def detach(side: Object, other: Object) -> None:
    """Ends an attachment, from either side; both stay where they are.

    Args:
        side: one of the two.
        other: the other one.

    Raises:
        AttachmentError: there is none between the two.
    """
    command = records.Mutation(detach_body=records.DetachBody())
    with side.world.transactions.change(command) as change:
        attachment = next((held for held in side.attachments.values() if held.other(side) is other), None)
        if attachment is None:
            told = getattr(other, "name", repr(other))
            raise AttachmentError(side.name, told, "they are not attached to each other")
        command.detach_body.carrier, command.detach_body.body = attachment.carrier.name, attachment.body.name
        end(attachment, change)


def renew(body: Object, change: Change) -> None:
    """The part of a change that moved a carried object by hand: its carrier goes on with the pose that it has now.

    Args:
        body: the object that was moved; nothing happens if nothing carries it.
        change: notes it.
    """
    carrier = body.carrier
    if carrier is not None:
        old = carrier.attachments[body]
        carrier.world.engine.unfix(old.constraint)
        _hold(carrier, old.carrier_link, body, old.body_link, change)


def end(attachment: Attachment, change: Change) -> None:
    """The part of a change that ends an attachment.

    Args:
        attachment: what ends.
        change: notes it.
    """
    carrier, body = attachment.carrier, attachment.body
    del carrier._attachments[body], body._attachments[carrier]  # noqa: SLF001  this module keeps both sides alike
    world = carrier.world
    world.engine.unfix(attachment.constraint)
    world.engine.pass_through(
        carrier.handle, attachment.carrier_link, body.handle, robot=carrier.is_robot, enable=False
    )
    change.detached.append(attachment)
    change.events.append(lambda: world.get_detachment_event().prepare(carrier, body))


def _hold(carrier: Object, link: str, body: Object, body_link: str, change: Change, pose: Pose | None = None) -> None:
    engine = carrier.world.engine
    base = engine.pose(body.handle)
    if pose is None:
        pose = geometry.multiply(geometry.invert(engine.link_pose(carrier.handle, link)), base)
    held = engine.link_pose(body.handle, body_link)
    held_pose = geometry.multiply(pose, geometry.multiply(geometry.invert(base), held))
    constraint = engine.fix(carrier.handle, link, body.handle, body_link, held_pose)
    engine.pass_through(carrier.handle, link, body.handle, robot=carrier.is_robot, enable=True)
    attachment = Attachment(carrier, link, body, body_link, pose, constraint)
    carrier._attachments[body] = body._attachments[carrier] = attachment  # noqa: SLF001  see end
    change.attach(attachment)


def _check(carrier: Object, body: Object) -> None:
    """Refuses attachments that make no sense.

    Args:
        carrier: the object that is to carry.
        body: the object that is to be carried.

    Raises:
        AttachmentError: they are the same, live in different worlds, the body is fixed or carried by another, or the
            carrier is itself carried by the body.
    """
    if carrier is body:
        raise AttachmentError(carrier.name, body.name, "an object can't carry itself")
    if carrier.world is not body.world:
        raise AttachmentError(carrier.name, body.name, f"{body.name} is in {body.world.name}, another world")
    if body.fixed:
        raise AttachmentError(carrier.name, body.name, f"{body.name} has a fixed base")
    if body.carrier is not None:
        raise AttachmentError(carrier.name, body.name, f"{body.carrier.name} carries it; detach it there first")
    above: Object | None = carrier
    while above is not None:
        if above is body:
            raise AttachmentError(carrier.name, body.name, f"{body.name} carries {carrier.name} already")
        above = above.carrier
