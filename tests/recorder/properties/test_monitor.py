"""Properties over time: verdicts, margins, moments; margins are those of signal temporal logic, as RTAMT computes them."""

from __future__ import annotations

import math
import random
import sys
import warnings
from typing import TYPE_CHECKING

import pytest

from recorder.properties import BadProperty, Monitor, PropertyVerdict, parse
from recorder.records import (
    STEPS_PER_SECOND,
    Attachment,
    BodyState,
    CloseWorld,
    Effect,
    Keyframe,
    LoadBody,
    Mutation,
    Sample,
    Simulate,
    Task,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Record

SECOND = STEPS_PER_SECOND


def at(**heights: float) -> Effect:
    return Effect(bodies=[_state(name, z) for name, z in heights.items()])


def _state(name: str, z: float) -> BodyState:
    return BodyState(body=name, position=(0, 0, z), orientation=(0, 0, 0, 1))


def changes(rows: Sequence[dict[str, float]], seconds: Sequence[float] | None = None) -> list[Record]:
    """Return the records of a world in which bodies have these heights, by default for a second each."""
    times = range(len(rows)) if seconds is None else seconds
    frame = Keyframe(loaded=[LoadBody(body=name) for name in rows[0]], bodies=at(**rows[0]).bodies)
    moves = [
        Mutation(simulate=Simulate(), effect=at(**row), sim_step=round(time * SECOND))
        for row, time in zip(rows[1:], list(times)[1:], strict=True)
    ]
    return [task(Task.ASKED, 9, "run"), frame, *moves]


def task(phase: Task.Phase, number: int, name: str, parent: int = 0) -> Task:
    return Task(phase=phase, task=number, parent=parent, name=name)


def check(text: str, records: Sequence[Record]) -> PropertyVerdict:
    monitor = Monitor([parse(text)])
    for seq, record in enumerate(records):
        record.seq, record.world = seq, record.world or "lab"
        monitor.feed(record)
    monitor.finish()
    (verdict,) = monitor.verdicts()
    return verdict


def steps(verdict: PropertyVerdict) -> list[int]:
    return [each.moment.step for each in verdict.violations]


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="RTAMT has no release for this Python")
@pytest.mark.needs("RTAMT")
@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("always x.z > 1", "always(x - 1 > 0)"),
        ("never x.z > 1", "always(not(x - 1 > 0))"),
        ("eventually x.z > 1", "eventually(x - 1 > 0)"),
        ("eventually x.z > 1 within 2 s", "eventually[0:2](x - 1 > 0)"),
        ("always x.z > y.z within 3 s", "always[0:3](x - y > 0)"),
        ("x.z > 1 until y.z > 1", "(x - 1 > 0) until (y - 1 > 0)"),
        ("x.z > 1 until y.z > 1 within 3 s", "(x - 1 > 0) until[0:3] (y - 1 > 0)"),
        ("always (x.z > 1 or y.z < 1)", "always((x - 1 > 0) or (1 - y > 0))"),
        ("always abs(x.z - y.z) < 2 and not x.z < 0", "always((2 - abs(x - y) > 0) and not(x < 0))"),
    ],
)
def test_margins_are_those_of_signal_temporal_logic(ours: str, theirs: str) -> None:
    with warnings.catch_warnings(action="ignore"):  # its parser imports what Python 3.13 lacks
        import rtamt  # noqa: PLC0415  only this test needs it

    dice = random.Random(ours)
    for _ in range(20):
        rows = [{"x": dice.uniform(-1, 3), "y": dice.uniform(-1, 3)} for _ in range(dice.randrange(2, 9))]
        spec = rtamt.StlDiscreteTimeSpecification()
        spec.declare_var("x", "float")
        spec.declare_var("y", "float")
        spec.spec = theirs
        spec.parse()
        signals = {name: [row[name] for row in rows] for name in ("x", "y")}
        expected = spec.evaluate({"time": list(range(len(rows))), **signals})[0][1]
        verdict = check(ours, changes(rows))
        assert verdict.holds == (expected > 0)
        if " until " not in ours:  # "until" is decided, and ends, where the first expression doesn't hold any more
            assert verdict.margin == pytest.approx(expected)


