"""The benchmark of explanations: its plans work, each fault is one edit at a known line, and a seed makes the same case again."""

from __future__ import annotations

import ast
import difflib
from pathlib import Path

import pytest

import replay
from tests.faults import benchmark
from tests.faults.kinds import KINDS, faults

SOURCES = sorted(benchmark.PLANS.glob("*.py"))


@pytest.mark.costly
@pytest.mark.parametrize(
    "source",
    SOURCES[:1] + [pytest.param(each, marks=pytest.mark.long) for each in SOURCES[1:]],
    ids=lambda each: each.stem,
)
def test_plans_work_without_a_fault(source: Path, tmp_path: Path) -> None:
    plan = tmp_path / source.name
    plan.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    benchmark.run(plan, plan.with_suffix(".mcap"))
    holds = benchmark.properties(plan)
    assert holds
    with replay.open(plan.with_suffix(".mcap")) as log:
        assert not benchmark.is_wrong(log, holds), [str(each) for each in log.check(*holds)]


def test_each_fault_is_one_edit_at_its_line() -> None:
    kinds = set()
    for source in SOURCES:
        text = source.read_text(encoding="utf-8")
        for fault in faults(text):
            ast.parse(fault.source)
            edited = fault.source.splitlines()
            matcher = difflib.SequenceMatcher(None, text.splitlines(), edited, autojunk=False)
            changed = [
                line
                for tag, _, _, low, high in matcher.get_opcodes()
                if tag != "equal"
                for line in range(low, high + 1)
            ]
            assert fault.line - 1 in changed, (source.name, fault.kind, fault.line)
            kinds.add(fault.kind)
    assert kinds == set(KINDS)


@pytest.mark.long
def test_a_seed_makes_the_same_case_again(tmp_path: Path) -> None:
    one, other = (benchmark.make_case(5, tmp_path / name) for name in ("one", "other"))
    assert (one.plan, one.kind, one.line, one.step) == (other.plan, other.kind, other.line, other.step)
    assert one.file.read_text(encoding="utf-8") == other.file.read_text(encoding="utf-8")
    assert (tmp_path / "one" / "truth.json").read_bytes() == (tmp_path / "other" / "truth.json").read_bytes()


def test_the_rank_of_the_truth_counts_guesses_of_its_kind() -> None:
    case = benchmark.Case(0, "stack", "unit", 12, -1, continuous=False, recording=Path("stack.mcap"))
    assert benchmark.rank(case, [("step", 12), ("line", 7), ("line", 12)]) == 2
    assert benchmark.rank(case, [("step", 12)]) == 0
    world = benchmark.Case(0, "stack", "slip", 0, 30, continuous=False, recording=Path("stack.mcap"))
    assert benchmark.rank(world, [("line", 30), ("step", 30)]) == 1
