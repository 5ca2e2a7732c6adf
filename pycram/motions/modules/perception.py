"""Process modules that find objects with the camera, or in the state of the world."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

from pycram.foundation.failures import MissingPart, PerceptionError
from pycram.motions.designator import Designator
from pycram.motions.process_module import SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.queries.visibility import visible
from pycram.reasoning.rejections import Inferior, Unseen
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.records import Plain
from recorder.records.beliefs import sightings
from recorder.records.text import unseen_text

RECOGNISABLE: Final = 0.5  # minimum visible share of an object that the robot can recognise


class Detecting(SimulatedModule):
    """Finds the most visible object of a type in the camera's present view; perform ``looking`` first."""

    failures = (PerceptionError, MissingPart)

    def _execute(self, designator: Designator) -> Object:
        kind = designator.reference()["object-type"]
        robot = BulletWorld.current_robot()
        camera = self.description(robot).camera
        if camera is None:
            raise MissingPart(robot.name, "camera")
        reasons: dict[str, str] = {}
        seen: list[tuple[float, Object]] = []
        with robot.world.lock:
            with choosing("best_seen", robot.world, type=kind) as choice:
                for body in robot.world.get_objects_by_type(kind):
                    if not choice.admits(body.name):
                        continue
                    verdict = visible(body, camera.frame, robot=robot, threshold=RECOGNISABLE)
                    evidence: dict[str, Any] = dict(verdict.evidence)
                    if verdict:
                        seen.append((float(evidence["share"]), body))
                        choice.reject(body.name, Inferior("share", evidence["share"]))
                    else:
                        links, hiding = evidence.get("hiding_links", {}), list(evidence["hidden_by"])
                        unseen = Unseen(evidence["share"], hiding, evidence.get("outside", 0.0), links)
                        reasons[body.name] = f"is {unseen_text(unseen.data(), evidence.get('reason', ''))}"
                        choice.reject(body.name, unseen)
                if not seen:
                    raise PerceptionError(kind, reasons)
                best = max(seen, key=lambda item: item[0])[1]
                choice.take(best.name, best, **_sightings(robot, "seen", [body for _, body in seen]))
            robot.world.beliefs.look(choice.evidence, choice.steps)
        return best


def _sightings(robot: Object, source: str, bodies: Iterable[Object]) -> dict[str, Plain]:
    return sightings(robot.name, source, {body.name: body.get_position_and_orientation() for body in bodies})


class WorldStateDetecting(SimulatedModule):
    """Finds the nearest object of a type in the state of the world, even if the object is hidden."""

    failures = (PerceptionError,)

    def _execute(self, designator: Designator) -> Object:
        kind = designator.reference()["object-type"]
        robot = BulletWorld.current_robot()
        with robot.world.lock:
            with choosing("nearest", robot.world, type=kind) as choice:
                here = robot.get_position()
                bodies = [body for body in robot.world.get_objects_by_type(kind) if choice.admits(body.name)]
                found = [(math.dist(body.get_position(), here), body) for body in bodies]
                if not found:
                    raise PerceptionError(kind)
                for distance, body in found:
                    choice.reject(body.name, Inferior("distance", distance))
                nearest = min(found, key=lambda item: item[0])[1]
                choice.take(nearest.name, nearest, **_sightings(robot, "told", [nearest]))
            robot.world.beliefs.look(choice.evidence, choice.steps)
        return nearest
