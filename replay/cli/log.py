"""``log`` prints records as lines, ``show`` a whole record, ``tree`` the task tree, ``source`` the plan's source."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from recorder.records import STEPS_PER_SECOND, Keyframe, Mutation, Plain, Record, Task
from replay.cli.console import print_json, print_json_list, print_message, print_result, print_text
from replay.errors import NoSuchName, ReplayError
from replay.file.chunks import KINDS
from replay.history.source import PlanSource, is_file, name_of, sites
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import phrases
from replay.state.json_data import kind_of, mentions, record_data

_POLL_PERIOD: Final = 0.2  # time in s between two reads of a growing recording
_FIELD_WIDTH: Final = 100  # number of characters above which a value takes several lines
_MAX_IN_LINE: Final = 12  # number of values above which a list of numbers is printed in rows
_MANY: Final = 100  # number of values above which a list of numbers is shortened
_SHORT: Final = 8  # number of digits of a hash that are printed
_ENDS: Final = 18  # number of values at each end of a shortened list


def add(parser: argparse.ArgumentParser) -> None:
    kinds = sorted(KINDS)
    text = f"only this kind of record: {', '.join(kinds)}; repeatable"
    parser.add_argument("--kind", choices=kinds, metavar="KIND", action="append", help=text)
    parser.add_argument("--task", metavar="ID|NAME", help="only records of this task and its subtasks")
    parser.add_argument("--object", metavar="NAME", help="only records about this object")
    parser.add_argument("--world", metavar="NAME", help="only records about this world")
    parser.add_argument("--where", metavar="FILE[:LINE]", help="only records with this line in their call stack")
    parser.add_argument("--text", metavar="TEXT", help="only records whose line contains this text")
    parser.add_argument("--from", dest="start", default="0", metavar="STEP", help=f"first step: {HINT}")
    parser.add_argument("--to", dest="end", default="last", metavar="STEP", help="last step")
    parser.add_argument("--follow", action="store_true", help="continue while the recording is being written")


def run(log: Recording, options: argparse.Namespace) -> None:
    """Print the lines. With ``--json``, each line is a JSON object."""
    where = None if options.where is None else line_of(options.where)
    wanted = RecordFilter(options.kind or (), options.task, options.object, options.world, options.text, where)
    start, stop = log.step(options.start), log.step(options.end) + 1
    found = False
    for record, line in follow(log, wanted, start) if options.follow else wanted.matches(log, start, stop):
        found = True
        if options.json:
            print_json(record_data(record) | {"text": line}, flush=options.follow)
        else:
            clock = f"{record.sim_step / STEPS_PER_SECOND:.3f}s" if record.world else ""
            lifetime = log.lifetime_at(record.world, record.seq) if record.world and len(log.lifetimes) > 1 else None
            world = f"{lifetime.title}: " if lifetime is not None else ""
            cause = f"  (by a handler of the event at step {record.cause})" if record.cause else ""
            print_text(f"{record.seq:6} {clock:>10} {kind_of(record):8} {world}{line}{cause}", flush=options.follow)
    if not found and not options.follow:
        wanted.check(log)


def line_of(text: str) -> tuple[str, int | None]:
    """Return the file and line of ``FILE:LINE`` or ``FILE``."""
    file, colon, number = text.rpartition(":")
    return (file, int(number)) if colon and number.isdecimal() else (text, None)


def follow(log: Recording, wanted: RecordFilter, start: int) -> Iterator[tuple[Record, str]]:
    """Yield matching records, including new records, until the recording is closed or its process ends."""
    while True:
        live = log.live  # this is read before the last refresh, so that no record is missed
        log.refresh()
        yield from wanted.matches(log, start, len(log))
        start = len(log)
        if log.closed or not live:
            if not log.closed:
                print_message("the process that wrote this recording ended without closing it")
            return
        threading.Event().wait(_POLL_PERIOD)


@dataclass(slots=True)
class RecordFilter:
    """A selection of records in a recording that may grow."""

    kinds: Collection[str]  # kinds of records, such as "task" and "mutation"; empty for all kinds
    task: str | None  # id of a task, or part of its name; records in its subtasks match, too
    body: str | None  # name of a body that the record mentions
    world: str | None  # name of the record's world
    text: str | None  # part of the record's line, in upper or lower case
    where: tuple[str, int | None] | None = None  # file of the plan in the call stack, and a line number or None
    _tasks: set[int] = field(default_factory=set)  # ids of the matching tasks
    _led_to: set[int] = field(default_factory=set)  # ids of tasks; the call stack of each task contains the line
    _known: int = 0  # first step that has not been searched for tasks

    def matches(self, log: Recording, start: int, stop: int) -> Iterator[tuple[Record, str]]:
        """Yield the matching records with their lines."""
        if self.task is not None or self.where is not None:
            for task in log.records(Task, self._known, stop):
                if task.phase == Task.STARTED and self.task is not None:
                    by_id = self.task.isdecimal()
                    named = task.task == int(self.task) if by_id else self.task.casefold() in task.name.casefold()
                    if named or task.parent in self._tasks:
                        self._tasks.add(task.task)
                if task.parent in self._led_to or self._has_line(task):
                    self._led_to.add(task.task)
            self._known = stop
        for record in log.records(start=start, stop=stop):
            line = self._line(record)
            if line is not None:
                yield record, line

    def _has_line(self, record: Record) -> bool:
        file, number = self.where or ("", None)
        return any(is_file(path, file) and number in (None, line) for path, line in sites(record))

    def check(self, log: Recording) -> None:
        """Raise NoSuchName if the recording doesn't have the object, task, world or line of the filter."""
        if self.world is not None and all(lifetime.world != self.world for lifetime in log.lifetimes):
            raise NoSuchName("world", self.world, (lifetime.world for lifetime in log.lifetimes))
        if self.task is not None and not self._tasks:
            raise NoSuchName("task", self.task, (task.name for task in log.records(Task)))
        if self.body is not None:
            bodies = {each.load_body.body for each in log.records(Mutation) if each.HasField("load_body")}
            bodies |= {each.body for keyframe in log.records(Keyframe) for each in keyframe.loaded}
            if self.body not in bodies:
                raise NoSuchName("object", self.body, bodies)
        if self.where is not None:
            file, number = self.where
            source = PlanSource(log)
            if not source.has(file):
                raise NoSuchName("file of the plan", file, source.files)
            lines = len(source.text(file).splitlines())
            if number is not None and lines and not 1 <= number <= lines:
                raise NoSuchName(f"line of {file}", str(number), (), f"it has lines 1 to {lines}")

    def _line(self, record: Record) -> str | None:
        """Return the line of a record; None if the record doesn't match."""
        if self.kinds and kind_of(record) not in self.kinds:
            return None
        if self.world is not None and record.world != self.world:
            return None
        if self.task is not None and record.task not in self._tasks:
            return None
        if self.where is not None and record.task not in self._led_to and not self._has_line(record):
            return None
        if self.body is not None and not mentions(record, self.body):
            return None
        line = phrases.record_line(record)
        return line if self.text is None or self.text.casefold() in line.casefold() else None


