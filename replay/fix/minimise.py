"""A smaller plan with the same failure: delta debugging of statements (Zeller and Hildebrandt 2002).

Until the end, removed lines are replaced by empty lines, so that the failing line keeps its number. The search also
removes statements that load objects.
"""

from __future__ import annotations

import ast
import itertools
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from pycram.exploration import Ending
from pycram.projection.child import usable_cores
from replay.errors import ReplayError
from replay.fix.trials import Trials, Version, alike

_INDENT: Final = re.compile(r"\s*")


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
    """Remove statements of a plan while the plan still fails in the same way.

    Args:
        trials: the plan.
        budget: maximum number of runs.

    Raises:
        ReplayError: the plan succeeded, or doesn't end as recorded.
    """
    reference = trials.control()
    if reference.kind == "succeeded":
        raise ReplayError("the plan succeeded; minimise needs a failed plan")
    text, before = trials.text, len(reference.bodies)
    objects = before
    size = 0
    while trials.runs < budget and size != len(code_lines(text)):
        size = len(code_lines(text))
        for block in _levels(text):
            text, objects = _reduced(trials, budget, text, block, objects)
        unwrapped = [each for each in map(partial(_unwrapped, text), ast.walk(ast.parse(text))) if each]
        for start in range(0, len(unwrapped), usable_cores()):
            found = _first_alike(trials, unwrapped[start : start + usable_cores()])
            if found is not None:
                _, text, objects = found
                break
    short = _short(text)
    ending = trials.one(short).ending
    if not alike(_without_line(ending), _without_line(reference)):  # the plan may read its own lines
        short, ending = text, reference
    return Minimised(
        short,
        (len(code_lines(trials.text)), len(code_lines(short))),
        (before, objects),
        trials.runs,
        ending.failure,
        trials.runs >= budget,
    )


def _reduced(trials: Trials, budget: int, text: str, block: Sequence[_Span], objects: int) -> tuple[str, int]:
    """Remove as many statements of a block as possible: first half of them together, finally each alone."""
    lines = text.splitlines()
    left = [span for span in block if lines[span.start - 1].strip() not in ("", "pass")]
    size = len(left)
    while size and left and trials.runs < budget:
        # statements that use a variable are removed before its definition
        chunks = [left[max(0, end - size) : end] for end in range(len(left), 0, -size)]
        kept: list[_Span] = []
        while chunks and trials.runs < budget:
            wave, chunks = chunks[: usable_cores()], chunks[usable_cores() :]
            found = _first_alike(trials, [_without(text, chunk) for chunk in wave])
            at = len(wave)
            if found is not None:
                at, text, objects = found
                chunks = [*wave[at + 1 :], *chunks]
            kept += [span for chunk in wave[:at] for span in chunk]
        left = sorted({*kept, *(span for chunk in chunks for span in chunk)})
        size //= 2
    return text, objects


@dataclass(frozen=True, slots=True, order=True)
class _Span:
    """The lines of a statement, from 1."""

    start: int
    end: int


def _levels(text: str) -> Iterator[list[_Span]]:
    """Yield the statements of each block of a plan, outer blocks first; statements that share a line don't count."""
    blocks: list[Sequence[ast.stmt]] = [ast.parse(text).body]
    while blocks:
        block = blocks.pop(0)
        spans = [_span(each) for each in block]
        yield [span for span in spans if _is_apart(text.splitlines(), span)]
        for statement in block:
            blocks += _blocks(statement)


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
    kept = lines[_span(body[0]).start - 1 : body[-1].end_lineno]
    inner = [line[body[0].col_offset - node.col_offset :] for line in kept]
    lines[node.lineno - 1 : node.end_lineno] = [""] * ((node.end_lineno or node.lineno) + 1 - node.lineno)
    lines[_span(body[0]).start - 1 : body[-1].end_lineno] = inner
    return "\n".join(lines) + "\n"


def _is_apart(lines: Sequence[str], span: _Span) -> bool:
    """Return whether a statement has its lines for itself, unlike those in `if x: y` or `x; y`."""
    try:
        ast.parse(textwrap.dedent("\n".join(lines[span.start - 1 : span.end])))
    except SyntaxError:
        return False
    return True


def _without(text: str, spans: Iterable[_Span]) -> str:
    """Return a plan without the given statements; the numbers of other lines don't change."""
    lines = text.splitlines()
    for span in spans:
        indent = _INDENT.match(lines[span.start - 1])
        lines[span.start - 1 : span.end] = [""] * (span.end + 1 - span.start)
        lines[span.start - 1] = f"{indent[0] if indent else ''}pass"
    return "\n".join(lines) + "\n"


def _first_alike(trials: Trials, texts: Sequence[str]) -> tuple[int, str, int] | None:
    """Return the index and text of the first version that ends like the plan, with its number of objects."""
    tidied = {index: _tidied(text) for index, text in enumerate(texts)}
    tried = [index for index, text in tidied.items() if text not in trials.failed]
    ends: dict[int, int] = {}
    with closing(trials.all([Version(tidied[index]) for index in tried])) as results:
        for at, trial in results:
            if alike(trial.ending, trials.reference):
                ends[tried[at]] = len(trial.ending.bodies)
            else:
                trials.failed.add(tidied[tried[at]])
    return min(((index, tidied[index], objects) for index, objects in ends.items()), default=None)


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


def _without_line(ending: Ending) -> Ending:
    return replace(ending, plan_line="")
