"""Long measures: many seeded cases of one kind, of which ``make test`` runs a slice and ``make test-long`` all.

A measure is a test over seeds, cut into batches by :func:`seeded`; other long tests are measures of one case. With
``--resume FILE`` each case that ends is written down at once. Cases that passed are left out when the command is given
again, as long as the code is the same, and the end of each run is a table of all of them. Numbers that a case gives to
``record_property`` are summed up there; of lists of numbers it has median and 95th percentile.
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from typing import TypeAlias

    #: Of one case: a number that is summed up, or one for each of many things.
    Figure: TypeAlias = float | list[float]

REPO: Final = Path(__file__).parent.parent
_FOLDERS: Final = ("pycram", "recorder", "replay", "resources", "demos", "tests")
_KINDS: Final = {".py", ".toml", ".proto", ".urdf", ".stl", ".obj", ".mcap"}
_PASSED, _FAILED = "passed", "failed"


def seeded(name: str, seeds: range, size: int, always: int = 1) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a measure of a test that takes ``seeds``, a range of them.

    Args:
        name: what the table calls it; ``{parameter}`` in it stands for that of a case, for a row each.
        seeds: all of them.
        size: how many are one case; a run that is ended loses one case at most.
        always: how many cases are the slice that ``make test`` runs, at most 20 s of it.
    """
    batches = [seeds[start : start + size] for start in range(0, len(seeds), size)]
    cases = [
        pytest.param(batch, id=f"{batch[0]}-{batch[-1]}", marks=[] if number < always else [pytest.mark.long])
        for number, batch in enumerate(batches)
    ]

    def mark(test: Callable[..., None]) -> Callable[..., None]:
        return pytest.mark.slow(pytest.mark.measure(name)(pytest.mark.parametrize("seeds", cases)(test)))

    return mark


def code() -> str:
    """Return a name of the code under test, which changes with it."""
    digest = hashlib.sha256(platform.python_version().encode())
    for folder in _FOLDERS:
        for file in sorted((REPO / folder).rglob("*")):
            if file.suffix in _KINDS and file.is_file():
                digest.update(str(file.relative_to(REPO)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def read(file: Path, code: str) -> dict[str, dict[str, Any]]:
    """Return the last that is known of each case of some code; a line that was cut off by a kill is none.

    Args:
        file: where cases are written down.
        code: see :func:`code`.
    """
    found = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.is_file() else []:
        try:
            result = json.loads(line)
        except ValueError:
            continue
        if result["code"] == code:
            found[result["case"]] = result
    return found


def table(results: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Return the lines of a table, one a measure.

    Args:
        results: as :func:`read` gives them.
    """
    measures = defaultdict(list)
    for result in results:
        measures[result["measure"]].append(result)
    width = max(map(len, measures), default=0)
    yield f"{'measure':{width}}  cases  failed  seconds"
    for name, cases in sorted(measures.items()):
        failed = sum(result["outcome"] != _PASSED for result in cases)
        figures = ", ".join(_figures(result["figures"] for result in cases))
        line = (
            f"{name:{width}}  {len(cases):5}  {failed:6}  {sum(result['seconds'] for result in cases):7.0f}  {figures}"
        )
        yield line.rstrip()


def _figures(cases: Iterable[dict[str, Figure]]) -> Iterator[str]:
    sums: Counter[str] = Counter()
    samples: defaultdict[str, list[float]] = defaultdict(list)
    for figures in cases:
        for what, value in figures.items():
            if isinstance(value, list):
                samples[what] += value
            else:
                sums[what] += value
    yield from (f"{value:g} {what}" for what, value in sums.items())
    for what, values in samples.items():
        if values:
            ranked = sorted(values)
            middle, most = (ranked[math.ceil(share * len(ranked)) - 1] for share in (0.5, 0.95))
            yield f"{what}: median {middle:.3g}, p95 {most:.3g}"


class Resuming:
    """What ``--resume`` adds to a run.

    Args:
        file: where cases are written down.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.code = code()
        self.names: dict[str, str] = {}
        self.running: dict[str, dict[str, Any]] = {}

    @pytest.hookimpl(trylast=True)  # after the choice by marks
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Leave out what has passed already."""
        known = read(self.file, self.code)
        done = [item for item in items if known.get(item.nodeid, {}).get("outcome") == _PASSED]
        if done:
            config.hook.pytest_deselected(items=done)
            items[:] = [item for item in items if item not in done]
        for item in items:
            mark = item.get_closest_marker("measure")
            name = mark.args[0].format(**item.callspec.params) if mark else item.originalname  # type: ignore[attr-defined]
            # where it is read again: also by the process that only hands tests to others
            item.user_properties.append(("measure", name))

    def pytest_sessionstart(self) -> None:
        """End a line that was cut off by a kill, so that the next one can be read."""
        if self.file.is_file() and not self.file.read_bytes().endswith(b"\n"):
            with self.file.open("a", encoding="utf-8") as file:
                file.write("\n")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a case down when its last phase has ended; a worker leaves it to who hands out the tests."""
        result = self.running.setdefault(report.nodeid, {"outcome": _PASSED, "seconds": 0.0})
        result["seconds"] += report.duration
        if report.outcome != _PASSED:
            result["outcome"] = report.outcome if result["outcome"] != _FAILED else _FAILED
        if report.when == "teardown":
            del self.running[report.nodeid]
            properties = dict(report.user_properties)
            name = properties.pop("measure")
            figures = {what: value for what, value in properties.items() if isinstance(value, int | float | list)}
            line = {"code": self.code, "measure": name, "case": report.nodeid, "figures": figures} | result
            self.file.parent.mkdir(exist_ok=True)
            with self.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")

    @pytest.hookimpl(wrapper=True)
    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> Generator[None, None, None]:
        """Print the table; a run that had nothing left to do has ended well."""
        results = read(self.file, self.code).values()
        if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and results:
            session.exitstatus = pytest.ExitCode.OK
        yield
        terminal = session.config.pluginmanager.get_plugin("terminalreporter")
        terminal.ensure_newline()
        for line in table(results):
            terminal.write_line(line)
        terminal.write_line(f"remove {self.file} to measure all of it again")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.addoption(
        "--resume", metavar="FILE", type=Path, help="leave out what has passed by this file; print a table"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Begin to write cases down, where all of them are seen; workers only leave out the same."""
    file = config.getoption("--resume")
    if file is not None:
        resuming = Resuming(file)
        if hasattr(config, "workerinput"):
            config.pluginmanager.register(Choosing(resuming))
        else:
            config.pluginmanager.register(resuming)


class Choosing:
    """What a worker does of it."""

    def __init__(self, resuming: Resuming) -> None:
        self.pytest_collection_modifyitems = resuming.pytest_collection_modifyitems
