"""A session of the debugger: a guided plan, its breakpoints, and what leads from step to step."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from replay.debug.breakpoints import breakpoint_at, watch_of
from replay.debug.stops import Watched
from replay.debug.timeline import Timeline, first_after, last_before
from replay.errors import ReplayError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from replay.debug.breakpoints import Breakpoint
    from replay.debug.guided_plan import Arrival, GuidedPlan
    from replay.recording import Recording


class NoFurther(ReplayError):
    """There is no step to go to: the recording begins or ends there, or the plan parts from it.

    Attributes:
        step: where the plan is.
    """

    def __init__(self, step: int, cause: str) -> None:
        super().__init__(cause)
        self.step = step


@dataclass(frozen=True, slots=True)
class Halt:
    """Where the plan has stopped, and why there.

    Attributes:
        arrival: the step.
        met: the breakpoints there.
        changes: values before and after of what was watched on the plan's variables, by the watch's number.
    """

    arrival: Arrival
    met: list[Breakpoint] = field(default_factory=list)
    changes: dict[int, tuple[str, str]] = field(default_factory=dict)


class Session:
    """A guided plan that is debugged.

    Args:
        log: the recording.
        plan: the plan.

    Attributes:
        log: as given.
        plan: as given.
        breakpoints: those that are set, in the order of their numbers.
    """

    def __init__(self, log: Recording, plan: GuidedPlan) -> None:
        self.log = log
        self.plan = plan
        self.breakpoints: list[Breakpoint] = []
        self._numbers = 0

    @cached_property
    def timeline(self) -> Timeline:
        """What the steps are part of."""
        return Timeline(self.log)

    @property
    def step(self) -> int:
        """Where the plan is."""
        return self.plan.step

    def set_break(self, place: str, *, temporary: bool = False) -> Breakpoint:
        """Set a breakpoint; see :func:`replay.debug.breakpoints.breakpoint_at`."""
        made = breakpoint_at(self.log, self.timeline, self._numbers + 1, place)
        made.temporary = temporary
        return self._kept(made)

    def set_watch(self, expression: str, frame: int) -> Breakpoint:
        """Watch an expression about recorded states, or else about the variables of one of the plan's frames."""
        return self._kept(self._watch(expression, frame))

    def _kept(self, made: Breakpoint) -> Breakpoint:
        self._numbers = made.number
        self.breakpoints.append(made)
        return made

    def _watch(self, expression: str, frame: int) -> Breakpoint:
        return watch_of(self.log, self._numbers + 1, expression, lambda: self._watched(expression, frame))

    def _watched(self, expression: str, frame: int) -> Watched | None:
        """Return what is watched in a frame's function; None if the expression has no value there."""
        stack = self.plan.ask("where")
        if not frame < len(stack) or "error" in self.plan.ask(
            "evaluate", frame=frame, expression=expression, pretty=False
        ):
            return None
        return Watched(expression, stack[frame]["file"], stack[frame]["first"])

    # --- from step to step ------------------------------------------------------------------------------------------

    def forward(self, target: int | None = None) -> Halt:
        """Go on to a step, by default the last, or to the first breakpoint on the way.

        Raises:
            NoFurther: this is the last step that it can come to.
        """
        if self.step >= self.plan.last:
            raise self._no_further()
        goal = self.plan.last if target is None else min(target, self.plan.last)
        enabled = [each for each in self.breakpoints if each.enabled]
        hits = [step for each in enabled if (step := first_after(each.steps, self.step)) is not None]
        return self._halted(self.plan.go(min([goal, *hits]), self._on_plan(enabled)), enabled)

    def back(self, target: int = 0) -> Halt:
        """Go back to a step, by default the first, or to the last breakpoint before this one.

        Raises:
            NoFurther: this is the first step.
        """
        if self.step <= 0:
            raise NoFurther(self.step, "the recording begins here")
        enabled = [each for each in self.breakpoints if each.enabled]
        hits = [step for each in enabled if (step := last_before(each.steps, self.step)) is not None]
        goal = max([target, *hits])
        changes: dict[int, tuple[str, str]] = {}
        watched = self._on_plan(enabled)
        if watched:
            changed, changes = self._last_change(watched, goal - 1, self.step)
            goal = max(goal, changed)
        return self._halted(self.plan.go(goal), enabled, changes)

    def back_to_change(self, expression: str, frame: int) -> Halt:
        """Go back to where an expression last changed, as for :meth:`set_watch`.

        Raises:
            NoFurther: it didn't before this step.
        """
        watch = self._watch(expression, frame)
        step = last_before(watch.steps, self.step)
        changes: dict[int, tuple[str, str]] = {}
        if watch.watched is not None:
            step, changes = self._last_change([watch.watched], -1, origin := self.step)
            if step < 0:
                self.plan.go(origin)
        if step is None or step < 0:
            raise NoFurther(self.step, f"{expression} didn't change before this step")
        watch.number = 0
        return self._halted(self.plan.go(step), [watch], dict(enumerate(changes.values())))

    def go(self, step: int) -> Halt:
        """Go to a step, whatever is on the way.

        Raises:
            NoFurther: the plan can't come to it.
        """
        if step > self.plan.last:
            raise self._no_further()
        return self._halted(self.plan.go(step), [])

    def _no_further(self) -> NoFurther:
        last, parted = self.plan.last, self.plan.parted
        return NoFurther(self.step, f"the plan comes to step {last}: {parted}" if parted else "the recording ends here")

    @staticmethod
    def _on_plan(enabled: Iterable[Breakpoint]) -> list[Watched]:
        return [each.watched for each in enabled if each.watched is not None]

    def _last_change(self, watched: list[Watched], after: int, before: int) -> tuple[int, dict[int, tuple[str, str]]]:
        """Return the last step between two at which what is watched changed, and how, by its place; else the first.

        The plan runs to find out, from the nearest copy that waits, then from the one before.
        """
        end = before - 1
        while end > max(after, 0):
            start = last_before(self.plan.checkpoints, end) or 0
            self.plan.go(start)
            changes = [each for each in self.plan.go(end, watched, through=True).changes if each[0] > after]
            if changes:
                step = changes[-1][0]
                return step, {place: (old, new) for at, place, old, new in changes if at == step}
            if not start:
                break
            end = start
        return after, {}

    def _halted(
        self, arrival: Arrival, enabled: list[Breakpoint], changes: dict[int, tuple[str, str]] | None = None
    ) -> Halt:
        found = changes or {place: (old, new) for step, place, old, new in arrival.changes if step == arrival.step}
        on_plan = [each for each in enabled if each.watched is not None]
        met = [each for each in enabled if arrival.step in each.steps]
        met += [on_plan[place] for place in found]
        for each in met:
            if each.temporary and each in self.breakpoints:
                self.breakpoints.remove(each)
        return Halt(arrival, met, {on_plan[place].number: change for place, change in found.items()})
