"""The pytest plugin: tests of plans, with their recordings (docs/guides/testing.md).

Fixtures import the packages that run plans only on demand, because pytest loads this module in every session.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import pytest

import recorder

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld
    from replay.recording import Recording

    Recorded: TypeAlias = "str | Path | Recording | recorder.Recording | PlanRun"

__all__ = ["PlanRun", "PropertyFailed", "assert_holds", "seeds"]

_KEPT: Final = "pycram recording"  # property of a failed test in reports: its recording, and the step of the failure
_FOLDER: Final = "pycram-recordings"
_files: Final = pytest.StashKey[list[Path]]()  # folder for the recordings of a failed test
_kept_as: Final[dict[Path, Path]] = {}  # folder for the recordings of failed tests of this process
_error: Final = pytest.StashKey[BaseException]()  # the error by which a test failed


class PropertyFailed(AssertionError):
    """A property of :func:`assert_holds` is violated."""

    def __init__(self, text: str, step: str) -> None:
        super().__init__(text)
        self.step = step  # step or time of the violation, in a form that verbs accept


@dataclass(frozen=True, slots=True)
class PlanRun:
    """A run of a plan as a program."""

    path: Path  # its recording
    code: int  # exit code; 0 if the plan succeeded
    output: str  # the text that the run wrote to stdout and stderr

    @property
    def succeeded(self) -> bool:
        """Whether the plan succeeded."""
        return self.code == 0

    def __repr__(self) -> str:
        how = next((line for line in self.output.splitlines() if line.startswith("pycram: the plan")), "")
        return f"<PlanRun {self.path.name}: exit code {self.code}{how.removeprefix('pycram')}>"


def assert_holds(recording: Recorded, *properties: str) -> None:
    """Check properties of a recording, such as ``always milk.z > 0.5`` (docs/reference/properties.md).

    Args:
        recording: A file, a recording that is open or still running, or the result of ``run_plan``.

    Raises:
        PropertyFailed: A property is violated. The message contains the first violation of each property, its task and
            line, and commands for more.
        BadProperty: A text isn't in the language, or contains an unknown name.
    """
    __tracebackhide__ = True
    import replay  # noqa: PLC0415  see above
    from replay.explain.check import lines, step_of  # noqa: PLC0415

    if hasattr(recording, "journal"):
        recording.journal.flush()
    path = recording if isinstance(recording, str | Path) else recording.path
    with replay.open(path) as log:
        kept = _shown(_kept_as.get(Path(path), Path(path)))
        violated = [replace(each, path=kept) for each in log.check(*properties) if not each]
    if violated:
        raise PropertyFailed("\n".join(line for each in violated for line in lines(each)), step_of(violated[0]))


def seeds(count: int) -> pytest.MarkDecorator:
    """Run a test with the seeds 0 to ``count`` - 1 as the argument ``seed``. The test's fixtures use the same seed."""
    return pytest.mark.parametrize("seed", range(count))


