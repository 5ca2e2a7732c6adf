"""A description of a robot that is guessed from its URDF, as TOML with comments for a reviewer.

Comments mark typical values of a camera, because a URDF doesn't contain values such as the field of view.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.describing.chains import ARM, ArmChain, JointTree
from pycram.describing.grippers import TIPS, Corners, HandGuess, SuctionGuess, guess_hand, suction_cup
from recorder import geometry
from recorder.geometry import IDENTITY
from recorder.urdf import UrdfJoint

if TYPE_CHECKING:
    from pycram.models.load import Model

_WIDTH: Final = 110  # characters per line
_DIGITS: Final = 4
_CUP: Final = 0.012  # radius in m of a suction cup
_USUAL: Final = """horizontal_fov = 1.2  # typical values: a URDF has none
vertical_fov = 0.96
width = 640
height = 480
near = 0.05
far = 10.0"""
_OPTICAL_OFFSET: Final = (
    "frame_offset = { rpy = [-1.5707963267948966, 0, -1.5707963267948966] }  # x points forward, z up"
)


@dataclass(frozen=True, slots=True)
class Guess:
    """The parts of a robot that were recognised in its URDF."""

    model: Model
    #: Each arm with its gripper, or with the reason why no gripper was found.
    arms: Sequence[tuple[ArmChain, HandGuess | SuctionGuess | str]]
    torso: UrdfJoint | None  # the joint that lifts the arms
    camera: str  # the link of a camera; "" without a camera
    head: Mapping[str, str]  # names of the head's joints by "pan" and "tilt"
    drives: bool  # whether the base can drive


def guess(model: Model, *, suction: bool = False) -> Guess:
    """Return the recognised parts of a robot; with ``suction``, arms without a gripper get suction cups."""
    tree = JointTree(model.urdf)
    corners = Corners(model)
    arms = tree.arms()
    camera = tree.camera()
    found = [(arm, guess_hand(tree, arm, corners)) for arm in arms]
    return Guess(
        model=model,
        arms=[
            (arm, suction_cup(tree, arm, corners) if suction and isinstance(hand, str) else hand) for arm, hand in found
        ],
        torso=tree.torso(arms),
        camera=camera,
        head=tree.head(camera, arms),
        drives=tree.drives(),
    )


def as_toml(
    guess: Guess, postures: Mapping[str, Sequence[float]] | None = None, may_touch: Iterable[tuple[str, str]] = ()
) -> str:
    """Return the TOML of a guess, with pairs of links that may touch.

    ``postures`` are the joint positions of parked arms by the arm's name, rad or m.
    """
    return "\n".join(_lines(guess, postures or {}, sorted(may_touch))) + "\n"


def _lines(guess: Guess, postures: Mapping[str, Sequence[float]], pairs: Sequence[tuple[str, str]]) -> Iterator[str]:
    urdf = guess.model.urdf
    yield "# Written by pycram describe: a guessed description. Please review it. Units: metres, radians."
    yield from (f"robot = {quoted(urdf.name)}", f"base_link = {quoted(urdf.root)}")
    yield f"drives = {'true' if guess.drives else 'false'}"
    if pairs:
        yield "may_touch = [  # links that overlap in every posture"
        yield from (f"    {_list(pair)}," for pair in pairs)
        yield "]"
    if guess.torso is not None:
        middle = (guess.torso.lower + guess.torso.upper) / 2
        yield from ("", "[torso]", f"joint = {quoted(guess.torso.name)}")
        yield f"default = {_number(middle)}  # position when loaded"
    if guess.camera:
        if guess.head:
            yield from ("", "[head]")
            yield from (f"{part} = {quoted(guess.head[part])}" for part in ("pan", "tilt") if part in guess.head)
        yield from ("", "[camera]", f"frame = {quoted(guess.camera)}")
        yield from (_USUAL,) if "optical" in guess.camera.lower() else (_OPTICAL_OFFSET, _USUAL)
    if not guess.arms:
        yield from ("", f"# no arms: no chain of {ARM} joints, except in legs and heads")
    for arm, hand in guess.arms:
        yield from _arm(arm, hand, postures.get(arm.name))


def _arm(arm: ArmChain, hand: HandGuess | SuctionGuess | str, park: Sequence[float] | None) -> Iterator[str]:
    gripper = None if isinstance(hand, str) else hand
    yield from ("", f"[arms.{arm.name}]", f"base_link = {quoted(arm.joints[0].parent)}")
    palm = gripper.palm if isinstance(gripper, HandGuess) else arm.joints[-1].child
    yield f"tool_frame = {quoted(palm)}"
    if gripper and gripper.offset != IDENTITY:
        position, turn = gripper.offset
        angles = ", ".join(f"{round(angle, 12) + 0.0}" for angle in geometry.to_rpy(turn))
        yield f"tool_offset = {{ xyz = {_row(position)}, rpy = [{angles}] }}"
    yield from _listed("joints", [joint.name for joint in arm.joints])
    if park is not None:
        yield from ("", f"[arms.{arm.name}.poses]", f"park = {_row(park)}")
    if isinstance(hand, str):
        yield f"# no gripper: {hand}"
        return
    yield from ("", f"[arms.{arm.name}.gripper]", f"palm = {quoted(palm)}")
    if isinstance(hand, SuctionGuess):
        yield f"suction = {_CUP:g}  # a typical radius: the URDF has no suction cup"
        yield f"underside = {_number(hand.underside)}  # below the tool frame when the cup is level"
        return
    yield from _listed("fingers", hand.fingers)
    yield from _listed("joints", hand.joints)
    yield f"closed = {_row(hand.closed)}"
    yield f"open = {_row(hand.open)}"
    yield f"aperture = {_number(hand.aperture)}  # between the finger tips when open"
    if hand.gap:
        yield f"gap = {_number(hand.gap)}  # between the finger tips when closed"
    yield f"depth = {_number(hand.depth)}  # from the tool frame back, where an object fits"
    yield f"tips = {TIPS:g}  # from the tool frame forward, closed"
    yield f"underside = {_number(hand.underside)}  # below the tool frame when the gripper is level"


def quoted(text: str) -> str:
    """Return a text as a TOML string."""
    return json.dumps(text, ensure_ascii=False)  # a JSON string is a basic string of TOML


def _number(value: float) -> str:
    """Return a number as text, rounded towards zero so that it stays within a joint limit."""
    scale = 10**_DIGITS
    return f"{math.trunc(value * scale + math.copysign(1e-9 * scale, value)) / scale + 0.0:g}"


def _row(values: Iterable[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _list(names: Iterable[str]) -> str:
    return f"[{', '.join(map(quoted, names))}]"


def _listed(key: str, names: Sequence[str]) -> list[str]:
    """Return the TOML lines of a list of names: one line for a short list, else a line for each name."""
    line = f"{key} = {_list(names)}"
    return [line] if len(line) <= _WIDTH else [f"{key} = [", *(f"    {quoted(name)}," for name in names), "]"]
