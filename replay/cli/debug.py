"""``debug``: a prompt in the plan's frame at a step of a recording; commands move the plan forwards and back.

The commands are those of pdb, and the verbs of ``pycram-replay`` at the present step. Lines come from a terminal or
from a script on stdin.
"""

from __future__ import annotations

import argparse
import ast
import cmd
import contextlib
import inspect
import linecache
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from itertools import chain
from typing import TYPE_CHECKING, Any, Final

from recorder.plan_lines import deciding
from recorder.records import STEPS_PER_SECOND, Output, Run, format_failure
from recorder.system import cache_folder
from recorder.terminal import coloured, has_colours
from replay.cli import main
from replay.cli.console import print_message, visible
from replay.cli.retrace import AGAIN, add_source_and_arguments
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.history.tasks import uncaught_failure
from replay.recording import Recording
from replay.report import phrases
from replay.state.json_data import kind_of

if TYPE_CHECKING:
    from replay.debug.session import Halt, Session

_HISTORY: Final = 1000  # maximum number of lines in the history of commands
_MAIN_THREAD: Final = "MainThread"
_AROUND: Final = 5  # number of lines before and after the current line that ``list`` shows, as in pdb
#: Commands that move the plan (:data:`replay.debug.session.MOVES`), by names.
_MOVES: Final = {
    ("step", "s"): "to the next recorded step.",
    ("rstep", "rs"): "back to the previous recorded step.",
    ("next", "n"): "to the next step on this task level, over the steps inside a task.",
    ("rnext", "rn"): "back to the previous step on this task level.",
    ("return", "r"): "to the end of the current task.",
    ("continue", "c", "cont"): "to the next breakpoint or watched change, or to the end.",
    ("rcontinue", "rc"): "back to the previous breakpoint or watched change, or to the start.",
}
#: Verbs of ``pycram-replay`` that are commands: words before and after the words of the user. "STEP" is replaced by the
#: current step.
_VERBS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "ask": (("STEP",), ()),
    "blame": ((), ("--at", "STEP")),
    "diff": (("STEP",), ()),
    "fork": (("--at", "STEP"), ()),
    "info": ((), ()),
    "log": ((), ()),
    "render": (("STEP",), ()),
    "show": (("STEP",), ()),
    "state": (("STEP",), ()),
    "tree": (("--at", "STEP"), ()),
    "why": ((), ()),
}
_HELP: Final = """\
where (w, bt)  up (u)  down (d)  list (l)  ll     the plan's frames, and their source
locals  args (a)  p EXPR  pp EXPR  whatis EXPR   variables of a frame; an expression alone is evaluated, too
step (s)  next (n)  return (r)  until [STEP]     to the next step; on this level; to the task's end; to a later line
rstep (rs)  rnext (rn)                           the same, backwards
continue (c)  rcontinue (rc)  goto STEP (g)      to the next breakpoint; to the previous breakpoint; to any step
break (b) [STEP | TASK | KIND | FILE:LINE | failure | event NAME]  tbreak  clear [N]  enable N  disable N
watch EXPR  rwatch EXPR                          stop when milk.z, holding(left) or a variable changes; back to a change
state  tree  show  log  ask  blame  why  diff  render  info    verbs of pycram-replay, at this step
view                                             show the Rerun viewer, which follows each step
fork [NAME] [--plan FILE]                        continue live from here, into a new recording
help (h) [COMMAND]  quit (q)"""


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "The commands are those of pdb; type help for a list. A script on stdin can contain commands, too."
    parser.add_argument("step", metavar="STEP", nargs="?", help=f"first step (default: the failure, or 0): {HINT}")
    parser.add_argument("--plan", metavar="FILE", help="the plan's file, if it was moved after the recording")
    parser.add_argument("--no-checkpoints", action="store_true", help="run the plan again from its start to step back")
    parser.add_argument("--dap", action="store_true", help="serve an editor by the Debug Adapter Protocol")
    parser.add_argument("--port", type=int, help="with --dap: listen on this port of this machine (0: any port)")
    add_source_and_arguments(parser)


def run(log: Recording, options: argparse.Namespace) -> None:
    from replay.debug.guided_plan import GuidedPlan  # noqa: PLC0415  needs the executor
    from replay.debug.session import Session  # noqa: PLC0415  as above
    from replay.retrace.plan_process import PlanProcess  # noqa: PLC0415  as above

    if options.json:
        raise ReplayError("debug prints text only; use another verb with --json")
    step = first_step(log, options.step)
    process = PlanProcess(log, options.plan, options.arguments, recorded_source=options.recorded_source)
    with GuidedPlan(process, checkpoints=not options.no_checkpoints) as plan:
        session = Session(log, plan)
        print_message(f"the plan runs again up to step {min(step, plan.last)}; {AGAIN}")
        for note in plan.notes:
            print_message(f"note: {note}")
        if step > plan.last:
            print_message(f"the plan reached only step {plan.last}: {plan.parted}")
        prompt = Prompt(session)
        prompt.begin(min(step, plan.last))
        prompt.run()


