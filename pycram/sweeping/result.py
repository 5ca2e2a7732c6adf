"""What a sweep has done, and what its folder says of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from pycram.sweeping.one_run import Outcome, Spec

_KEPT: Final = 100  # outcomes of failures, and remarks: memory doesn't grow with the runs


@dataclass(slots=True)
class Sweep:
    """What a sweep has done.

    Attributes:
        folder: Where the recordings are.
        runs: How many were asked for.
        before: How many of them were there already.
        done: How many were made now.
        failed: How many of these failed.
        failures: Outcomes of the first of them.
        stopped: Why it ended before all were made; "" if it didn't.
        interrupted: Whether Ctrl-C ended it.
        remarks: What went wrong beside runs.
    """

    folder: str
    runs: int
    before: int = 0
    done: int = 0
    failed: int = 0
    failures: list[Outcome] = field(default_factory=list)
    stopped: str = ""
    interrupted: bool = False
    remarks: list[str] = field(default_factory=list)

    def take(self, outcome: Outcome) -> bool:
        """Take note of a run; return whether it is on record, as all others would go unrecorded, too."""
        if outcome.unrecorded:
            self.stopped = f"run {outcome.number} couldn't be recorded: {outcome.unrecorded}"
            return False
        if outcome.remark and len(self.remarks) < _KEPT:
            self.remarks.append(f"{outcome.name}: {outcome.remark}")
        self.done += 1
        if not outcome.succeeded:
            self.failed += 1
            if len(self.failures) < _KEPT:
                self.failures.append(outcome)
        return True

    def has_not_begun(self) -> bool:
        """Return whether the first run of all has failed before the plan did anything: so would all others.

        If so, its outcome has the name under which its recording is to be set aside.
        """
        if self.before or self.done > 1 or not self.failures:
            return False
        first = self.failures[0]
        if first.started and not first.lost:
            return False
        self.stopped = f"the first run failed before the plan did anything: {first.failure}"
        self.failures = [replace(first, name=f"{first.name}.failed")]
        return True


def facts_of(spec: Spec, runs: int) -> dict[str, Any]:
    """Return what a folder's ``sweep.json`` has."""
    digest = hashlib.sha256(Path(spec.plan).read_bytes()).hexdigest()
    return {
        "plan": spec.plan,
        "plan_sha256": digest,
        "arguments": list(spec.arguments),
        "seed": spec.seed,
        "runs": runs,
        "set": spec.listed,
        "sample": spec.sampled,
        "motion": spec.motion,
    }
