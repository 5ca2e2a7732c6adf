"""A monitor follows the records of a run, and reports where properties are violated.

Times are in simulated seconds, summed over all worlds. An episode is a part of the run in which the property must hold,
by default the whole run. An episode's margin is the smallest margin of its moments for "always", and the largest for
"eventually". A property's margin is the smallest margin of its episodes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from recorder import geometry
from recorder.errors import did_you_mean, suggestion
from recorder.properties.expressions import BadProperty, NoValue, Scene, Truth
from recorder.properties.language import ALWAYS, AT_END, EVENTUALLY, NEVER
from recorder.records import STEPS_PER_SECOND, Keyframe, Mutation, Record, Task
from recorder.records.fold import FoldedBody, FoldedWorld, apply

if TYPE_CHECKING:
    from recorder.properties.expressions import Geometry, PropertyExpression
    from recorder.properties.language import Moments, Property

_BEST, _WORST = Truth(math.inf, True), Truth(-math.inf, False)
FOLLOWED: Final = (Task, Mutation, Keyframe)  # the kinds of records that a monitor follows
_SETTLING: Final = 5e-3, math.radians(5)  # an object with smaller changes settles: m, rad
NEVER_HELD: Final = "not until the end"  # cause at the end of a run, because the condition never held
_ENDS: Final = (Task.FINISHED, Task.LEFT)


class CheckedMoment(NamedTuple):
    """A moment of a run."""

    step: int
    sim_step: int  # simulated steps of the record's world up to this moment
    time: float  # simulated time in s, summed over all worlds
    world: str = ""
    task: int = 0
    sampled: bool = False  # whether the moment is a sample within a simulation's record

    @property
    def seconds(self) -> float:
        """The simulated time of the record's world in s."""
        return self.sim_step / STEPS_PER_SECOND


@dataclass(frozen=True, slots=True)
class Violation:
    """A moment at which a property is violated."""

    statement: Property
    moment: CheckedMoment
    margin: float  # negative margin of the property; 0 if a value equals a limit that it must not reach
    values: dict[str, Any]  # values of the property's quantities, by their texts
    cause: str = ""  # why the property is violated, if the values don't show it
    since: CheckedMoment | None = None  # start of the last period in which the condition doesn't hold


@dataclass(frozen=True, slots=True)
class PropertyVerdict:
    """The result of a property for a whole run."""

    statement: Property
    margin: float  # smallest change of a quantity that reverses the result, in the property's unit; may be infinite
    closest: CheckedMoment | None  # moment that has this margin; None if there were no episodes
    values: dict[str, Any]  # values of the quantities at the moment ``closest``
    violations: list[Violation]
    episodes: int  # number of episodes
    note: str = ""  # why the property never applied; "" if the property applied

    @property
    def holds(self) -> bool:
        """Whether the property was never violated."""
        return not self.violations


