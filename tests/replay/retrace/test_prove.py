"""Causes are tested in forks: true causes are confirmed, wrong causes refuted."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from textwrap import dedent
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Record, Run, Task
from replay.cli.main import main
from replay.errors import ReplayError
from replay.explain.causes.case import Cause
from replay.explain.causes.trials import Trial
from replay.fix.trials import Trials
from replay.retrace.prove import prove
from tests.replay.explain.causes.explaining import START, WITH_PR2
from tests.replay.restore.test_verify import rewritten
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.explain.causes.case import FailureCase

#: A table before the robot, and a milk on it.
TABLE = (
    dedent(WITH_PR2)
    + """
Object("kitchen", "environment", "kitchen.urdf")
robot.set_position([0.65, 0.9, 0])
milk.set_position([1.35, 0.9, 0.96])
world.settle()
"""
)
#: By name: the plan, the kind of the first cause, and its verdict.
PLANS = {
    "the object was moved away": (
        TABLE + 'milk.set_position([1.35, 2.4, 0.96])\nperform(type="pick-up", object=milk, arm="left")\n',
        ("out-of-reach", "confirmed"),
    ),
    "an obstacle was put there": (
        TABLE
        + 'perform(type="pick-up", object=milk, arm="left")\npot = Object("pot", "pot", "pot.stl", [6, 0, 0.1])\n'
        + 'pot.set_position([1.35, 1.1, 0.95])\nperform(type="place", object=milk, target=[1.35, 1.1, 0.96], arm="left")\n',
        ("in-the-way", "confirmed"),
    ),
    "a failure was swallowed": (
        TABLE
        + 'robot.set_position([-1, 0, 0])\ntry:\n    perform(type="pick-up", object=milk, arm="left")\n'
        + "except PlanFailure:\n    pass\nrobot.set_position([0.65, 0.9, 0])\n"
        + 'perform(type="place", object=milk, target=[1.4, 0.7, 0.96], arm="left")\n',
        ("swallowed-failure", "confirmed"),
    ),
    "the object was removed": (
        TABLE + 'milk.remove()\nperform(type="pick-up", object=milk, arm="left")\n',
        ("removed", "confirmed"),
    ),
    "the answer was no": (
        'milk = Object("milk", "milk", "milk.stl", [0, 0, 0.4])\nif not btr.stable(milk):\n    raise PlanFailure("it falls")\n',
        ("raised", "confirmed"),
    ),
    "the wait was too short": (
        """\
milk = Object("milk", "milk", "milk.stl")
with timeout(0.5, simulated=True):
    world.simulate(0.3)
    world.simulate(0.3)
    milk.set_position([0, 0, 1])
""",
        ("timeout", "confirmed"),
    ),
    "the support was moved": (
        TABLE
        + 'box = Object("box", "cereal", "breakfast_cereal.stl", [1.35, 0.6, 0.98])\nworld.settle()\n'
        + "cup = Object('cup', 'cup', 'cup.stl', [1.35, 0.6, 1.17])\nworld.settle()\n"
        + 'box.set_position([1.35, 1.3, 0.98])\nworld.simulate(0.1)\nperform(type="pick-up", object=cup, arm="right")\n',
        ("physics", "confirmed"),
    ),
    "the drawer was closed": (
        TABLE
        + 'spoon = Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])\nworld.settle()\n'
        + 'perform(type="pick-up", object=spoon, arm="right")\n',
        ("closed", "confirmed"),
    ),
    "the object isn't where the plan's table wants it": (
        """\
GOALS = {"cup": [1, 0, 0.05]}
cup = Object("cup", "cup", "cup.stl", [3, 0, 0.05])
cup.set_position([4, 0, 0.05])
x = cup.get_position()[0]
print(x)
assert 0.9 < x < 1.1, "it is somewhere else"
""",
        ("written", "confirmed"),
    ),
    "the drawer is hardly open": (
        TABLE
        + 'spoon = Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])\nworld.settle()\nrobot.set_position([0.4, 0.7, 0])\n'
        + 'joint = "sink_area_left_upper_drawer_main_joint"\nworld.get_object("kitchen").set_joint_position(joint, 0.035)\n'
        + 'perform(type="looking", object=spoon)\nperform(type="detecting", object_type="spoon")\n',
        ("in-the-way", "confirmed"),
    ),
    "the wait ended immediately": (
        """\
done = Fluent(False, "done")
milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
def work():
    world.simulate(0.1)
    milk.set_position([2, 0, 0.1])
    done.set_value(True)