ROWS = [{"x": z} for z in (0.0, 2.0, 3.0, 0.5, 2.0, 4.0)]  # steps 1 to 6


@pytest.mark.parametrize(
    ("text", "violated", "margin"),
    [
        ("x.z >= 0", [], 0.0),
        ("always x.z > 1", [1, 4], -1.0),  # again only after it held
        ("never x.z > 1", [2, 5], -3.0),
        ("eventually x.z > 4", [6], 0.0),
        ("eventually x.z >= 4", [], 0.0),
        ("at end x.z > 3", [], 1.0),
        ("at end x.z < 3", [6], -1.0),
        ("eventually x.z > 1 stays 2 s", [], 1.0),
        ("eventually x.z > 1 stays 2.5 s", [6], -0.5),
        ("never x.z > 1 stays 2 s", [4], -1.0),  # held for 2 s when it ended
        ("x.z < 1 until x.z > 1", [], 1.0),
        ("x.z < 1 until x.z > 2.5", [2], -1.0),
        ("always x.z > 1 after x.z > 2.5", [4], -0.5),
        ("eventually x.z < 1 within 1 s after x.z > 2.5", [6], -3.0),  # after each time
        ("eventually x.z < 1 within 1 s after x.z > 2.5 before x.z > 3.5", [], 0.5),
        ("always x.z < 3 before x.z > 3.5", [3], 0.0),
        ("always x.z < 3.5 before x.z > 3.5", [], 0.5),
        ("always x.z > 1.5 during x.z > 1", [], 0.5),
        ("eventually x.z > 3.5 during x.z > 1", [4], -0.5),  # the first of two parts
        ("at end x.z > 2.5 during x.z > 1", [], 0.5),
    ],
)
def test_words_about_time(text: str, violated: list[int], margin: float) -> None:
    verdict = check(text, changes(ROWS))
    assert (steps(verdict), verdict.margin) == (violated, pytest.approx(margin))


def test_samples_within_a_simulation_count_with_their_times() -> None:
    dipping = Mutation(simulate=Simulate(steps=SECOND), sim_step=SECOND, effect=at(x=1.0))
    for sim_step, z in ((80, 0.4), (160, 1.2)):
        dipping.effect.samples.append(Sample(sim_step=sim_step, bodies=[_state("x", z)]))
    verdict = check("always x.z > 0.5", [*changes([{"x": 1.0}]), dipping])
    (violation,) = verdict.violations
    assert (violation.moment.step, violation.moment.sim_step, violation.moment.sampled) == (2, 80, True)
    assert violation.values == {"x.z": 0.4}
    assert violation.margin == pytest.approx(-0.1)


def test_a_value_that_stays_between_two_records_counts_as_long_as_it_stays() -> None:
    rows = [{"x": 0.0}, {"x": 2.0}, {"x": 0.0}]
    assert check("eventually x.z > 1 stays 3 s", changes(rows, [0, 1, 4])).holds
    assert not check("eventually x.z > 1 stays 3.1 s", changes(rows, [0, 1, 4])).holds


def test_properties_of_tasks_are_about_each_execution() -> None:
    started, finished = Task.STARTED, Task.FINISHED
    first, low, high, last = changes([{"x": z} for z in (1.0, 0.0, 2.0, 0.2)])[-4:]
    records = [
        *changes([{"x": 1.0}])[:1],
        first,
        task(started, 1, "Tidy"),
        task(started, 2, "place", 1),
        low,  # step 4
        task(finished, 2, "place"),
        high,
        task(started, 3, "place"),
        last,  # step 8
        task(finished, 3, "place"),
        task(finished, 1, "tidy"),
    ]
    assert steps(check("always x.z > 0.5 during task:place", records)) == [4, 8]
    assert steps(check("always x.z > 0.5 during task:tidy/place", records)) == [4]
    assert steps(check("at end x.z > 0.1 during task:place", records)) == [4]
    assert steps(check("always x.z > 0.5 before task:place", records)) == []
    assert steps(check("always x.z < 1 after task:tidy/place", records)) == [6]
    with pytest.raises(BadProperty, match=r"no task is called plce; did you mean place\?"):
        check("always x.z > 0.5 during task:plce", records)
    nothing = check("always x.z > 0.5 during task:wiping", records)
    assert nothing.holds
    assert nothing.note.startswith("no task is called wiping; there are ")