class Monitor:
    """A monitor of properties over the records of a run, from the first record or from keyframes of all worlds."""

    def __init__(self, properties: Sequence[Property], contacts: Geometry | None = None) -> None:
        self.worlds: dict[str, FoldedWorld] = {}
        self._scene = Scene(self.worlds, contacts)
        self._watches = [_Watch(each, self._scene) for each in properties]
        self._clocks: dict[str, int] = {}
        self._total = 0
        self._names: dict[int, tuple[str, ...]] = {}  # names of the running tasks, outermost first
        self._last = CheckedMoment(0, 0, 0.0)
        self._known: dict[str, None] = {}  # names of all tasks
        self._measured: dict[FoldedBody, tuple[float, ...]] = {}  # measured velocities that replace the recorded ones

    def feed(self, record: Record) -> list[Violation]:
        """Follow the next record, and return its violations."""
        if isinstance(record, Task):
            return self._task(record)
        if not isinstance(record, Mutation | Keyframe):
            return []
        name = record.world
        if isinstance(record, Keyframe) and name in self.worlds:
            return []
        found: list[Violation] = []
        if isinstance(record, Mutation) and record.effect.samples and name in self.worlds:
            for sample in record.effect.samples[:]:
                found += self._wait(record, sample.sim_step)
                self._apply(name, partial(self.worlds[name].apply_sample, sample))
                found += self._look(record, sample.sim_step)
        if isinstance(record, Mutation) and record.HasField("open_world"):
            self._clocks[name] = 0
        found += self._wait(record, record.sim_step)
        self._apply(name, partial(apply, self.worlds, record))
        if isinstance(record, Mutation):
            self._scene.removed.update(record.effect.removed)
        return found + self._look(record, record.sim_step)

    def _apply(self, name: str, change: Callable[[], None]) -> None:
        """Change a world, and measure the velocities of driven and carried bodies, whose recorded velocities are 0."""
        measured = {body: body.velocity for body in self._measured}
        for body, recorded in self._measured.items():
            body.velocity = recorded
        self._measured.clear()
        world = self.worlds.get(name)
        before, began = {}, 0
        if world is not None:
            began = world.sim_step
            names = {each.body for each in world.attachments.values()}
            names.update(each.begin.body for each in world.following.values())
            moved = [world.bodies[each] for each in names if each in world.bodies]
            before = {body: (body.position, body.orientation) for body in moved}
        change()
        world = self.worlds.get(name)
        seconds = 0.0 if world is None else (world.sim_step - began) / STEPS_PER_SECOND
        for body, (position, orientation) in before.items():
            if seconds > 0:
                turn = geometry.rotation_vector(geometry.product(body.orientation, geometry.conjugate(orientation)))
                way = (now - then for now, then in zip(body.position, position, strict=True))
                velocity = tuple(part / seconds for part in (*way, *turn))
            elif world is not None and world.following and body in measured:  # another change during a motion
                velocity = measured[body]
            else:
                continue
            self._measured[body], body.velocity = body.velocity, velocity

    def finish(self) -> list[Violation]:
        """End the run; return the violations that weren't known before the end."""
        return [violation for watch in self._watches for violation in watch.finish(self._last)]

    def verdicts(self) -> list[PropertyVerdict]:
        """Return the results of all properties after the run; raise BadProperty if a property never had a value."""
        return [watch.verdict(self._known) for watch in self._watches]

    def _moment(self, record: Record, sim_step: int) -> CheckedMoment:
        name = record.world
        if name in self.worlds:
            self._total += max(0, sim_step - self._clocks.get(name, 0 if sim_step == 0 else sim_step))
            self._clocks[name] = sim_step
        self._last = CheckedMoment(
            record.seq, sim_step, self._total / STEPS_PER_SECOND, name, record.task, sim_step != record.sim_step
        )
        return self._last

    def _wait(self, record: Record, sim_step: int) -> list[Violation]:
        """Examine the moments before a change at which the unchanged state decides properties."""
        clock = self._clocks.get(record.world, sim_step)
        ahead = {
            math.ceil(due * STEPS_PER_SECOND - 1e-6) - self._total for each in self._watches for due in each.dues()
        }
        found: list[Violation] = []
        for steps in sorted(each for each in ahead if 0 <= each < sim_step - clock):
            moment = self._moment(record, clock + steps)
            found += [violation for watch in self._watches for violation in watch.look(moment, waiting=True)]
        return found

    def _look(self, record: Record, sim_step: int) -> list[Violation]:
        moment = self._moment(record, sim_step)
        return [violation for watch in self._watches for violation in watch.look(moment)]

    def _task(self, record: Task) -> list[Violation]:
        path = self._names.get(record.task)
        if record.phase == Task.STARTED:
            path = self._names[record.task] = (*self._names.get(record.parent, ()), record.name.casefold())
            self._known[record.name] = None
        elif record.phase in _ENDS:
            self._names.pop(record.task, None)
        if path is None or record.phase not in (Task.STARTED, *_ENDS):
            return []
        moment = CheckedMoment(record.seq, record.sim_step, self._total / STEPS_PER_SECOND, record.world, record.task)
        started = record.phase == Task.STARTED
        return [
            violation
            for watch in self._watches
            if watch.has_tasks
            for violation in watch.task(record.task, path, moment, started=started)
        ]


@dataclass(slots=True)
class _Episode:
    begun: CheckedMoment
    key: object = None  # number of the task that began the episode; None if no task did
    margin: Truth = _BEST
    closest: CheckedMoment | None = None
    values: dict[str, Any] = field(default_factory=dict)
    bad: bool = False
    held: Truth = _BEST  # for "until": smallest margin of the body so far
    done: bool = False  # for "until" and "eventually": whether the condition has held
    past: deque[tuple[float, Truth]] = field(default_factory=deque)  # for "stays": the end of a period, and its value
    latest: Truth | None = None