def check():
    done.wait_for()
    assert milk.get_position()[0] > 1
with par as both:
    both(work)
    both(check)
""",
        ("ended-wait", "confirmed"),
    ),
    "there is no support": (
        TABLE
        + 'perform(type="pick-up", object=milk, arm="left")\nrobot.set_position([0.5, 0.9, 0])\n'
        + 'perform(type="place", object=milk, target=[1.0, 0.9, 0.96], arm="left")\n',
        ("no-candidate", "confirmed"),
    ),
    "the object isn't in the picture": (
        TABLE + 'robot.set_orientation([0, 0, 1, 0])\nperform(type="detecting", object_type="milk")\n',
        ("no-candidate", "confirmed"),
    ),
    "the plan has a mistake": ("milk = None\nmilk.set_position([0, 0, 1])\n", ("raised", "code")),
}


def recorded(folder: Path, plan: str) -> Path:
    file = folder / "plan.py"
    file.write_text(dedent(START) + plan)
    return record(file)


@pytest.mark.costly
@pytest.mark.parametrize(
    "name", [name if at % 3 == 0 else pytest.param(name, marks=pytest.mark.long) for at, name in enumerate(PLANS)]
)
def test_the_true_cause_is_confirmed(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    plan, expected = PLANS[name]
    log = recorded(tmp_path, plan)
    assert main(["why", str(log), "--prove", "--json", "--keep", str(tmp_path / "forks")]) == 0
    first, *_ = json.loads(capsys.readouterr().out)["causes"]
    assert (first["kind"], first["proof"]["verdict"]) == expected, first
    kept = {str(file) for file in (tmp_path / "forks").iterdir()}
    assert {fork["file"] for fork in first["proof"]["forks"]} <= kept


@dataclass(frozen=True, slots=True)
class Claim(Cause):
    """A cause that a test makes up."""

    kind = "claim"
    trial: Trial

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial."""
        yield self.trial

    def _words(self) -> Iterator[str]:
        yield "a claim"


@pytest.mark.slow
def test_claims_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(
        tmp_path,
        'milk, cup = (Object(each, each, f"{each}.stl", [x, 0, 0.1]) for x, each in enumerate(("milk", "cup")))\n'
        "cup.set_position([5, 0, 1])\nmilk.set_position([0, 0, 1])\nif milk.get_position()[2] > 0.5:\n"
        '    raise PlanFailure(f"milk is at {milk.get_position()}")\nworld.settle()\nraise PlanFailure("later")\n',
    )
    with replay.open(log) as recording:
        why = recording.why()
        last = why.step - 1  # the milk is moved there
        set_ = [
            Trial(last - 1, "the cup is back", ("cup.position=1,0,0.1",)),  # it has nothing to do with it
            Trial(last, "the milk is back", ("milk.position=0,0,0.1",)),
            Trial(last, "no such thing", ("mlik.position=0,0,0.1",)),
        ]
        claims = replace(why, causes=tuple(Claim((each.step,), each) for each in set_))
        proven, control = prove(recording, claims, keep=tmp_path / "kept")
        assert control.identical
        found = {cause.trial.words: proof.verdict for cause, proof in zip(proven.causes, proven.proofs, strict=True)}
        assert found == {
            "the milk is back": "confirmed",
            "no such thing": "untested",
            "the cup is back": "refuted",
        }
        assert [*found][:: len(found) - 1] == ["the milk is back", "the cup is back"]
        assert "later" in proven.proofs[0].text
    with replay.open(proven.proofs[-1].forks[0].file) as refuted:
        cause = refuted.why().causes[0]
        assert (cause.kind, "by the fork, not by the plan" in next(cause.lines())) == ("fork", True)


@pytest.mark.slow
def test_a_check_that_still_fails_with_another_number_confirms_nothing(tmp_path: Path) -> None:
    log = recorded(
        tmp_path,
        'milk, cup = (Object(each, each, f"{each}.stl", [x, 0, 0.8]) for x, each in enumerate(("milk", "cup")))\n'
        'for each in (milk, cup):\n    assert each.get_position()[2] < 0.5, f"{each.name} is at {each.get_position()}"\n',
    )
    with replay.open(log) as recording:
        why = recording.why()
        texts = {0.7: "the check still fails", 0.1: "the check passes, and another check fails later"}
        claims = [
            Claim((why.step,), Trial(why.step - 2, "", (f"milk.position=0,0,{height}",), compares=True))
            for height in texts
        ]
        proven, _ = prove(recording, replace(why, causes=tuple(claims)))
        ends = {proof.forks[0].trial.settings[0][-3:]: proof for proof in proven.proofs}
    assert {height: proof.verdict for height, proof in ends.items()} == {"0.7": "untested", "0.1": "confirmed"}
    assert all(text in ends[f"{height}"].text for height, text in texts.items())


