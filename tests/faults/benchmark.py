"""A benchmark of explanations: plans that work get one fault each, run, and are explained; the fault is known.

Each case is made by its seed alone. Its folder has the plan with the fault, the recording, and ``truth.json`` with the kind,
the line of the fix, and for faults of the world the step. ``make faults`` prints the table; see docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import resource
import statistics
import subprocess
import sys
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import replay
from recorder.records import Mutation, Task, argument_values
from replay.history.tasks import uncaught_failure
from tests.faults.kinds import faults

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from replay.recording import Recording

PLANS: Final = Path(__file__).parent / "plans"
SEED: Final = "1"  # of all runs
LIMIT: Final = 300  # s for a run
TRIES: Final = 60  # faults that change nothing are drawn again
SHOWN: Final = 20  # lines of an explanation that a user reads
WORLD_KINDS: Final = ("moved-object", "blocked-place", "slip", "shut")
CONTINUOUS: Final = ("row", "sorting")  # plans that are short enough in simulated time
_HOLDS: Final = re.compile(r"^# holds: (.*)$", re.MULTILINE)


class Score(NamedTuple):
    """How well a case is explained."""

    ranks: dict[str, int]  # of the truth, by method
    costs: dict[str, float]  # CPU time in s, by method
    verdicts: Counter[str]


@dataclass(frozen=True, slots=True)
class Case:
    """A recording of a run with one known fault."""

    seed: int
    plan: str  # name of the plan
    kind: str
    line: int  # of the plan, where the fix goes; 0 for a fault of the world
    step: int  # at which the world was changed; -1 for a fault of the plan
    continuous: bool
    recording: Path

    @property
    def file(self) -> Path:
        """The plan that was run."""
        return self.recording.with_suffix(".py")


def properties(plan: Path) -> list[str]:
    """Return what must hold of a plan."""
    return _HOLDS.findall(plan.read_text(encoding="utf-8"))


def run(plan: Path, log: Path, *options: str) -> None:
    """Record a plan; whether it succeeds is on record."""
    command = [
        sys.executable,
        "-m",
        "pycram",
        "run",
        plan.name,
        "--log",
        log.name,
        "--overwrite",
        "--seed",
        SEED,
        *options,
    ]
    subprocess.run(command, cwd=plan.parent, capture_output=True, check=False, timeout=LIMIT)


def is_wrong(log: Recording, holds: Sequence[str]) -> bool:
    """Return whether a run failed, or violated a property."""
    return uncaught_failure(log) is not None or not all(map(bool, log.check(*holds)))


def make_case(seed: int, folder: Path) -> Case:
    """Make a case; faults without effect are drawn again."""
    folder.mkdir(parents=True, exist_ok=True)
    draw = random.Random(seed)
    for _ in range(TRIES):
        source = draw.choice(sorted(PLANS.glob("*.py")))
        continuous = source.stem in CONTINUOUS and draw.random() < 0.5
        plan = folder / source.name
        log = plan.with_suffix(".mcap")
        options = ["--motion", "continuous"] if continuous else []
        text = source.read_text(encoding="utf-8")
        if draw.random() < 0.2:
            plan.write_text(text, encoding="utf-8")
            made = _of_world(draw, plan, log, options)
        else:
            made = _of_plan(draw, plan, log, text, options)
        if made is not None:
            case = Case(seed, source.stem, *made, continuous, log)
            truth = {**asdict(case), "recording": log.name}
            (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
            return case
    raise AssertionError(f"seed {seed}: no fault had an effect")


def _of_plan(draw: random.Random, plan: Path, log: Path, text: str, options: list[str]) -> tuple[str, int, int] | None:
    found = faults(text)
    kind = draw.choice(sorted({each.kind for each in found}))
    fault = draw.choice([each for each in found if each.kind == kind])
    plan.write_text(fault.source, encoding="utf-8")
    try:
        run(plan, log, *options)
    except subprocess.TimeoutExpired:
        return None
    with replay.open(log) as recorded:
        return (kind, fault.line, -1) if is_wrong(recorded, properties(plan)) else None


def _of_world(draw: random.Random, plan: Path, log: Path, options: list[str]) -> tuple[str, int, int] | None:
    good = log.with_name("good.mcap")
    run(plan, good, *options)
    kind = draw.choice(WORLD_KINDS)
    with replay.open(good) as recorded:
        change = _change(draw, recorded, kind)
    if change is None:
        return None
    step, setting = change
    command = [sys.executable, "-m", "replay", "fork", good.name, "--at", str(step), "--set", setting, "-o", log.name]
    done = subprocess.run(command, cwd=plan.parent, capture_output=True, check=False, timeout=LIMIT)
    if done.returncode > 1 or not log.is_file():
        return None
    with replay.open(log) as recorded:
        return (kind, 0, step + 1) if is_wrong(recorded, properties(plan)) else None


def _change(draw: random.Random, log: Recording, kind: str) -> tuple[int, str] | None:
    """Return a change of the world by a stranger, and the step after which it comes; None if the run has no moment for it."""
    tasks = [each for each in log.records(Task) if each.phase == Task.STARTED]
    picks = [each for each in tasks if each.name == "pick-up"]
    places = [each for each in tasks if each.name == "place"]
    if kind == "shut":
        opened = [
            each
            for each in log.records(Mutation)
            if each.HasField("move_joints") and each.move_joints.body == "kitchen"
        ]
        moves = [
            (each.seq, joint)
            for each in opened
            for joint, value in zip(each.move_joints.joints, each.move_joints.positions, strict=True)
            if value > 0.1
        ]
        return (moves[-1][0], f"kitchen.{moves[-1][1]}=0") if moves else None
    if not picks or not places:
        return None
    before = draw.choice(places if kind != "moved-object" else picks)
    name = argument_values(before.parameters).get("object")
    name = name["object"] if isinstance(name, dict) else name
    step = before.seq - 1
    world = log.state_at(step).world()
    body = world.body(str(name))
    x, y, z = body.position
    if kind == "blocked-place":
        others = [
            each for each in world.bodies.values() if each.type not in ("robot", "environment") and each.name != name
        ]
        target = argument_values(before.parameters).get("target")
        if not others or not isinstance(target, list):
            return None
        return step, f"{draw.choice(others).name}.position={target[0]},{target[1]},{target[2]}"
    away = 0.1 if kind == "slip" else draw.choice([-0.4, 0.4])
    moved = (x, y, z - away) if kind == "slip" else (x, y + away, z)
    return step, f"{name}.position={','.join(f'{each:.3f}' for each in moved)}"


# --- scores -----------------------------------------------------------------------------------------------------------


def explained(case: Case, *options: str) -> tuple[str, float]:
    """Return the output of ``why``, and its CPU time in s with that of its processes."""
    command = [sys.executable, "-m", "replay", "why", case.recording.name, *options]
    with TemporaryFile("w+", encoding="utf-8") as output:
        asked = subprocess.Popen(command, cwd=case.recording.parent, stdout=output, stderr=subprocess.DEVNULL)
        _, status, used = os.wait4(asked.pid, 0)
        asked.returncode = os.waitstatus_to_exitcode(status)
        assert not asked.returncode, f"seed {case.seed}: why {' '.join(options)} ended with {asked.returncode}"
        output.seek(0)
        return output.read(), used.ru_utime + used.ru_stime


def guesses(case: Case, text: str) -> list[tuple[str, int]]:
    """Return the lines and steps that the first lines of an explanation name, in order, each once."""
    shown = "\n".join(text.splitlines()[:SHOWN])
    found = re.finditer(rf"{re.escape(case.file.name)}:(?P<line>\d+)|steps? (?P<step>\d+)", shown)
    return list(
        dict.fromkeys(("line", int(each["line"])) if each["line"] else ("step", int(each["step"])) for each in found)
    )


def verdicts(case: Case, data: Mapping[str, Any]) -> Counter[str]:
    """Count the verdicts on causes that name the truth, and on others. The former should be confirmed."""
    found: Counter[str] = Counter()
    for cause in data["causes"]:
        text = json.dumps(cause)
        named = [*guesses(case, text), *(("step", step) for step in cause.get("steps", []))]
        lines = re.finditer(rf'{re.escape(case.file.name)}", "line": (\d+)', text)
        named += [("line", int(each[1])) for each in lines]
        truth = "the truth" if rank(case, named) else "another"
        found[f"{(cause.get('proof') or {}).get('verdict', 'untested')}, {truth}"] += 1
    return found


def rank(case: Case, named: Sequence[tuple[str, int]]) -> int:
    """Return the place of the truth among guesses of its kind, from 1; 0 if it isn't there."""
    what = "line" if case.line else "step"
    truths = {case.line or case.step}
    if case.kind.startswith("missing"):  # the fix goes between two lines
        truths.add(case.line - 1)
    places = [number for kind, number in named if kind == what]
    return next((place for place, each in enumerate(places, 1) if each in truths), 0)


