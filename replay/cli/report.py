"""``report``: write a page with the failure, its causes, pictures, a timeline, a film, and the tasks of each line."""

from __future__ import annotations

import argparse
import shlex
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from recorder.html import sections
from recorder.records import STEPS_PER_SECOND, Mutation
from recorder.tasks import Node, Tree
from replay.cli.check import checked
from replay.cli.console import print_message, print_result
from replay.compare import compare_recordings, comparison_lines
from replay.errors import ReplayError
from replay.explain import check, why_report
from replay.explain.why import Why
from replay.history.source import Line, PlanSource
from replay.history.tasks import summary
from replay.recording import Recording
from replay.report import phrases
from replay.report.report import embedded, page, write
from replay.state.fold import last_open_step

_FILM: Final = 24  # number of pictures in the film
_FILM_SIZE: Final = (400, 300)
_SIZE: Final = (640, 480)
#: Kinds of changes that build the scene.
_BUILDING: Final = frozenset({"open_world", "close_world", "load_body", "set_gravity", "set_color", "set_robot"})
_MAX_TASKS: Final = 2000  # maximum number of tasks in the timeline
_MAX_LINES: Final = 1000  # maximum number of lines of a file of the plan that are shown
_MAX_LED: Final = 3  # maximum number of steps that are listed at a line


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", dest="page", metavar="FILE", help="the page (default: LOG.html)")
    parser.add_argument("--check", metavar="FILE", action="append", default=[], help="a file of properties to check")
    parser.add_argument("--good", metavar="LOG", help="compare with the recording of a successful run")


def run(log: Recording, options: argparse.Namespace) -> None:
    why, source = log.why(), PlanSource(log)
    headlines, found = sections(why_report.lines(why, str(log.path)))
    closer = dict(found).get("Look closer", [f"pycram-replay view {shlex.quote(str(log.path))}"])
    info, drawn = summary(log), last_open_step(log, log.final_step())
    difference: list[str] = []
    if options.good:
        with Recording(options.good) as good:
            difference = [*comparison_lines(compare_recordings(log, good), whole=False)]
    tree = log.tree()
    film, moments = _film(log, tree, drawn), _moments(log, why)
    nodes = [node for _, node in tree.walk()]
    file = options.page or f"{log.path.stem}.html"
    content = page(
        "run.html",
        title=f"{info.plan}: {info.outcome}",
        facts=f"{info.plan}, {info.started:%Y-%m-%d %H:%M:%S} UTC, {phrases.plural(info.records, 'step')}",
        failed=why.failure is not None or info.outcome != "succeeded",
        headlines=headlines,
        sections=[(title, body) for title, body in found if title != "Look closer"],
        moments=moments,
        properties=[{"holds": bool(each), "lines": [*check.lines(each)]} for each in checked(log, [], options.check)],
        film=film,
        tasks=[*_timeline(tree.roots, len(log) - 1)],
        every=len(nodes),
        last=max(1, len(log) - 1),
        files=[*_files(source, nodes)],
        good=options.good,
        difference=difference,
        commands=closer,
    ).encode()
    write(file, content)
    print_result(lambda: {"page": file, "bytes": len(content)}, [file], as_json=options.json)


def _film(log: Recording, tree: Tree, end: int) -> list[dict[str, object]]:
    """Return pictures of the run after changes of the scene; none if the scene can't be drawn."""
    records = [each for each in log.records(Mutation, stop=end + 1) if each.WhichOneof("command") not in _BUILDING]
    chosen = {round(at * (len(records) - 1) / (_FILM - 1)) for at in range(_FILM if records else 0)}
    shown = [records[at] for at in sorted(chosen)]
    try:
        pictures = [*log.film([record.seq for record in shown], size=_FILM_SIZE)]
    except (ReplayError, ModuleNotFoundError) as error:  # the rest of the page matters more than its pictures
        print_message(f"no film: {error}")
        return []
    film: list[dict[str, object]] = []
    for record, picture in zip(shown, pictures, strict=True):
        task = tree.nodes.get(record.task)
        what = phrases.node(task.motion) if task is not None else phrases.record_line(record)
        caption = f"step {record.seq}, {record.sim_step / STEPS_PER_SECOND:.3f} s: {what}"
        film.append({"step": record.seq, "picture": embedded(picture), "caption": caption})
    return film