@pytest.mark.slow
def test_a_fork_that_fails_before_a_check_or_in_more_than_before_confirms_nothing(tmp_path: Path) -> None:
    log = recorded(
        tmp_path,
        'milk, cup = (Object(each, each, f"{each}.stl", [x, 0, 0.8]) for x, each in enumerate(("milk", "cup")))\n'
        "for _ in range(3):\n    world.simulate(0.01)\n"
        "if cup.get_position()[0] < -5:\n    for _ in range(9):\n        world.simulate(0.01)\n    milk.turn()\n"
        "missing = [each.name for each in (milk, cup) if each.get_position()[0] < 0.5]\nassert not missing, missing\n",
    )
    with replay.open(log) as recording:
        why = recording.why()
        texts = {"cup.position=0,0,0.8": "the check still fails", "cup.position=-9,0,0.8": "happens before the check"}
        claims = [Claim((why.step,), Trial(why.step - 2, "", (place,), compares=True)) for place in texts]
        proven, _ = prove(recording, replace(why, causes=tuple(claims)))
    assert {proof.verdict for proof in proven.proofs} == {"untested"}
    for proof in proven.proofs:
        assert texts[proof.forks[0].trial.settings[0]] in proof.text


@pytest.mark.costly
def test_a_mixed_up_hand_is_confirmed_though_it_holds_something_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = recorded(
        tmp_path,
        TABLE
        + 'cup = Object("cup", "cup", "cup.stl", [1.35, 0.6, 0.92])\nworld.settle()\n'
        + 'perform(type="pick-up", object=milk, arm="left")\nperform(type="pick-up", object=cup, arm="right")\n'
        + 'perform(type="place", object=cup, target=[1.4, 0.6, 0.92], arm="left")\n',
    )
    with replay.open(log) as recording:
        proven, _ = prove(recording, recording.why())
    assert [(cause.kind, proof.verdict) for cause, proof in zip(proven.causes, proven.proofs, strict=True)] == [
        ("hand-state", "confirmed"),
        ("hand-state", "refuted"),
    ]
    capsys.readouterr()
    assert (
        main(["fork", str(log), "--at", str(proven.step - 2), "--set", "cup.hand=left", "-o", str(tmp_path / "f")]) == 2
    )
    assert "the hand holds milk; before it, set milk.hand=none" in capsys.readouterr().err


@pytest.mark.costly
def test_without_a_control_that_repeats_the_recording_nothing_is_proven(tmp_path: Path) -> None:
    log = recorded(
        tmp_path,
        'import time\nmilk = Object("milk", "milk", "milk.stl", [0, 0, 0.4])\nmilk.set_position([0, 0, 0.3 + time.time() % 0.1])\n'
        'if not btr.stable(milk):\n    raise PlanFailure("it falls")\n',
    )
    with replay.open(log) as recording:
        proven, control = prove(recording, recording.why())
        assert not control.identical
        assert {each.verdict for each in proven.proofs} == {"untested"}
        assert "doesn't repeat its recording" in proven.proofs[0].text


@pytest.mark.costly
def test_reworded_failures_of_another_version_are_the_same(tmp_path: Path) -> None:
    log = recorded(
        tmp_path,
        'milk = Object("milk", "milk", "milk.stl", [0, 0, 0.4])\nmilk.set_position([0, 0, 1])\n'
        "with timeout(0.1, simulated=True):\n    world.simulate(0.3)\n",
    )
    verdicts = {}
    for version in ("", "another version"):

        def reworded(record: Record, version: str = version) -> Record:
            if isinstance(record, Run | Task) and record.HasField("failure"):
                record.failure.message = "as it was worded before"
            if isinstance(record, Run) and version:
                record.pycram.sha256 = version
            return record

        with replay.open(rewritten(log, tmp_path / f"reworded{version}.mcap", reworded)) as recording:
            proven, control = prove(recording, recording.why())
            verdicts[version] = control.identical, {each.verdict for each in proven.proofs}
        with replay.open(recording.path) as recording, Trials(recording) as trials:
            if version:
                assert trials.control().kind == "failed"
            else:
                with pytest.raises(ReplayError, match="doesn't end as recorded"):
                    trials.control()
    assert verdicts == {"": (False, {"untested"}), "another version": (True, {"confirmed"})}
