"""A smaller plan with the same failure: delta debugging of statements (Zeller and Hildebrandt 2002).

Until the end, removed lines are replaced by empty lines, so that the failing line keeps its number. The search also
removes statements that load objects, and items of containers.
"""

from __future__ import annotations

import ast
import itertools
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias

from pycram.exploration import Ending
from pycram.projection.child import usable_cores
from recorder.plan_lines import syntax_nodes
from replay.errors import ReplayError
from replay.explain.why import why
from replay.file.record_reader import RecordReader
from replay.fix.trials import Trials, Version, alike

#: The kind of a failure's first cause, and the first line of the plan that its text names.
_Cause: TypeAlias = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Minimised:
    """A smaller plan that fails like the recorded one."""

    text: str
    lines: tuple[int, int]  # number of lines with code, before and after the search
    objects: tuple[int, int]  # number of objects at the end of the run, before and after the search
    runs: int  # number of runs
    failure: str  # failure of the smaller plan
    exhausted: bool  # whether the search stopped because its runs were used up


def minimise(trials: Trials, budget: int) -> Minimised:
    """Remove statements of a plan while the plan still fails in the same way, and of the same cause.

    Args:
        budget: maximum number of runs.

    Raises:
        ReplayError: the plan succeeded, or doesn't end as recorded.
    """
    reference = trials.control()
    if reference.kind == "succeeded":
        raise ReplayError("the plan succeeded; minimise needs a failed plan")
    with TemporaryDirectory(prefix="pycram-minimise-") as folder:
        search = _Search(trials, budget, Path(folder))
        search.reduce()
        short, objects = _short(search.text), search.objects
        ending, cause = search.run([short])[0]
        ends = [replace(each, plan_line="") for each in (ending, reference)]
        if not alike(*ends) or cause() != search.cause:
            short, ending = search.text, reference  # the plan may read its own lines
    lines = len(code_lines(trials.text)), len(code_lines(short))
    return Minimised(short, lines, (len(reference.bodies), objects), trials.runs, ending.failure, trials.runs >= budget)


class _Search:
    """The search for a smaller plan: ``text`` is the best so far."""

    def __init__(self, trials: Trials, budget: int, folder: Path) -> None:
        self._trials, self._budget, self._folder = trials, budget, folder
        self.text = trials.text
        self.objects = len(trials.reference.bodies)  # at the end of the run
        self.cause = self._cause(trials.log, trials.text)

    def reduce(self) -> None:
        """Remove as much as possible."""
        size = 0
        while self._left() and size != len(code_lines(self.text)):
            size = len(code_lines(self.text))
            for block in [*_levels(self.text)]:
                self._reduce_block(block)
            unwrapped = [each for each in map(partial(_unwrapped, self.text), ast.walk(ast.parse(self.text))) if each]
            for start in range(0, len(unwrapped), usable_cores()):
                if self._take_first(unwrapped[start : start + usable_cores()]) is not None:
                    break

    def _left(self) -> bool:
        return self._trials.runs < self._budget

    def _reduce_block(self, block: Sequence[_Span]) -> None:
        """Remove as many parts of a block as possible: first half of them together, finally each alone."""
        lines = self.text.splitlines()
        left = [span for span in block if lines[span.start - 1].strip() not in ("", "pass")]
        size = len(left)
        while size and left and self._left():
            # statements that use a variable are removed before its definition
            chunks = [left[max(0, end - size) : end] for end in range(len(left), 0, -size)]
            kept: list[_Span] = []
            while chunks and self._left():
                wave, chunks = chunks[: usable_cores()], chunks[usable_cores() :]
                at = self._take_first([_without(self.text, chunk) for chunk in wave])
                if at is not None:
                    chunks = [*wave[at + 1 :], *chunks]
                kept += [span for chunk in wave[:at] for span in chunk]
            left = sorted({*kept, *(span for chunk in chunks for span in chunk)})
            size //= 2

    def _take_first(self, texts: Sequence[str]) -> int | None:
        """Take the first version that fails like the plan; return its index, or None if there is none."""
        tidied = {text: index for index, text in enumerate(map(_tidied, texts)) if text not in self._trials.failed}
        taken: int | None = None
        for (text, index), (ending, cause) in zip(tidied.items(), self.run([*tidied]), strict=True):
            is_alike = alike(ending, self._trials.reference)
            if taken is None and is_alike and cause() == self.cause:
                self.text, self.objects, taken = text, len(ending.bodies), index
            elif taken is None or not is_alike:
                self._trials.failed.add(text)
        return taken

    def run(self, texts: Sequence[str]) -> list[tuple[Ending, Callable[[], _Cause]]]:
        """Run versions of the plan; return their endings, and functions that return the causes."""
        files = [self._folder / f"{index}.mcap" for index in range(len(texts))]
        causes = [partial(self._cause, file, text) for file, text in zip(files, texts, strict=True)]
        return [*zip(self._trials.all([*map(Version, texts, files)]), causes, strict=True)]

    def _cause(self, log: RecordReader | Path, text: str) -> _Cause:
        if isinstance(log, Path):
            with RecordReader(log) as opened:
                return self._cause(opened, text)
        first = next(iter(why(log).causes), None)
        said = "\n".join(first.lines()) if first is not None else ""
        line = re.search(rf"{re.escape(self._trials.program.name)}:(\d+)", said)
        return first.kind if first is not None else "", text.splitlines()[int(line[1]) - 1].strip() if line else ""