def baselines(case: Case) -> dict[str, list[tuple[str, int]]]:
    """Return guesses that need no explanation: the line of the exception, that of the last change, and a random one."""
    with replay.open(case.recording) as log:
        failure = uncaught_failure(log)
        frames = [
            each
            for each in (failure.failure.frames if failure is not None else ())
            if each.file.endswith(case.file.name)
        ]
        last = next(
            (each for each in log.backwards(len(log) - 1, Mutation) if each.source_file.endswith(case.file.name)), None
        )
        steps = [each.seq for each in log.records(Mutation)]
    draw = random.Random(case.seed)
    lines = range(1, len(case.file.read_text(encoding="utf-8").splitlines()) + 1)
    return {
        "the exception's line": [("line", frames[-1].line)] if frames else [],
        "the last change": [("line", last.source_line), ("step", last.seq)] if last is not None else [],
        "random": [("line", draw.choice(lines)), ("step", draw.choice(steps))],
    }


def scored(case: Case, *, again: bool) -> Score:
    """Return the rank of the truth by each method; with ``again``, also by those that run the plan again."""
    methods = {"why": (), "why --origins": ("--origins", "--recorded-source")} if again else {"why": ()}
    ranks, costs = {}, {}
    for name, options in methods.items():
        text, costs[name] = explained(case, *options)
        ranks[name] = rank(case, guesses(case, text))
    found: Counter[str] = Counter()
    if again:
        text, costs["why --prove"] = explained(case, "--prove", "--recorded-source", "--json")
        found = verdicts(case, json.loads(text))
    return Score(ranks | {name: rank(case, named) for name, named in baselines(case).items()}, costs, found)


