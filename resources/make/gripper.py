"""A gripper for arms without a gripper: a palm and two fingers that slide along y, made of boxes.

The origin of the root ``gripper_palm`` is on the arm's flange; x points away from the flange.
"""

from __future__ import annotations

from make.urdf import Joint, Link, Material, document, span

MATERIALS = {
    "shell": Material((0.20, 0.21, 0.23), 1200.0),
    "finger": Material((0.70, 0.71, 0.74), 2000.0),
    "pad": Material((0.10, 0.10, 0.10), 1100.0),
}

PALM, REACH = 0.065, 0.145  # ends of the palm and of the fingers, metres along x
STROKE = 0.045  # travel of each finger from the middle, metres
TOOL = 0.128  # the tool frame in the middle of the pads, metres along x


def two_finger_gripper() -> str:
    """The URDF of the gripper."""
    palm = [
        span((0.0, 0.035), (-0.032, 0.032), (-0.032, 0.032), "shell"),
        span((0.035, PALM), (-0.060, 0.060), (-0.020, 0.020), "shell"),
    ]
    links = [Link("gripper_palm", tuple(palm))]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        pad, back = sorted((0.0, sign * 0.003)), sorted((sign * 0.003, sign * 0.013))
        shapes = (
            span((PALM + 0.002, REACH), (back[0], back[1]), (-0.011, 0.011), "finger"),
            span((0.108, REACH), (pad[0], pad[1]), (-0.011, 0.011), "pad"),
        )
        name = f"gripper_{side}_finger"
        joint = Joint(
            f"{name}_joint", "prismatic", "gripper_palm", (0, 0, 0), (0, 0, 0), (0.0, sign, 0.0), (0.0, STROKE)
        )
        links.append(Link(name, shapes, joint))
    links.append(
        Link("gripper_tool", joint=Joint("gripper_tool_joint", "fixed", "gripper_palm", (TOOL, 0, 0), (0, 0, 0)))
    )
    return document("two_finger_gripper", links, MATERIALS, "Written by make_resources.py. Metres, kilograms.")