@pytest.fixture
def pycram_record(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Record the test. If the test fails, its recording is kept under the name of the test."""
    import pycram  # noqa: PLC0415  see above
    import recorder  # noqa: PLC0415

    kept = _kept_file(request)
    seed = getattr(getattr(request.node, "callspec", None), "params", {}).get("seed")
    if seed is not None:
        pycram.seed(seed)
    file = tmp_path_factory.mktemp("pycram") / kept.name
    _kept_as[file] = kept
    try:
        with recorder.record(
            file, name=kept.stem, arguments=(), source=request.path, seed=seed, output=True
        ) as recording:
            yield recording
            if _error in request.node.stash:
                raise request.node.stash[_error]  # noqa: TRY301  as at the end of a run
    except BaseException as error:
        if error is not request.node.stash.get(_error, None):
            raise
    finally:
        _keep(request, file, kept)


@pytest.fixture
def pycram_world(pycram_record: object) -> Iterator[BulletWorld]:  # noqa: ARG001  it records
    """A new world without a window; it is the current world, is recorded, and ends with the test."""
    from pycram.bullet_world import BulletWorld  # noqa: PLC0415  see above

    with BulletWorld() as world:
        yield world


@pytest.fixture
def run_plan(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., PlanRun]]:
    """Run a plan in another process: ``run_plan("plan.py", seed=3, x=0.4)``.

    The plan's file is relative to the test's folder. By default, ``seed`` is the seed of the test, or 0. ``motion``,
    ``check`` (a file of properties) and ``arguments`` are options of ``pycram run``. All other arguments are parameters
    of the plan.
    """
    files: list[tuple[Path, Path]] = []
    params = getattr(getattr(request.node, "callspec", None), "params", {})

    def run(
        plan: str | Path,
        *,
        seed: int | None = None,
        motion: str = "",
        check: str | Path = "",
        arguments: tuple[str, ...] = (),
        **parameters: object,
    ) -> PlanRun:
        folder = Path(request.path).parent
        kept = _kept_file(request)
        file = tmp_path_factory.mktemp("pycram") / kept.name
        files.append((file, kept))
        _kept_as[file] = kept
        command = [sys.executable, "-m", "pycram", "run", str(folder / plan), "--log", str(file)]
        command += ["--seed", str(params.get("seed", 0) if seed is None else seed)]
        command += [word for name, value in parameters.items() for word in ("--set", f"{name}={value}")]
        command += (["--motion", motion] if motion else []) + (["--check", str(folder / check)] if check else [])
        command += ["--", *arguments] if arguments else []
        ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603  the user's plan
        return PlanRun(file, ended.returncode, ended.stdout + ended.stderr)

    yield run
    for file, kept in files:
        _keep(request, file, kept)


def _kept_file(request: pytest.FixtureRequest) -> Path:
    """Return the path to which the next recording of a test is moved if the test fails."""
    node, config = request.node, request.config
    files = node.stash.setdefault(_files, [])
    name = re.sub(r"[^\w.=-]+", "_", node.nodeid.replace("::", ".")).strip("_")
    number = f".{len(files) + 1}" if files else ""
    files.append(config.rootpath / config.getoption("pycram_recordings") / f"{name}{number}.mcap")
    return Path(files[-1])


def _shown(file: Path) -> str:
    return str(file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file)


def _keep(request: pytest.FixtureRequest, file: Path, kept: Path) -> None:
    if _error in request.node.stash and file.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(file, kept)
    else:
        with suppress(OSError):
            file.unlink()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the plugin."""
    group = parser.getgroup("pycram")
    group.addoption("--pycram-recordings", default=_FOLDER, metavar="DIR", help="folder for recordings of failed tests")
    group.addoption("--pycram-view", action="store_true", help="open the first failed test's recording at its failure")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Store whether a test failed, and list its recordings in the report."""
    report: pytest.TestReport = yield  # type: ignore[assignment]  # the wrapper needs the report
    if report.failed and _files in item.stash:
        error = call.excinfo.value if call.excinfo is not None else AssertionError(str(report.longrepr))
        item.stash.setdefault(_error, error)
        for file in item.stash[_files]:
            report.user_properties.append((_KEPT, (str(file), getattr(error, "step", "failure"))))
    return report  # type: ignore[return-value]


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """List the kept recordings, and open the first one if the user asked for it."""
    reports = [*terminalreporter.getreports("failed"), *terminalreporter.getreports("error")]
    noted = (each for report in reports for each in getattr(report, "user_properties", ()))  # not of collections
    kept = dict(value for name, value in noted if name == _KEPT)
    found = {file: step for file, step in kept.items() if Path(file).is_file()}
    if not found:
        return
    terminalreporter.section("recordings of failed tests")
    for file, step in found.items():
        shown = shlex.quote(_shown(Path(file)))
        terminalreporter.line(f"pycram-replay why {shown}")
        terminalreporter.line(f"pycram-replay view {shown} --at {step}")
    if config.getoption("pycram_view"):
        file, step = next(iter(found.items()))
        subprocess.run([sys.executable, "-m", "replay", "view", file, "--at", step], check=False)  # noqa: S603
