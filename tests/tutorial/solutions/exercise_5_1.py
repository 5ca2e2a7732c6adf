from scene import build

from pycram import perform
from pycram.bullet_world import BulletWorld
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule, register


class Nodding(ProcessModule):
    """Nods with the head."""

    def _execute(self, designator):
        for angle in (designator.reference()["depth"], 0):
            BulletWorld.robot.set_joint_position("head_tilt_joint", angle)


@MotionDesignator.add_resolver
def nodding(designator):
    if designator.type == "nodding":
        return [{"cmd": "nodding", "depth": designator.prop_value("depth") or 0.5}]
    return None


register("pr2", "simulated", {"nodding": Nodding()})

with build():
    perform(MotionDesignator(type="nodding"))