def add_show(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("step", metavar="STEP", help=HINT)


def run_show(log: Recording, options: argparse.Namespace) -> None:
    record = log[log.step(options.step)]
    fields = record_data(record)
    further = {key: item for key, item in fields.items() if key not in ("step", "kind")}
    lines = [f"step {record.seq}: {kind_of(record)}: {phrases.record_line(record)}", *_field_lines(further, "  ")]
    print_result(lambda: fields, lines, as_json=options.json)


def _field_lines(fields: dict[str, Plain], indent: str) -> Iterator[str]:
    for key, item in fields.items():
        short = json.dumps(item, ensure_ascii=False)
        if isinstance(item, str) and "\n" in item:
            yield f"{indent}{key}:"
            yield from (f"{indent}  {line}" for line in item.rstrip().splitlines())
        elif len(short) + len(indent) + len(key) <= _FIELD_WIDTH or not isinstance(item, dict | list):
            yield f"{indent}{key}: {item if isinstance(item, str) else short}"
        else:
            yield f"{indent}{key}:"
            yield from _field_lines(item, indent + "  ") if isinstance(item, dict) else _items(item, indent + "  ")


def _items(values: list[Plain], indent: str) -> Iterator[str]:
    if len(values) > _MAX_IN_LINE and all(isinstance(item, float | int) for item in values):
        yield from (f"{indent}{line}" for line in _numbers([json.dumps(item) for item in values]))
        return
    for item in values:
        if isinstance(item, dict) and item:
            first, *rest = _field_lines(item, indent + "  ")
            yield f"{indent}- {first.strip()}"
            yield from rest
        else:
            yield f"{indent}- {json.dumps(item, ensure_ascii=False)}"


def _numbers(texts: list[str]) -> Iterator[str]:
    """Yield the rows of a list of numbers. For a long list, such as a trajectory, only both ends are shown."""
    if len(texts) <= _MANY:
        yield from textwrap.wrap(", ".join(texts), _FIELD_WIDTH)
        return
    yield from textwrap.wrap(", ".join(texts[:_ENDS]), _FIELD_WIDTH)
    yield f"... {len(texts) - 2 * _ENDS} more; --json prints all"
    yield from textwrap.wrap(", ".join(texts[-_ENDS:]), _FIELD_WIDTH)


def add_tree(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--at", metavar="STEP", help=f"step of the tree: {HINT}")
    parser.add_argument("--depth", type=int, metavar="N", help="number of levels")
    parser.add_argument("--all", action="store_true", help="also print repeated tasks")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--dot", action="store_true", help="print a graph for Graphviz")
    form.add_argument("--svg", action="store_true", help="print a picture (SVG) with a time line")


def run_tree(log: Recording, options: argparse.Namespace) -> None:
    tree = log.tree(options.at)
    if options.json:
        print_json_list(tree.facts(options.depth))
    elif options.dot:
        print_text(tree.to_dot(), end="")
    elif options.svg:
        encoding = sys.stdout.encoding or "ascii"  # characters outside of ASCII are written as XML references
        picture = tree.to_svg(options.depth, whole=options.all).encode(encoding, "xmlcharrefreplace")
        print_text(picture.decode(encoding), end="")
    elif not (tree.roots or tree.output):
        print_text("no tasks")
    else:
        for line in tree.lines(options.depth, whole=options.all):
            print_text(line)


def add_source(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="print this file; if several files have this name, HASH/FILE (default: list all files)",
    )
    parser.add_argument("-o", dest="target", metavar="PATH", help="write the file to PATH, or all files to a folder")


def run_source(log: Recording, options: argparse.Namespace) -> None:
    keys = sorted((key for key in log.assets if key.endswith(".py")), key=lambda key: (name_of(key), key))
    chosen = keys if options.file is None else [_find(keys, options.file)]
    if options.target is not None:
        target = Path(options.target)
        whole = options.file is None
        # names in a recording of a stranger could control the terminal that lists the folder
        names = ["".join(each if each.isprintable() else "_" for each in name_of(key)) for key in chosen]
        written = []
        for key, name in zip(chosen, names, strict=True):
            shared = names.count(name) > 1
            file = target / (f"{key[:_SHORT]}_{name}" if shared else name) if whole or target.is_dir() else target
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
                with file.open("xb") as output:  # no file of the user may be replaced
                    output.write(log.assets[key])
            except OSError as error:
                raise ReplayError(f"{file}: {error.strerror or error}") from error
            written.append(str(file))
        print_result(lambda: {"files": written}, written, as_json=options.json)
    elif options.file is None:
        listed = [
            {"file": name_of(key), "sha256": key.partition("/")[0], "bytes": len(log.assets[key])} for key in keys
        ]
        lines = [f"{each['sha256']:.{_SHORT}}  {each['bytes']:8}  {each['file']}" for each in listed]
        print_result(lambda: listed, lines or ["no source is attached"], as_json=options.json)
    else:
        text = log.assets[chosen[0]].decode("utf-8", "replace")
        if options.json:
            print_json({"file": name_of(chosen[0]), "sha256": chosen[0].partition("/")[0], "text": text})
        else:
            print_text(text, end="")


def _find(keys: list[str], name: str) -> str:
    """Return the key of an attached file by name. ``HASH/FILE`` selects one of several files with the same name."""
    digits, _, file = name.rpartition("/")
    if digits.strip("0123456789abcdef"):  # the text before "/" may be a folder, and not a hash
        digits = ""
    fitting = [key for key in keys if name_of(key) == file and key.startswith(digits)]
    if not fitting:
        raise NoSuchName("attached source", name, map(name_of, keys))
    if len(fitting) > 1:
        choices = " or ".join(f"{key[:_SHORT]}/{file}" for key in fitting)
        raise ReplayError(f"{len(fitting)} files are called {file}: {choices}")
    return fitting[0]