def first_step(log: Recording, step: int | str | None) -> int:
    """Return the number of a step; by default, of the failure's step, or 0 if the plan didn't fail."""
    from replay.retrace.plan_process import last_own_step  # noqa: PLC0415  needs the executor

    if step is not None:
        return log.step(step)
    return min(log.step("failure" if uncaught_failure(log) is not None else 0), last_own_step(log))


class Prompt(cmd.Cmd):
    """A prompt in the plan's frames. Commands come from a terminal or from stdin. Lines from stdin are echoed."""

    prompt = "(debug) "

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self.log = session.log  # the recording
        self.stack: list[dict[str, Any]] = []  # the plan's frames, innermost first
        self.frame = 0  # index of the chosen frame; 0 is the innermost frame
        self._listed = 0  # the line after the last line that ``list`` has shown; 0 before the first ``list``
        self.follow: Callable[[int], None] | None = None  # moves the viewer to a step; None without a viewer
        self._asks = self.use_rawinput = sys.stdin.isatty()
        self._coloured = has_colours(sys.stdout)
        for file, source in session.plan.recorded_files.items():  # the files on the disk may differ
            lines = source.decode("utf-8", "replace").splitlines(keepends=True)
            linecache.cache[str(file)] = len(source), None, lines, str(file)

    def run(self) -> None:
        """Execute commands until the end of the input, or ``quit``."""
        with self._history():
            while True:
                try:
                    self.cmdloop()
                except KeyboardInterrupt:
                    print("--KeyboardInterrupt--")
                else:
                    return

    @contextlib.contextmanager
    def _history(self) -> Iterator[None]:
        folder = cache_folder()
        if folder is None or not self._asks or find_spec("readline") is None:  # some systems lack readline
            yield
            return
        import readline  # noqa: PLC0415

        file = folder / "debug_history"
        with contextlib.suppress(OSError):
            readline.read_history_file(file)
        readline.set_history_length(_HISTORY)
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                readline.write_history_file(file)

    # --- lines ------------------------------------------------------------------------------------------------------

    def precmd(self, line: str) -> str:
        """Split a line at ``;;``, as pdb does, and echo lines of a script."""
        if not self._asks:
            print("" if line == "EOF" else visible(line.rstrip("\n")))
        first, separator, rest = line.partition(";;")
        if separator:
            self.cmdqueue.insert(0, rest.strip())
        return "" if first.lstrip().startswith("#") else first.strip()

    def onecmd(self, line: str) -> bool:
        """Execute a command; mistakes of the user are printed."""
        try:
            return bool(super().onecmd(line))
        except ReplayError as error:
            self.print_error(str(error))
        except SystemExit:  # the parser has already printed a message about wrong arguments
            pass
        except KeyboardInterrupt:
            print("--KeyboardInterrupt--")
        finally:
            sys.stdout.flush()
        return False

    def emptyline(self) -> bool:
        """At a terminal, repeat the last command, as pdb does. In a script, an empty line does nothing."""
        return bool(self._asks and self.lastcmd and self.onecmd(self.lastcmd))

    # --- output ------------------------------------------------------------------------------------------------------

    def print_error(self, text: str) -> None:
        """Print a mistake of the user."""
        print(self.painted(f"*** {text}", "red"))

    def painted(self, text: str, colour: str) -> str:
        """Return a text in a colour, or the plain text if there is no terminal."""
        return coloured(visible(text), colour) if self._coloured else visible(text)

    # --- the current step ---------------------------------------------------------------------------------------------

    def begin(self, step: int) -> None:
        """Go to a step. If Ctrl-C ends the plan before the step, go to the step of the interrupt."""
        from replay.debug.guided_plan import PlanInterrupted  # noqa: PLC0415  needs the executor

        try:
            halt = self.session.go(step)
        except PlanInterrupted as interrupted:
            if interrupted.step < 0:
                raise
            self.print_error(str(interrupted))
            halt = self.session.go(interrupted.step)
        self.halted(halt)

    def halted(self, halt: Halt, before: int | None = None) -> None:
        """Print the current step, and the plan's output since the step ``before``; with None, no output."""
        arrival, step = halt.arrival, halt.arrival.step
        for output in self.log.records(Output, before + 1, step + 1) if before is not None else ():
            print(visible(output.text))
        for each in halt.met:
            name = f"Breakpoint {each.number}, " if not each.text.startswith("watch") else ""
            change = self._change(each.changes.get(step) or halt.changes.get(each.number))
            print(self.painted(f"{name}{each.text}{change}", "yellow"))
        if arrival.reason == "interrupted":
            print("--KeyboardInterrupt--")
        if arrival.text:
            self.print_error(f"the plan differs from its recording after step {step}: {arrival.text}")
        self.stack = self.session.plan.ask("where")
        lines = [each.line for each in halt.met if each.line is not None]
        stopped = [number for number, each in enumerate(self.stack) if (each["file"], each["line"]) in lines]
        self.frame = stopped[0] if stopped else deciding([(each["file"], each["line"]) for each in self.stack])
        self._listed = 0
        record = self.log[step]
        place = "" if record.thread == _MAIN_THREAD else f"  [{record.thread}]"
        time = f"{record.sim_step / STEPS_PER_SECOND:.3f} s"
        print(
            self.painted(f"step {step} of {len(self.log) - 1}  {time}{place}", "cyan"),
            visible(f" {kind_of(record)} {phrases.record_line(record)}"),
        )
        if self.stack:
            self._print_frame()
        if step == len(self.log) - 1:
            end = record if isinstance(record, Run) and record.phase == Run.FINISHED else None
            failed = f"; the plan failed: {format_failure(end.failure)}" if end and not end.succeeded else ""
            print(visible(f"the recording {'ends' if end else 'was cut'} here{failed}"))
        if self.follow is not None:
            self.follow(step)

    @staticmethod
    def _change(change: Any) -> str:
        if change is None:
            return ""
        before, after = (each if isinstance(each, str) else _short(each) for each in change[-2:])
        return f": {before} -> {after}"

    def _print_frame(self, number: int | None = None) -> None:
        at = self.frame if number is None else number
        frame = self.stack[at]
        mark = ">" if at == self.frame else " "
        print(visible(f"{mark} {phrases.path(frame['file'])}({frame['line']}){frame['function']}()"))
        text = linecache.getline(frame["file"], frame["line"]).strip()
        if text:
            print(self.painted(f"-> {text}", "bold") if at == self.frame else visible(f"-> {text}"))

    def _selected(self) -> dict[str, Any]:
        if not self.stack:
            raise ReplayError("no function of the plan runs at this step")
        return self.stack[self.frame]

    def do_where(self, _: str) -> None:
        """``where`` (w, bt): the plan's frames, the innermost last, as pdb prints them.

        Frames of a branch come after the frames of the code that waits for the branch.
        """
        self._selected()
        for number in reversed(range(len(self.stack))):
            self._print_frame(number)

    def do_up(self, count: str) -> None:
        """``up`` (u) [COUNT]: to the caller's frame."""
        self._move(_number(count))

    def do_down(self, count: str) -> None:
        """``down`` (d) [COUNT]: to the called frame."""
        self._move(-_number(count))

    def _move(self, count: int) -> None:
        self._selected()
        if not 0 <= self.frame + count < len(self.stack):
            raise ReplayError("Oldest frame" if count > 0 else "Newest frame")
        self.frame += count
        self._listed = 0
        self._print_frame()

    def do_list(self, text: str) -> None:
        """``list`` (l) [. | FIRST[, LAST]]: the source around the current line; if repeated, the next lines."""
        frame = self._selected()
        given = [int(each) for each in re.findall(r"\d+", text)]
        first = given[0] if given else self._listed if self._listed and text != "." else frame["line"] - _AROUND
        self._list(max(1, first), given[1] if len(given) > 1 else max(1, first) + 2 * _AROUND)

    def do_ll(self, _: str) -> None:
        """``ll``: the source of the current function, or of the file."""
        frame = self._selected()
        lines = linecache.getlines(frame["file"])
        count = len(lines) if frame["function"] == "<module>" else len(inspect.getblock(lines[frame["first"] - 1 :]))
        self._list(frame["first"], frame["first"] + count - 1)

    def _list(self, first: int, last: int) -> None:
        frame = self._selected()
        lines = linecache.getlines(frame["file"])
        if first > len(lines):
            raise ReplayError("[EOF]" if lines else f"{frame['file']}: its source is missing")
        broken = {each.line for each in self.session.breakpoints}
        for number in range(first, min(last, len(lines)) + 1):
            marks = f"{'B' if (frame['file'], number) in broken else ' '}{'->' if number == frame['line'] else '  '}"
            print(visible(f"{number:3} {marks}  {lines[number - 1].rstrip()}"))
        self._listed = last + 1

    # --- variables of a frame ---------------------------------------------------------------------------------------

    def do_locals(self, _: str) -> None:
        """``locals``: the variables of the frame."""
        self._print_variables(arguments=False)

    def do_args(self, _: str) -> None:
        """``args`` (a): the arguments of the frame's function."""
        self._print_variables(arguments=True)

    def _print_variables(self, *, arguments: bool) -> None:
        self._selected()
        for each in self.session.plan.ask("variables", frame=self.frame, arguments=arguments):
            print(visible(f"{each['name']} = {each['value']}"))

    def do_p(self, expression: str) -> None:
        """``p`` EXPR: an expression's value in the frame; changes that the evaluation makes are undone."""
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
        """``!`` EXPR: the value of an expression that looks like a command; a statement can't be executed.

        After a statement, the plan would differ from the recording that guides it.
        """
        if text and not _is_statement(text):
            self._evaluate(text, pretty=False)
            return
        self.print_error(
            "a statement can't be executed: it would make the plan differ from the recording that guides it; "
            "fork NAME --plan FILE continues from here with an edited plan"
        )

    def default(self, line: str) -> None:
        """Evaluate a line that isn't a command."""
        self.do_p(line)

    do_w = do_bt = do_where
    do_u, do_d, do_l, do_a = do_up, do_down, do_list, do_args

    # --- from step to step ------------------------------------------------------------------------------------------

    def move(self, name: str, _: str) -> None:
        """Execute a command that moves the plan."""
        from replay.debug.session import MOVES  # noqa: PLC0415  needs the executor

        before = self.session.step
        self.halted(MOVES[name](self.session), before)

    def do_until(self, step: str) -> None:
        """``until`` (unt) [STEP]: forwards to a step; without a step, to a later line, for example out of a loop."""
        timeline, now = self.session.timeline, self.session.step
        target = self.log.step(step) if step else timeline.onwards(now)
        if target <= now:
            raise ReplayError(f"step {target} isn't after the current step; use goto")
        self.halted(self.session.forward(target), now)

    def do_goto(self, step: str) -> None:
        """``goto`` (g) STEP: to any step, forwards or back; breakpoints are ignored."""
        self.halted(self.session.go(self.log.step(step)))

    # --- breakpoints ------------------------------------------------------------------------------------------------

    def do_break(self, place: str) -> None:
        """``break`` (b) [STEP | TASK | KIND | FILE:LINE | failure | event [NAME]]: stop there, or list all.

        A task is a path of names, such as par/moving or pick-up. Kinds are motion, attempt, block and so on.
        """
        if place:
            self._set_break(place)
            return
        for each in self.session.breakpoints:
            state = f"{'' if each.enabled else ' (disabled)'}{' (once)' if each.temporary else ''}"
            print(visible(f"{each.number:3}  {each.text}{state}: {each.counted}"))

    def do_tbreak(self, place: str) -> None:
        """``tbreak`` PLACE: a breakpoint that is deleted when it has stopped the plan."""
        self._set_break(place, temporary=True)

    def _set_break(self, place: str, *, temporary: bool = False) -> None:
        made = self.session.set_break(place, temporary=temporary)
        print(visible(f"Breakpoint {made.number}: {made.text}: {made.counted}"))

    def do_watch(self, expression: str) -> None:
        """``watch`` EXPR: stop when milk.z, holding(left), distance(pr2, milk) < 1 or a variable changes."""
        made = self.session.set_watch(expression, self.frame)
        print(visible(f"Watch {made.number}: {expression}: {made.counted}"))

    def do_rwatch(self, expression: str) -> None:
        """``rwatch`` EXPR: go back to the last change of an expression's value."""
        self.halted(self.session.back_to_change(expression, self.frame))

    def do_clear(self, numbers: str) -> None:
        """``clear`` (cl) [NUMBER ...]: remove breakpoints and watches; without a number, all."""
        for each in self._numbered(numbers) if numbers else list(self.session.breakpoints):
            self.session.breakpoints.remove(each)
            print(f"Deleted {each.number}: {visible(each.text)}")

    def do_enable(self, numbers: str) -> None:
        """``enable`` NUMBER ...: let breakpoints stop the plan again."""
        for each in self._numbered(numbers):
            each.enabled = True

    def do_disable(self, numbers: str) -> None:
        """``disable`` NUMBER ...: keep breakpoints, without stopping the plan."""
        for each in self._numbered(numbers):
            each.enabled = False

    def _numbered(self, numbers: str) -> list[Any]:
        return [self.session.numbered(each) for each in numbers.split()]

    # --- the recording at this step -----------------------------------------------------------------------------------

    def call_verb(self, name: str, text: str) -> None:
        """Run a verb at the current step."""
        given = _words(text)
        if name == "ask" and text and not text.startswith("-"):
            question, option, rest = text.partition(" --")
            given = [question.strip(), *_words(option + rest)]
        if name == "fork" and given and not given[0].startswith("-"):
            given.insert(0, "-o")
        if name == "fork" and self.session.plan.recorded_files and "--plan" not in given:
            given.insert(0, "--recorded-source")
        before, after = _VERBS[name]
        step = str(self.session.step)
        main.call(name, self.log, [step if each == "STEP" else each for each in chain(before, given, after)])

    def do_view(self, text: str) -> None:
        """``view`` [--connect URL]: show the recording in the Rerun viewer, which follows each step."""
        from replay.view import follow  # noqa: PLC0415  imported here: the viewer's library may be missing

        viewer, self.follow = follow(self.log, self.session.step, _words(text)[-1] if text else None)
        print_message(f"the viewer at {viewer} follows each step")

    # --- help and end ------------------------------------------------------------------------------------------------

    def do_help(self, command: str) -> None:
        """``help`` (h) [COMMAND]: what a command does; without a command, the list of commands."""
        if not command:
            print(_HELP)
            return
        text = getattr(self, f"do_{command}", None)
        if text is None:
            raise ReplayError(f"there is no command {command}; help lists the commands")
        print("\n".join(line.strip() for line in (text.__doc__ or "").replace("``", "").strip().splitlines()))

    def do_quit(self, _: str) -> bool:
        """``quit`` (q, exit): end the debugger."""
        return True

    def do_EOF(self, _: str) -> bool:  # noqa: N802  cmd.Cmd expects this name
        """The end of the input: end the debugger."""
        if self._asks:
            print()
        return True

    # --- completion -------------------------------------------------------------------------------------------------

    def completenames(self, text: str, *_: Any) -> list[str]:
        """Complete commands."""
        return [name for name in super().completenames(text) if name not in ("EOF", "shell")]

    def completedefault(self, text: str, *_: Any) -> list[str]:
        """Complete an expression in the frame."""
        if not self.stack:
            return []
        found: list[str] = self.session.plan.ask("complete", frame=self.frame, text=text)
        return found

    def complete_break(self, text: str, *_: Any) -> list[str]:
        """Complete the name of a task or an event."""
        timeline = self.session.timeline
        return _beginning(text, (*timeline.names, *timeline.events, "failure", "event"))

    def complete_watch(self, text: str, *rest: Any) -> list[str]:
        """Complete the name of a quantity."""
        from replay.debug.session import quantity_names  # noqa: PLC0415  as above

        return _beginning(text, quantity_names(self.log, self.session.step)) or self.completedefault(text, *rest)

    def complete_state(self, text: str, *_: Any) -> list[str]:
        """Complete the name of an object."""
        worlds = self.log.state_at(self.session.step).worlds.values()
        return _beginning(text, (name for world in worlds for name in world.bodies))

    complete_tbreak = complete_break
    complete_rwatch = complete_watch
    complete_blame = complete_state

    do_unt, do_g, do_b, do_cl, do_h = do_until, do_goto, do_break, do_clear, do_help
    do_q = do_exit = do_quit
    complete_b = complete_break


def _add_command(names: tuple[str, ...], text: str, method: Callable[[Prompt, str, str], None]) -> None:
    def do(self: Prompt, argument: str) -> None:
        method(self, names[0], argument)

    do.__doc__ = f"{', '.join(names)}: {text}"
    for name in names:
        setattr(Prompt, f"do_{name}", do)


for _names, _text in _MOVES.items():
    _add_command(_names, _text, Prompt.move)
for _name in _VERBS:
    _text = f"{main.VERBS[_name]}; by default, at this step. See pycram-replay {_name} --help."
    _add_command((_name,), _text, Prompt.call_verb)


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise ReplayError(f"{text}: {error}") from None


def _beginning(text: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(text)})


def _number(text: str) -> int:
    if text and not text.isdecimal():
        raise ReplayError(f"{text}: expected a number of frames")
    return int(text or 1)


def _is_statement(text: str) -> bool:
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError):
        return False  # evaluating the expression later reports the error
    return list(map(type, body)) not in ([], [ast.Expr])


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return f"[{', '.join(map(_short, value))}]" if isinstance(value, tuple | list) else phrases.short(str(value))
