"""The facade of recordings.

It turns names of steps into numbers, because functions of other packages take only numbers.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from recorder import html
from recorder.tasks import Tree
from replay.errors import ReplayError
from replay.file.lifetimes import title
from replay.file.record_reader import RecordReader
from replay.history.steps import moment_of, step_of
from replay.state.fold import last_open_step, state_at
from replay.state.state import RecordedBelief, State

if TYPE_CHECKING:
    from PIL import Image

    from pycram.world.world import BulletWorld
    from recorder.properties import Property
    from replay.explain.check import CheckedProperty
    from replay.explain.why import Why
    from replay.history.blame import Blame
    from replay.report.question import QueryCall
    from replay.restore.ask import Move, QueryAnswer
    from replay.restore.render import DrawnWorld

_SMALL: Final = (320, 240)  # size in pixels of a picture in a notebook


@dataclass(frozen=True, slots=True)
class _Moment:
    """A step of a recording, or a moment after it."""

    log: Recording
    step: int
    moment: float | None

    def last_open(self, world: str | None) -> State:
        step = last_open_step(self.log, self.step, world)
        return replace(state_at(self.log, step), source=_Moment(self.log, step, None))

    def png(self, world: str) -> bytes | None:
        try:
            from replay.restore.render import DrawnWorld  # noqa: PLC0415  as in render()

            picture = DrawnWorld(self.log, self.step, world, self.moment).picture(size=_SMALL)
        except (ImportError, ReplayError):
            return None
        file = io.BytesIO()
        picture.save(file, "PNG")
        return file.getvalue()


class Recording(RecordReader):
    """A recording, which ``replay.open(path)`` opens, for a single thread.

    A step is a number or a name (:meth:`step`).

    Raises:
        NotALog: The file isn't a recording, or can't be read at all.
    """

    def _repr_html_(self) -> str:
        from replay.history.tasks import summary  # noqa: PLC0415  slow to import

        info = summary(self)
        facts = {
            "plan": info.plan,
            "started": f"{info.started:%Y-%m-%d %H:%M:%S} UTC",
            "took": f"{info.seconds:.3f} s",
            "outcome": info.outcome,
            "failure": info.failure,
            "worlds": ", ".join(f"{title(each.world, each.lifetime)}: {each.seconds:.3f} s" for each in info.worlds),
            "incomplete": info.problems,
        }
        rows = [(name, text) for name, text in facts.items() if text]
        return html.page(f"{self.path}: {info.records} steps", html.table(("", ""), rows))

    def step(self, name: int | str) -> int:
        """Return the number of a step from a name of :func:`replay.history.steps.step_of`."""
        return step_of(self, name)

    def state_at(self, step: int | str) -> State:
        """Return the state after a step (:func:`replay.state.fold.state_at`).

        For a time within a simulation, such as "0.25s", return the state of the last sample, whose time is
        ``state.sampled``. Pictures, questions and restored worlds also use this sample; exactly restored worlds are
        simulated up to the requested time.
        """
        number, moment = self.step(step), moment_of(step)
        return replace(state_at(self, number, moment), source=_Moment(self, number, moment))

    def believed(
        self, step: int | str, what: str, *, robot: str | None = None, world: str | None = None
    ) -> RecordedBelief | None:
        """Return a robot's latest belief about an object or a type of object; None without a belief.

        By default: any robot, in the last opened world.
        """
        return next(iter(self.state_at(step).world(world).believed(what, robot)), None)

    def tree(self, step: int | str | None = None) -> Tree:
        """Return the task tree at the end or after a step, with the classes of ``pycram.tasks``."""
        from replay.history.tasks import tree  # noqa: PLC0415  slow to import

        return tree(self, None if step is None else self.step(step) + 1)

    def why(self, step: int | str | None = None) -> Why:
        """Explain a failure (:func:`replay.explain.why.why`)."""
        from replay.explain.why import why  # noqa: PLC0415  slow to import

        return why(self, None if step is None else self.step(step))

    def blame(self, target: str, step: int | str | None = None, world: str | None = None) -> Blame:
        """Return the last change of a body or joint (:func:`replay.history.blame.blame`)."""
        from replay.explain import blame_report  # noqa: F401, PLC0415  imported here: shows changes in notebooks
        from replay.history.blame import blame  # noqa: PLC0415  as above

        return blame(self, target, None if step is None else self.step(step), world)

    def check(self, *properties: str | Property) -> list[CheckedProperty]:
        """Check properties, such as ``never contact(pr2, kitchen)`` (docs/reference/properties.md).

        A result is true if its property holds. Properties with contacts need the executor.

        Raises:
            BadProperty: A text isn't in the language, or contains an unknown name.
        """
        from recorder.properties import parse  # noqa: PLC0415  slow to import
        from replay.explain.check import check  # noqa: PLC0415  as above

        parsed = [parse(each) if isinstance(each, str) else each for each in properties]
        geometry = None
        if any(each.needs_geometry for each in parsed):
            from replay.restore.recorded_world import contacts_of  # noqa: PLC0415  needs the executor

            geometry = contacts_of(self)
        return check(self, parsed, geometry)

    def render(
        self,
        step: int | str,
        *,
        camera: str | None = None,
        eye: Sequence[float] | str | None = None,
        target: Sequence[float] | str | Sequence[str] | None = None,
        size: tuple[int, int] = (640, 480),
        world: str | None = None,
    ) -> Image.Image:
        """Return a picture (:meth:`replay.restore.render.DrawnWorld.picture`), which needs trimesh and pillow.

        If no world is open, the picture shows the last step with an open world: ``picture.info["step"]``.
        """
        return self._drawn_world(step, world).picture(camera=camera, eye=eye, target=target, size=size)

    def film(
        self,
        steps: Iterable[int | str],
        *,
        eye: Sequence[float] | str | None = None,
        target: Sequence[float] | str | Sequence[str] | None = None,
        size: tuple[int, int] = (640, 480),
        world: str | None = None,
    ) -> Iterator[Image.Image]:
        """Yield pictures of several steps, all from one viewpoint; each takes much less time than a single picture.

        :meth:`render` and :func:`replay.restore.render.film` describe the arguments.
        """
        from replay.restore.render import film  # noqa: PLC0415

        worlds = [self._drawn_world(step, world) for step in steps]
        yield from film(worlds, eye=eye, target=target, size=size) if worlds else ()

    def _drawn_world(self, step: int | str, world: str | None) -> DrawnWorld:
        """Return a world to draw: after a step, or else after the last step at which the world was open."""
        from replay.restore.render import DrawnWorld  # noqa: PLC0415

        shown = last_open_step(self, self.step(step), world)
        return DrawnWorld(self, shown, world, moment_of(step) if shown == self.step(step) else None)

    def ask(
        self,
        step: int | str,
        question: str | QueryCall | None = None,
        *,
        world: str | None = None,
        moves: Sequence[Move] = (),
    ) -> QueryAnswer:
        """Ask a reasoning query at a past step (:func:`replay.restore.ask.ask`), which needs the executor.

        If no world is open, the query is asked at the last step with an open world: ``answer.step``.
        """
        from replay.restore.ask import ask  # noqa: PLC0415

        asked = self.step(step) if question is None else last_open_step(self, self.step(step), world)
        moment = moment_of(step) if asked == self.step(step) else None
        return ask(self, asked, question, world=world, moves=moves, moment=moment)

    def world_at(
        self, step: int | str, world: str | None = None, *, exact: bool = False, mode: str = "DIRECT"
    ) -> BulletWorld:
        """Return a live world (:func:`replay.restore.world.world_at`), which needs the executor."""
        from replay.restore.world import world_at  # noqa: PLC0415

        return world_at(self, self.step(step), world, exact=exact, mode=mode, moment=moment_of(step))
