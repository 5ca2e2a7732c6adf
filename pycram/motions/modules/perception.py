"""Finding objects: by looking, or in the state of the world."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import MissingPart, PerceptionError
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.queries.visibility import visible

if TYPE_CHECKING:
    from pycram.motions.designator import Designator
    from pycram.world.object import Object

RECOGNISABLE: Final = 0.5
"""Share of an object that has to be seen to know it."""


class Detecting(SimulatedModule):
    """Finds the object of a type that the robot's camera sees best, as it is directed now."""

    def _execute(self, designator: Designator) -> Object:
        kind = designator.reference()["object-type"]
        robot = self.robot()
        camera = self.description(robot).camera
        if camera is None:
            raise MissingPart(robot.name, "camera")
        reasons: dict[str, str] = {}
        seen: list[tuple[float, Object]] = []
        with robot.world.lock:
            for body in robot.world.get_objects_by_type(kind):
                verdict = visible(body, camera.frame, robot=robot, threshold=RECOGNISABLE)
                if verdict:
                    seen.append((float(str(verdict.evidence["share"])), body))
                else:
                    reasons[body.name] = _reason(dict(verdict.evidence))
        if not seen:
            raise PerceptionError(kind, reasons)
        return max(seen, key=lambda item: item[0])[1]


def _reason(evidence: dict[str, Any]) -> str:
    """Return in words why an object isn't seen."""
    share, hiders = evidence["share"], ", ".join(evidence["hidden_by"])
    reason = evidence.get("reason") or (f"is seen to {share:.0%} only" if share else "is not seen")
    return f"{reason} (behind {hiders})" if hiders else reason


class WorldStateDetecting(SimulatedModule):
    """Finds an object of a type in the state of the world, the nearest one; it need not be seen."""

    def _execute(self, designator: Designator) -> Object:
        kind = designator.reference()["object-type"]
        robot = self.robot()
        with robot.world.lock:
            here = robot.get_position()
            found = robot.world.get_objects_by_type(kind)
            if not found:
                raise PerceptionError(kind)
            return min(
                found, key=lambda body: sum((a - b) ** 2 for a, b in zip(body.get_position(), here, strict=True))
            )