def _moments(log: Recording, why: Why) -> list[dict[str, object]]:
    """Return pictures of the failure: from the side, as the robot saw it, and before its task began."""
    if why.failure is None or not why.bodies:
        return []
    from replay.restore.render import DrawnWorld  # noqa: PLC0415  an extra

    world = why.world.name if why.world is not None else None
    try:
        scene = DrawnWorld(log, why.step, world)
        about = scene.subjects(why)
        views = [(f"at the failure, step {why.step}", scene.picture(target=about, size=_SIZE))]
        if scene.camera:
            views.append(("what the robot's camera saw", scene.picture(camera=scene.camera, size=_SIZE)))
        began = why.task.outermost_failed.started.seq if why.task is not None else why.step
        if began < why.step:
            before = DrawnWorld(log, began, world).picture(target=about, size=_SIZE)
            views.append((f"before the task that failed, step {began}", before))
        return [{"caption": caption, "picture": embedded(picture)} for caption, picture in views]
    except ReplayError as error:
        print_message(f"no pictures of the failure: {error}")
        return []


def _timeline(roots: Sequence[Node], last: int) -> Iterator[dict[str, object]]:
    """Yield a bar of the timeline for each task, outer tasks first; parallel branches have separate rows."""
    free: list[int] = []  # the step after which each row of the timeline is free
    pending = [(node, 0) for node in roots]
    count = 0
    while pending and count < _MAX_TASKS:
        node, lowest = pending.pop(0)
        start, end = node.started.seq, node.finished.seq if node.finished is not None else last
        row = next((row for row in range(lowest, len(free)) if free[row] <= start), max(lowest, len(free)))
        free += [0] * (row + 1 - len(free))
        free[row] = end + 1
        count += 1
        error = f": {node.error[1] or node.error[0]}" if node.error else ""
        yield {
            "name": node.name,
            "text": f"{phrases.node(node)}, steps {start} to {end}, {node.status.word}{error}",
            "start": start,
            "end": end,
            "row": row,
            "state": node.status.word,
        }
        pending += [(child, row + 1) for child in node.children]


def _files(source: PlanSource, nodes: Sequence[Node]) -> Iterator[dict[str, object]]:
    """Yield the files of the plan; each line of a file has the outermost tasks that the line requested."""
    led: dict[tuple[str, int], list[Node]] = defaultdict(list)
    paths: dict[str, str] = {}
    stacks: dict[int, Sequence[Line]] = {}  # call stacks of tasks by id
    for node in nodes:
        stack = stacks[node.id] = source.call_stack(node.asked or node.started)
        if stack and (node.parent is None or stacks[node.parent.id] != stack):  # parents come first
            led[stack[-1].file, stack[-1].number].append(node)
            paths.setdefault(stack[-1].file, Path(stack[-1].file).name)
    for path, name in paths.items():
        lines = source.text(path).splitlines()[:_MAX_LINES]
        if lines:
            rows = [_row(number, text, led[path, number]) for number, text in enumerate(lines, 1)]
            yield {"name": name, "lines": rows}


def _row(number: int, text: str, nodes: Sequence[Node]) -> dict[str, object]:
    ended: dict[str, list[int]] = defaultdict(list)  # steps at which tasks started, by name and status
    for node in nodes:
        ended[f"{node.name} {node.status.word}"].append(node.started.seq)
    led = []
    for how, steps in ended.items():
        more = f", ... ({len(steps)} times)" if len(steps) > _MAX_LED else ""
        led.append(f"{how}, {'step' if len(steps) == 1 else 'steps'} {', '.join(map(str, steps[:_MAX_LED]))}{more}")
    return {
        "number": number,
        "text": text,
        "led": "; ".join(led),
        "failing": any(node.failed for node in nodes),
        "steps": [node.last_step for node in nodes],
    }