def main() -> None:
    """Make cases, or read those that a folder has, and print the table."""
    parser = argparse.ArgumentParser(description="Score explanations of runs with known faults.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("-j", type=int, default=2, help="number of parallel runs")
    parser.add_argument("--again", action="store_true", help="score why --origins and why --prove as well")
    options = parser.parse_args()

    def one(seed: int) -> tuple[Case, Score]:
        folder = options.folder / str(seed)
        file = folder / "truth.json"
        if file.is_file():
            facts = json.loads(file.read_text(encoding="utf-8"))
            case = Case(**{**facts, "recording": folder / facts["recording"]})
        else:
            case = make_case(seed, folder)
        return case, scored(case, again=options.again)

    with ThreadPoolExecutor(options.j) as workers:
        results = list(workers.map(one, range(options.runs)))
    table([(case, score.ranks) for case, score in results])
    for name in results[0][1].costs:
        print(f"CPU of {name}: {statistics.median(score.costs[name] for _, score in results):.1f} s in the median")
    counted = sum((score.verdicts for _, score in results), Counter())
    print("".join(f"\n{count:5} causes {verdict}" for verdict, count in sorted(counted.items())))
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"\n{len(results)} runs, {spent.ru_utime + spent.ru_stime:.0f} s of CPU")


def table(results: Sequence[tuple[Case, dict[str, int]]]) -> None:
    """Print how often the truth is first, and within three, by kind and by method."""
    by_kind: dict[str, list[dict[str, int]]] = defaultdict(list)
    for case, ranks in results:
        by_kind[case.kind].append(ranks)
        by_kind["all"].append(ranks)
    methods = list(results[0][1])
    print(f"{'kind':14} {'runs':>5}  " + "  ".join(f"{name:>22}" for name in methods))
    for kind, ranks in sorted(by_kind.items(), key=lambda item: (item[0] == "all", item[0])):
        cells = []
        for name in methods:
            first = sum(each[name] == 1 for each in ranks) / len(ranks)
            three = sum(1 <= each[name] <= 3 for each in ranks) / len(ranks)
            cells.append(f"{first:>10.0%} {three:>9.0%} ")
        print(f"{kind:14} {len(ranks):>5}  " + "  ".join(f"{each:>22}" for each in cells))


if __name__ == "__main__":
    main()
