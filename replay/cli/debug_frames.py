"""The debugger's prompt where the plan has stopped: its frames, their source, and what is in them, as pdb has them."""

from __future__ import annotations

import inspect
import linecache
import re
from typing import TYPE_CHECKING, Any, Final

from recorder.records import STEPS_PER_SECOND, Output, Run, format_failure
from replay.cli import formatting, record_text
from replay.cli.console import visible
from replay.cli.debug_prompt import LinePrompt
from replay.errors import ReplayError
from replay.state.json_data import kind_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from recorder.records import Record
    from replay.debug.session import Halt, Session

_MAIN_THREAD: Final = "MainThread"
_AROUND: Final = 5  # lines before and after the current one, as pdb lists them


class FramesPrompt(LinePrompt):
    """A prompt in the plan's frames.

    Args:
        session: what it is about.

    Attributes:
        session: as given.
        log: its recording.
        stack: the plan's frames, innermost first.
        frame: which of them is chosen.
        follow: brings the viewer to a step; None where there is none.
    """

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self.log = session.log
        self.stack: list[dict[str, Any]] = []
        self.frame = 0  # 0: the innermost
        self._listed = 0  # the line after the last one that was listed; 0: none was
        self.follow: Callable[[int], None] | None = None

    def begin(self, step: int) -> None:
        """Go to the first step; where Ctrl-C ends the plan on its way there, to the start."""
        try:
            halt = self.session.go(step)
        except PlanInterrupted as interrupted:
            if interrupted.step < 0:
                raise
            self.print_error(str(interrupted))
            halt = self.session.go(interrupted.step)
        self.halted(halt, halt.arrival.step)

    # --- where the plan is ------------------------------------------------------------------------------------------

    def halted(self, halt: Halt, before: int) -> None:
        """Tell where the plan has stopped, and what it has printed since the step where it was before."""
        arrival, step = halt.arrival, halt.arrival.step
        for output in self.log.records(Output, before + 1, step + 1):
            print(visible(output.text))
        for each in halt.met:
            name = f"Breakpoint {each.number}, " if not each.text.startswith("watch") else ""
            change = self._change(each.changes.get(step) or halt.changes.get(each.number))
            print(self.painted(f"{name}{each.text}{change}", "33"))
        if arrival.reason == "interrupted":
            print("--KeyboardInterrupt--")
        if arrival.text:
            self.print_error(f"the plan parts from its recording after step {step}: {arrival.text}")
        self.stack = self.session.plan.ask("where")
        self.frame = self._frame_of(halt)
        self._listed = 0
        self._tell_step(step)
        if self.follow is not None:
            self.follow(step)

    @staticmethod
    def _change(change: Any) -> str:
        if change is None:
            return ""
        before, after = change[-2:]
        texts = [each if isinstance(each, str) else _short(each) for each in (before, after)]
        return f": {texts[0]} -> {texts[1]}"

    def _frame_of(self, halt: Halt) -> int:
        """Return the frame of the line of a breakpoint that was met, else the innermost one."""
        lines = [each.line for each in halt.met if each.line is not None]
        frames = [number for number, each in enumerate(self.stack) if (each["file"], each["line"]) in lines]
        return frames[0] if frames else 0

    def _tell_step(self, step: int) -> None:
        record = self.log[step]
        place = "" if record.thread == _MAIN_THREAD else f"  [{record.thread}]"
        time = f"{record.sim_step / STEPS_PER_SECOND:.3f} s"
        print(
            self.painted(f"step {step} of {len(self.log) - 1}  {time}{place}", "36"),
            visible(f" {kind_of(record)} {record_text.line(record)}"),
        )
        if self.stack:
            self._tell_frame()
        if step == len(self.log) - 1:
            print(visible(f"the recording {_ending(record)}"))

    def _tell_frame(self, number: int | None = None) -> None:
        at = self.frame if number is None else number
        frame = self.stack[at]
        mark = ">" if at == self.frame else " "
        print(visible(f"{mark} {formatting.path(frame['file'])}({frame['line']}){frame['function']}()"))
        text = linecache.getline(frame["file"], frame["line"]).strip()
        if text:
            print(self.painted(f"-> {text}", "1") if at == self.frame else visible(f"-> {text}"))

    def _selected(self) -> dict[str, Any]:
        if not self.stack:
            raise ReplayError("no function of the plan runs at this step")
        return self.stack[self.frame]

    def do_where(self, _: str) -> None:
        """``where`` (w, bt): the plan's frames, the innermost last, as pdb prints them.

        Those of a branch come after those of the code that waits for it.
        """
        self._selected()
        for number in reversed(range(len(self.stack))):
            self._tell_frame(number)

    def do_up(self, count: str) -> None:
        """``up`` (u) [COUNT]: to the frame that called this one."""
        self._move(_number(count))

    def do_down(self, count: str) -> None:
        """``down`` (d) [COUNT]: to the frame that this one called."""
        self._move(-_number(count))

    def _move(self, count: int) -> None:
        self._selected()
        if not 0 <= self.frame + count < len(self.stack):
            raise ReplayError("Oldest frame" if count > 0 else "Newest frame")
        self.frame += count
        self._listed = 0
        self._tell_frame()

    def do_list(self, text: str) -> None:
        """``list`` (l) [. | FIRST[, LAST]]: the source around the current line, then on from there."""
        frame = self._selected()
        given = [int(each) for each in re.findall(r"\d+", text)]
        first = given[0] if given else self._listed if self._listed and text != "." else frame["line"] - _AROUND
        self._list(max(1, first), given[1] if len(given) > 1 else max(1, first) + 2 * _AROUND)

    def do_ll(self, _: str) -> None:
        """``ll``: the source of the current function, or of the file."""
        frame = self._selected()
        lines = linecache.getlines(frame["file"])
        whole = frame["function"] == "<module>"
        count = len(lines) if whole else len(inspect.getblock(lines[frame["first"] - 1 :]))
        self._list(frame["first"], frame["first"] + count - 1)

    def _list(self, first: int, last: int) -> None:
        frame = self._selected()
        lines = linecache.getlines(frame["file"])
        if first > len(lines):
            raise ReplayError("[EOF]" if lines else f"{frame['file']}: there is no source of it")
        broken = {each.line for each in self.session.breakpoints}
        for number in range(first, min(last, len(lines)) + 1):
            marks = f"{'B' if (frame['file'], number) in broken else ' '}{'->' if number == frame['line'] else '  '}"
            print(visible(f"{number:3} {marks}  {lines[number - 1].rstrip()}"))
        self._listed = last + 1

    # --- what is in a frame -----------------------------------------------------------------------------------------

    def do_locals(self, _: str) -> None:
        """``locals``: the variables of the frame."""
        self._tell_variables(arguments=False)

    def do_args(self, _: str) -> None:
        """``args`` (a): the arguments of the frame's function."""
        self._tell_variables(arguments=True)

    def _tell_variables(self, *, arguments: bool) -> None:
        self._selected()
        found = self.session.plan.ask("variables", frame=self.frame, arguments=arguments)
        self.print_lines(f"{name} = {value}" for name, value in found)

    def do_p(self, expression: str) -> None:
        """``p`` EXPR: an expression's value in the frame; what evaluating it changes is undone."""
        self._evaluate(expression, pretty=False)

    def do_pp(self, expression: str) -> None:
        """``pp`` EXPR: an expression's value in the frame, in several lines if it is long."""
        self._evaluate(expression, pretty=True)

    def do_whatis(self, expression: str) -> None:
        """``whatis`` EXPR: an expression's type."""
        self._evaluate(f"type({expression})", pretty=False)

    def _evaluate(self, expression: str, *, pretty: bool) -> None:
        self._selected()
        if _is_statement(expression):
            self.do_shell(expression)
            return
        answer = self.session.plan.ask("evaluate", frame=self.frame, expression=expression, pretty=pretty)
        print(visible(answer["printed"]), end="")
        if "error" in answer:
            self.print_error(answer["error"])
        else:
            print(visible(answer["value"]))

    def do_shell(self, text: str) -> None:
        """! EXPR: its value, also where it begins as a command does; a statement can't be executed.

        The plan is guided by its recording, from which it would part.
        """
        if text and not _is_statement(text):
            self._evaluate(text, pretty=False)
            return
        self.print_error(
            "a statement can't be executed: the plan is guided by its recording, from which it would part; "
            "fork NAME --plan FILE goes on from here with an edited plan"
        )

    def default(self, line: str) -> None:
        """Evaluate what is no command."""
        self.do_p(line)

    do_w = do_bt = do_where
    do_u, do_d, do_l, do_a = do_up, do_down, do_list, do_args


def _ending(last: Record) -> str:
    if not isinstance(last, Run) or last.phase != Run.FINISHED:
        return "was cut here"
    return "ends here" if last.succeeded else f"ends here; the plan failed: {format_failure(last.failure)}"


def _number(text: str) -> int:
    if text and not text.isdecimal():
        raise ReplayError(f"{text}: expected a number of frames")
    return int(text or 1)


def _is_statement(text: str) -> bool:
    if not text:
        return False
    try:
        compile(text, "<prompt>", "eval")
    except SyntaxError:
        try:
            compile(text, "<prompt>", "exec")
        except SyntaxError:
            return False  # evaluating it tells what is wrong
        return True
    except ValueError:
        return False
    return False


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_short, value))}]"
    return formatting.short(str(value))