class _Watch:
    """The state of a property."""

    def __init__(self, watched: Property, scene: Scene) -> None:
        self._property = watched
        self._scene = scene
        self.has_tasks = any(each.task for each in watched.moments)
        self._episodes: list[_Episode] = []
        self._ended: list[_Episode] = []
        self._were: dict[str, bool] = {}  # whether the expressions of ``during``, ``after`` and ``before`` held
        self._over = False  # for a property without ``after``: whether the moment of ``before`` has passed
        self._violations: list[Violation] = []
        self._missing: NoValue | None = None
        self._known: dict[str, None] = {}
        self._begun = False
        self._valued: CheckedMoment | None = None  # last moment at which the property had a value
        self._since: CheckedMoment | None = None  # for "at end": start of the last period in which the body didn't hold
        self._held = False  # for "at end": whether the body held before this period
        self._seen: tuple[float, dict[str, Any]] | None = None  # for "at end": margin and values in this period

    def dues(self) -> Iterator[float]:
        """Yield the times in s at which the property may be decided although the state doesn't change."""
        watched = self._property
        for episode in self._episodes:
            if watched.within is not None:
                yield episode.begun.time + watched.within
            if watched.stays:
                yield episode.begun.time + watched.stays
                yield from (end + watched.stays for end, _ in episode.past)

    def look(self, moment: CheckedMoment, *, waiting: bool = False) -> Iterator[Violation]:
        """Evaluate the property in the present state. ``waiting`` means that the state continues after the moment."""
        watched = self._property
        if not self._begun:
            self._begun = True
            if watched.during is None and watched.after is None:
                self._begin(moment)
        for word in ("before", "during", "after"):
            moments: Moments | None = getattr(watched, word)
            if moments is not None and moments.expression is not None:
                yield from self._edge(word, moments.expression, moment)
        yield from self._expire(moment, 1e-9)
        if self._episodes or watched.kind == AT_END:
            value = self._truth(watched.body, moment)
            other = self._truth(watched.until, moment) if watched.until is not None else None
            if watched.kind == AT_END and value is not None:
                self._follow_end(moment, value)
            for episode in self._episodes:
                yield from self._follow(episode, moment, value, other)
        if waiting:
            yield from self._expire(moment, -1e-9)

    def _expire(self, moment: CheckedMoment, tolerance: float) -> Iterator[Violation]:
        within = self._property.within
        for episode in list(self._episodes) if within is not None else ():
            if within is not None and moment.time > episode.begun.time + within + tolerance:
                yield from self._end(episode, moment, f"not within {within:g} s")

    def _follow_end(self, moment: CheckedMoment, value: Truth) -> None:
        """Find the start of the last period in which the body doesn't hold; if the body never held, its last change."""
        if value.holds:
            self._since, self._seen, self._held = None, None, True
        elif self._seen is None or (not self._held and self._changed(value.margin, *self._seen)):
            self._since = moment if self._held or self._seen is not None else None  # the first value isn't a change
            self._seen = value.margin, self._values()

    def _changed(self, margin: float, before: float, values: dict[str, Any]) -> bool:
        if math.isfinite(margin) and math.isfinite(before):
            return abs(margin - before) > _SETTLING[self._property.body.unit == "rad"]
        return values != self._values()

    def _edge(self, word: str, expression: PropertyExpression, moment: CheckedMoment) -> Iterator[Violation]:
        value = self._truth(expression)
        before, now = self._were.get(word, False), value is not None and value.holds
        self._were[word] = now
        if now and not before:
            if word == "before":
                yield from self._end_all(moment)
            else:
                self._begin(moment)
        elif before and not now and word == "during":
            yield from self._end_all(moment)

    def task(self, number: int, path: tuple[str, ...], moment: CheckedMoment, *, started: bool) -> Iterator[Violation]:
        """Begin or end episodes at the start or end of a task."""
        watched = self._property
        for word in ("during", "after", "before"):
            moments: Moments | None = getattr(watched, word)
            if moments is None or not moments.task or path[-len(moments.task) :] != moments.task:
                continue
            if word == "before" and started:
                yield from self._end_all(moment)
            elif (word == "during" and started) or (word == "after" and not started):
                self._begin(moment, number if word == "during" else None)
                yield from self.look(moment)
            elif word == "during":
                for episode in [each for each in self._episodes if each.key == number]:
                    yield from self._end(episode, moment)

    def _begin(self, moment: CheckedMoment, key: object = None) -> None:
        if not self._over and not self._were.get("before"):
            until_reached = self._property.kind == EVENTUALLY or self._property.until is not None
            self._episodes.append(_Episode(moment, key, _WORST if until_reached else _BEST))

    def _end_all(self, moment: CheckedMoment) -> Iterator[Violation]:
        self._over = self._property.after is None and self._property.during is None
        for episode in list(self._episodes):
            yield from self._end(episode, moment)

    def finish(self, moment: CheckedMoment) -> Iterator[Violation]:
        """End all episodes at the end of the run."""
        for episode in list(self._episodes):
            yield from self._end(episode, self._valued or moment, NEVER_HELD)

    def _truth(self, expression: PropertyExpression, moment: CheckedMoment | None = None) -> Truth | None:
        try:
            value = expression.truth(self._scene)
        except NoValue as error:
            if self._property.kind == AT_END and error.name in self._scene.removed:
                return _WORST
            if error.name or self._missing is None:
                self._missing = error
            self._known.update(dict.fromkeys(error.known))
            return None
        self._valued = moment or self._valued
        return value

    def _follow(
        self, episode: _Episode, moment: CheckedMoment, value: Truth | None, other: Truth | None = None
    ) -> Iterator[Violation]:
        watched = self._property
        if watched.until is not None:
            yield from self._until(episode, moment, value, other)
            return
        if watched.stays:
            value = self._stayed(episode, moment.time, value)
        if value is None:
            return
        if watched.kind == NEVER:
            value = value.negated()
        if watched.kind in (ALWAYS, NEVER):
            if value < episode.margin or episode.closest is None:
                self._note(episode, moment, value)
            if not value.holds and not episode.bad:
                yield self._violated(moment, value)
            episode.bad = not value.holds
        elif watched.kind == AT_END or value > episode.margin or episode.closest is None:
            self._note(episode, moment, value)
            episode.done |= value.holds

    def _until(
        self, episode: _Episode, moment: CheckedMoment, value: Truth | None, other: Truth | None
    ) -> Iterator[Violation]:
        if episode.done:
            return
        if other is not None and (reached := min(other, episode.held)) >= episode.margin:
            self._note(episode, moment, reached)
            if reached.holds:
                episode.done = True
                return
        if value is not None:
            episode.held = min(episode.held, value)
            if not value.holds:
                episode.done = episode.bad = True
                self._note(episode, moment, value)
                yield self._violated(moment, value)

    def _stayed(self, episode: _Episode, now: float, value: Truth | None) -> Truth | None:
        """Return the smallest margin of the last ``stays`` seconds; None at the start of an episode."""
        length, past = self._property.stays, episode.past
        if episode.latest is not None:
            while past and past[-1][1] >= episode.latest:
                past.pop()
            past.append((now, episode.latest))
        while past and past[0][0] <= now - length + 1e-9 and len(past) > 1:
            past.popleft()
        episode.latest = value if value is not None else episode.latest
        return past[0][1] if past and now - episode.begun.time >= length - 1e-9 else None

    def _note(self, episode: _Episode, moment: CheckedMoment, value: Truth) -> None:
        episode.margin, episode.closest = value, moment
        episode.values = self._values()

    def _values(self) -> dict[str, Any]:
        watched = self._property
        found = watched.body.values(self._scene)
        return found if watched.until is None else found | watched.until.values(self._scene)

    def _violated(self, moment: CheckedMoment, value: Truth) -> Violation:
        self._violations.append(Violation(self._property, moment, value.margin, self._values()))
        return self._violations[-1]

    def _end(self, episode: _Episode, moment: CheckedMoment, cause: str = "") -> Iterator[Violation]:
        self._episodes.remove(episode)
        watched = self._property
        if watched.stays and episode.latest is not None:
            yield from self._follow(episode, moment, episode.latest)
        self._ended.append(episode)
        if watched.kind == EVENTUALLY or watched.until is not None:
            failed = not episode.done and (self._valued is not None or self._missing is None)
        else:
            failed = watched.kind == AT_END and episode.closest is not None and not episode.margin.holds
        if failed and not episode.bad:
            episode.bad = True
            at_end = watched.kind == AT_END and episode.closest is not None
            at, cause = (episode.closest, "at the end") if at_end else (moment, cause)
            since = self._since if at_end else episode.begun
            found = Violation(watched, at or moment, episode.margin.margin, episode.values, cause, since)
            self._violations.append(found)
            yield found

    def verdict(self, tasks: dict[str, None]) -> PropertyVerdict:
        """Return the property's result after the end of the run."""
        watched = self._property
        if self._missing is not None and self._valued is None:
            missing = self._missing
            hint = f"; {suggestion(missing.name, self._known)}" if missing.name and self._known else ""
            raise BadProperty(watched.text, f"{missing}{hint}", watched.source)
        said = [each for each in self._ended if each.closest is not None]
        note = "" if said else f"{' and '.join(each.text for each in watched.moments) or 'the run'} never came"
        task = next((each.task[-1] for each in watched.moments if each.task), "")
        if not said and task and task not in map(str.casefold, tasks):
            note = f"no task is called {task}; {suggestion(task, tasks)}"
            if did_you_mean(task, tasks):
                raise BadProperty(watched.text, note, watched.source)
        if not said:
            return PropertyVerdict(watched, math.inf, None, {}, self._violations, 0, note)
        worst = min(said, key=lambda each: each.margin)
        margin = worst.margin.margin
        return PropertyVerdict(watched, margin, worst.closest, worst.values, self._violations, len(said), note)