def test_the_end_is_the_last_step_at_which_the_world_is_open() -> None:
    records = [*changes([{"x": 1.0}, {"x": 2.0}]), Mutation(close_world=CloseWorld())]
    verdict = check("at end x.z < 1", records)
    assert steps(verdict) == [2]
    assert steps(check("eventually x.z < 1", records)) == [2]


def test_a_name_that_never_existed_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(BadProperty, match=r"no object is called mlk; did you mean milk\?"):
        check("always mlk.z > 1", changes([{"milk": 1.0}]))
    assert check("always milk.z > 0", changes([{"milk": 1.0}])).margin == 1.0


@pytest.mark.parametrize(
    ("text", "since"),
    [
        ("at end x.z < 1", 5),  # since it turned false for the last time; the change of step 6 doesn't count
        ("at end x.z < 3", 6),
        ("at end x.z > 5", 6),  # it never held: the last change
        ("at end y.z > 5", 3),  # step 6 moves y by 4 mm, as an object that settles
        ("at end max(x.z, y.z) < 1 after y.z > 2", 5),  # also before the end of the period
    ],
)
def test_a_violation_at_the_end_names_the_start_of_the_last_period(text: str, since: int) -> None:
    heights = (1.0, 1.0, 3.0, 3.0, 3.0, 3.004)
    if "max" in text:
        heights = (0.0, 0.0, 2.5, 0.0, 0.0, 0.0)
    rows = [row | {"y": y} for row, y in zip(ROWS, heights, strict=True)]
    (violation,) = check(text, changes(rows)).violations
    assert violation.moment.step == 6
    assert violation.since is not None
    assert violation.since.step == since


def test_an_unchanged_value_blames_no_step() -> None:
    (violation,) = check("at end y.z > 5", changes([row | {"y": 1.0} for row in ROWS])).violations
    assert violation.since is None


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("never x.z > 1 stays 500 ms", 1.5),
        ("eventually x.z > 5 within 1.25 s", 1.25),
        ("eventually x.z < 1 within 2 s after x.z > 1", 3.0),
        ("eventually x.z > 1 stays 1 s within 2 s", None),
    ],
)
def test_properties_are_decided_between_the_samples_of_a_still_scene(text: str, seconds: float | None) -> None:
    verdict = check(text, changes([{"x": 0.0}, {"x": 2.0}, {"x": 0.0}], [0, 1, 10]))
    assert [(each.moment.step, each.moment.seconds) for each in verdict.violations] == [(3, seconds)] * bool(seconds)


def test_a_property_of_names_has_no_margin() -> None:
    verdict = check("always x.carrier is None", changes(ROWS))
    assert (verdict.holds, verdict.margin) == (True, math.inf)


def test_the_speed_of_a_carried_body_is_measured() -> None:
    """In a simulation, it is set from pose to pose, so its recorded velocity is 0. Instantaneous changes have no speed."""
    held, *moves = changes([{"x": 0.0, "arm": 0.0}, {"x": 0.5}, {"x": 0.5}, {"x": 2.5}], (0, 1, 2, 2))[1:]
    assert isinstance(held, Keyframe)
    held.attachments.append(Attachment(carrier="arm", body="x", position=(0, 0, 0), orientation=(0, 0, 0, 1)))
    verdict = check("always x.speed < 0.3 m/s", [held, *moves])
    assert (steps(verdict), verdict.margin) == ([1], pytest.approx(-0.2))


def test_a_removed_body_ends_the_conditions_about_it() -> None:
    records = [*changes(ROWS[:2]), Mutation(effect=Effect(removed=["x"]), sim_step=SECOND)]
    verdict = check("at end x.z > 1", records)
    assert [each.since.step for each in verdict.violations if each.since] == [3]
    assert check("always x.z > -1", records).holds