@dataclass(frozen=True, slots=True, order=True)
class _Span:
    """The lines of a statement or an item, from 1."""

    start: int
    end: int
    instead: str = "pass"


def _levels(text: str) -> Iterator[list[_Span]]:
    """Yield the statements of each block, outer blocks first, then items; those in `if x: y` or `x; y` don't count."""
    lines = text.splitlines()
    blocks: list[Sequence[ast.stmt]] = [ast.parse(text).body]
    while blocks:
        block = blocks.pop(0)
        texts = {span: textwrap.dedent("\n".join(lines[span.start - 1 : span.end])) for span in map(_span, block)}
        yield [span for span, part in texts.items() if syntax_nodes(part)]
        for statement in block:
            blocks += _blocks(statement)
    for node in ast.walk(ast.parse(text)):
        items = [(each, each) for each in getattr(node, "elts", ())]
        items += zip(filter(None, node.keys), node.values, strict=False) if isinstance(node, ast.Dict) else ()
        yield [_Span(first.lineno, last.end_lineno or 0, "") for first, last in items if _has_lines(lines, first, last)]


def _has_lines(lines: Sequence[str], first: ast.expr, last: ast.expr) -> bool:
    """Return whether an item of a container has its lines for itself."""
    before = lines[first.lineno - 1].encode()[: first.col_offset]
    after = lines[(last.end_lineno or 0) - 1].encode()[last.end_col_offset :]
    return not before.strip() and after.partition(b"#")[0].strip() in (b"", b",")


def _blocks(statement: ast.stmt) -> list[list[ast.stmt]]:
    """Return the blocks of a statement."""
    parts = [getattr(statement, name, None) for name in ("body", "orelse", "finalbody")]
    parts += [each.body for each in (*getattr(statement, "handlers", ()), *getattr(statement, "cases", ()))]
    return [part for part in parts if part]


def _span(statement: ast.stmt) -> _Span:
    first = min([statement.lineno, *(each.lineno for each in getattr(statement, "decorator_list", ()))])
    return _Span(first, statement.end_lineno or first)


def _unwrapped(text: str, node: ast.AST) -> str:
    """Return a plan in which the body of an `if`, `with` or `try` replaces the whole statement; "" for other nodes."""
    if not isinstance(node, ast.If | ast.With | ast.Try):
        return ""
    lines, body = text.splitlines(), node.body
    first, shift = _span(body[0]).start, body[0].col_offset - node.col_offset
    inner = [line[shift:] for line in lines[first - 1 : body[-1].end_lineno]]
    lines[node.lineno - 1 : node.end_lineno] = [""] * ((node.end_lineno or node.lineno) + 1 - node.lineno)
    lines[first - 1 : body[-1].end_lineno] = inner
    return "\n".join(lines) + "\n"


def _without(text: str, spans: Iterable[_Span]) -> str:
    """Return a plan without the given parts; the numbers of other lines don't change."""
    lines = text.splitlines()
    for span in spans:
        first = lines[span.start - 1]
        instead = first.removesuffix(first.lstrip()) + span.instead
        lines[span.start - 1 : span.end] = [instead.rstrip()] + [""] * (span.end - span.start)
    return "\n".join(lines) + "\n"


def _tidied(text: str) -> str:
    """Return a plan without unneeded `pass` statements; the numbers of other lines don't change."""
    lines = text.splitlines()
    blocks = [ast.parse(text).body]
    while blocks:
        block = blocks.pop()
        needed = [each for each in block if not isinstance(each, ast.Pass)]
        for each in block if needed else block[1:]:
            if isinstance(each, ast.Pass):
                lines[each.lineno - 1] = ""
        for statement in needed:
            blocks += _blocks(statement)
    return "\n".join(lines) + "\n"


def _short(text: str) -> str:
    """Return a plan without empty lines, comments and unused imports; blank lines separate its functions."""
    tree, lines = ast.parse(text), text.splitlines()
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} | {"annotations"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            node.names = [each for each in node.names if (each.asname or each.name).partition(".")[0] in used]
            indent = " " * node.col_offset
            lines[node.lineno - 1 : node.end_lineno] = [""] * ((node.end_lineno or node.lineno) + 1 - node.lineno)
            lines[node.lineno - 1] = indent + (ast.unparse(node) if node.names else "pass" if indent else "")
    for before, after in itertools.pairwise(tree.body):
        if isinstance(before, ast.FunctionDef | ast.ClassDef) or isinstance(after, ast.FunctionDef | ast.ClassDef):
            lines[_span(after).start - 1] = f"\n\n{lines[_span(after).start - 1]}"
    return "".join(f"{line}\n" for line in lines if line and not line.lstrip().startswith("#"))


def code_lines(text: str) -> list[str]:
    """Return the lines of a plan without empty lines and comments."""
    return [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
