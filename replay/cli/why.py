"""``why``: why a plan failed, as a summary and in detail."""

from __future__ import annotations

import argparse
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.packages import require
from recorder.records import format_error
from replay.cli.console import print_message, print_result
from replay.cli.main import FINE, INCOMPLETE, USAGE
from replay.cli.retrace import AGAIN
from replay.errors import Damaged, ReplayError
from replay.explain import why_report
from replay.explain.good_run import good_run
from replay.explain.why import Why
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import report
from replay.report.phrases import percent, plural

if TYPE_CHECKING:
    from replay.origins.origin import Origins
    from replay.runs.folder import Runs

_COMMONEST: Final = 3  # maximum number of causes that are explained for a folder


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "step", metavar="STEP", nargs="?", help=f"a step of the failed task (default: the failure of the plan): {HINT}"
    )
    parser.add_argument("--pictures", metavar="DIR", help="write the robot's view of the failure, and a side view")
    parser.add_argument(
        "--origins",
        action="store_true",
        help=f"run the plan again, and follow the values of the failure back to the lines that made them; {AGAIN}",
    )
    parser.add_argument(
        "--prove",
        action="store_true",
        help="test each cause: run the plan again without the cause, in a fork beside a control run without changes; "
        f"confirmed causes come first; {AGAIN}",
    )
    parser.add_argument("--keep", metavar="DIR", help="with --prove: keep the recordings of the forks in this folder")
    parser.add_argument(
        "--recorded-source",
        action="store_true",
        help="with --origins or --prove: run the recorded source (default: the files on disk)",
    )


def run(log: Recording, options: argparse.Namespace) -> int:
    why = log.why(options.step)
    if options.prove:
        require("pybullet")
        from replay.retrace.prove import prove  # noqa: PLC0415  needs the executor

        keep = Path(options.keep) if options.keep else None
        why, _ = prove(log, why, keep=keep, recorded_source=options.recorded_source)
    elif options.keep:
        raise ReplayError("--keep needs --prove")
    origins = _origins(log, why, options)
    code, pictures = _pictures(log, why, options.pictures)
    good = good_run(log, why)
    found = {} if origins is None else {"origins": report.data(origins)}
    drawn = ["", "Pictures of the failure", *(f"  {path}" for path in pictures)] if pictures else []
    lines = chain(why_report.lines(why, str(log.path), () if origins is None else origins.lines(), good), drawn)
    print_result(lambda: why_report.data(why, good) | {"pictures": pictures} | found, lines, as_json=options.json)
    return code


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    """Print the most frequent causes of failures in a folder; for each, explain its first run."""
    from replay.runs.statistics import statistics  # noqa: PLC0415  needs an extra

    if options.step or options.pictures or options.origins or options.prove:
        raise ReplayError("a step, --pictures, --origins and --prove need a single recording, not a folder")
    stats = statistics(runs)
    failed = sum(cause.count for cause in stats.causes)
    text = [f"{failed} of {plural(stats.success.of, 'run')} failed, with {plural(len(stats.causes), 'cause')}"]
    explained = []
    for cause in stats.causes[:_COMMONEST]:
        with Recording(runs.path / cause.first) as log:
            why = log.why()
            good = good_run(log, why)
            facts = {"cause": cause.cause, "count": cause.count, "first": cause.first}
            explained.append(facts | {"why": why_report.data(why, good)})
            text += ["", f"{plural(cause.count, 'run')}, {percent(cause.share)}: {cause.cause}"]
            headline, *sections = "\n".join(why_report.lines(why, good=good)).split("\n\n")
            shown = [headline, *(part for part in sections if part.startswith(("Why", "Compared")))]
            text += [f"first in {cause.first}:", *(f"  {each}".rstrip() for each in "\n\n".join(shown).splitlines())]
    print_result(lambda: {"runs": stats.success.of, "failed": failed, "causes": explained}, text, as_json=options.json)


def _origins(log: Recording, why: Why, options: argparse.Namespace) -> Origins | None:
    if not options.origins:
        if options.recorded_source and not options.prove:
            raise ReplayError("--recorded-source needs --origins or --prove")
        return None
    if why.failure is None:
        print_message("no origins: nothing failed")
        return None
    require("pybullet")
    from replay.origins.origins import origins  # noqa: PLC0415  needs the executor

    return origins(log, why, recorded_source=options.recorded_source)


def _pictures(log: Recording, why: Why, folder: str | None) -> tuple[int, list[str]]:
    if folder is None:
        return FINE, []
    if why.failure is None:
        print_message("no pictures: nothing failed")
        return FINE, []
    try:
        from replay.restore.render import write_pictures  # noqa: PLC0415

        return FINE, [str(path) for path in write_pictures(log, why, Path(folder))]
    except (ReplayError, ModuleNotFoundError) as error:  # if pictures fail, the explanation is printed without them
        print_message(f"no pictures: {format_error(error)}")
        return INCOMPLETE if isinstance(error, Damaged) else USAGE, []
