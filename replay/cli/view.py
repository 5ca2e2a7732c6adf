"""``view``: show up to four recordings side by side in the Rerun viewer."""

from __future__ import annotations

import argparse
import threading
import webbrowser
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.records import Task
from recorder.records.text import recording_name
from replay.cli.console import native_output_to_stderr, print_json, print_message, print_result, print_text
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from replay.runs.folder import Runs

_MAX_BESIDE: Final = 3  # with five or more recordings side by side, each would be too small


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "For a folder, the first failures of its most frequent causes are shown side by side."
    parser.add_argument("others", metavar="LOG2", nargs="*", help=f"up to {_MAX_BESIDE} recordings to show beside LOG")
    parser.add_argument("--imagined", action="store_true", help=f"also show the last {_MAX_BESIDE} projections")
    parser.add_argument("--at", metavar="STEP", help=f"first step: {HINT}")
    parser.add_argument("--save", metavar="FILE", help="write an .rrd file instead of opening the viewer")
    parser.add_argument("--open", action="store_true", help="open the viewer, also with --save")
    parser.add_argument("--web", action="store_true", help="show the whole recording in the browser until Ctrl-C")
    parser.add_argument("--connect", metavar="URL", help="show the recording in the viewer at this URL")


def imagined(log: Recording) -> list[Path]:
    """Return the recordings of a run's projections in order; raise ReplayError if the run's folder has none."""
    names = filter(None, map(recording_name, log.records(Task)))
    found = [path for name in names if (path := log.path.with_name(name)).exists()]
    if not found:
        raise ReplayError(f"{log.path}: its folder has no recordings of its projections (NAME.projection-1.mcap)")
    return found


def run(log: Recording, options: argparse.Namespace) -> None:
    if options.web and (options.save or options.at or options.connect):
        raise ReplayError("--web shows the whole recording; it can't be combined with --save, --at or --connect")
    if len(options.others) > _MAX_BESIDE:
        raise ReplayError(f"{len(options.others) + 1} recordings are too many to show side by side; give at most four")
    step = log.step(options.at) if options.at is not None else None
    with ExitStack() as opened, native_output_to_stderr():
        beside = [Path(other) for other in options.others]
        beside += imagined(log)[-_MAX_BESIDE:] if options.imagined else []
        logs = [log, *(opened.enter_context(Recording(path)) for path in beside)]
        if options.web:
            _serve(logs, wants_json=options.json)
            return
        from replay.view import cached, check, convert, show, temporary_file  # noqa: PLC0415  slow to import

        check(options.connect)
        eyes = [_eye(log, step if log is logs[0] else None) for log in logs]
        if options.save is not None:
            file = Path(options.save)
            if file.suffix != ".rrd":
                raise ReplayError(f"{file}: the viewer opens .rrd files only; choose a name that ends in .rrd")
            convert(logs, file, step, eyes, opens=step is not None)
        elif len(logs) == 1:
            file = cached(logs[0], step, eyes[0])
        else:
            file = temporary_file(f"{'_'.join(log.path.stem for log in logs)}.rrd")
            convert(logs, file, step, eyes)
        shown: dict[str, object] = {"file": str(file)}
        if options.open or options.save is None:
            shown["viewer"] = show(file, step, options.connect)
    print_result(lambda: shown, [str(shown["file"])], as_json=options.json)


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    from replay.runs.statistics import statistics  # noqa: PLC0415  needs an extra

    if options.others:
        raise ReplayError("a folder can't be shown with other recordings; to show recordings side by side, name them")
    stats = statistics(runs)
    chosen = [cause.first for cause in stats.causes[: _MAX_BESIDE + 1]] or stats.runs[:1]
    if not chosen:
        raise ReplayError(f"{runs.path}: there is no run to show")
    options.others = [str(runs.path / name) for name in chosen[1:]]
    with Recording(runs.path / chosen[0]) as log:
        run(log, options)


def _eye(log: Recording, step: int | None) -> tuple[Vector, Vector] | None:
    """Return a viewpoint and the middle of its picture; None for an overview, or without the renderer."""
    with suppress(ReplayError, ModuleNotFoundError):
        from replay.restore.render import failure_view  # noqa: PLC0415  needs an extra

        return failure_view(log, step)
    return None


def _serve(logs: Sequence[Recording], *, wants_json: bool) -> None:
    from recorder.viewer.rerun_stream import stream_to_viewer  # noqa: PLC0415
    from recorder.viewer.web_page import WebPage, private_link  # noqa: PLC0415
    from replay.view import translate  # noqa: PLC0415

    with stream_to_viewer() as stream:
        page = WebPage(stream)
        # pages show all rows
        translate(logs, stream, max(len(each) for each in logs) - 1, [_eye(log, None) for log in logs])
        page.flush()
        if wants_json:
            print_json({"page": page.address}, flush=True)
        else:
            print_text(page.address, flush=True)
        print_message("shown in the browser until Ctrl-C")
        with private_link(page.address) as link:
            webbrowser.open(link)
            threading.Event().wait()
