"""The debugger's commands: pdb's, on the steps of a recording, and those of ``pycram-replay`` at the step."""

from __future__ import annotations

import shlex
from itertools import chain
from typing import TYPE_CHECKING, Any, Final

from replay.cli import main
from replay.cli.console import print_message, visible
from replay.cli.debug_frames import FramesPrompt
from replay.debug.expressions import quantity_names
from replay.debug.session import breakpoint_of
from replay.errors import ReplayError

if TYPE_CHECKING:
    from collections.abc import Iterable


#: Verbs of ``pycram-replay`` as commands: what stands before and after what is typed; "STEP" is where the plan is.
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
locals  args (a)  p EXPR  pp EXPR  whatis EXPR   what is in a frame; an expression alone is evaluated, too
step (s)  next (n)  return (r)  until [STEP]     to the next step; on this task level; to the end of the task
rstep (rs)  rnext (rn)                           the same, backwards
continue (c)  rcontinue (rc)  goto STEP (g)      to the next breakpoint; to the one before; to any step
break (b) [STEP | TASK | KIND | FILE:LINE | failure | event NAME]  tbreak  clear [N]  enable N  disable N
watch EXPR  rwatch EXPR                          milk.z, holding(left), a variable: where it changes; where it last did
state  tree  show  log  ask  blame  why  diff  render  info    as pycram-replay has them, at this step
view                                             the Rerun viewer, which follows from now on
fork [NAME] [--plan FILE]                        on from here, live, into a recording of its own
help (h) [COMMAND]  quit (q)"""


class Prompt(FramesPrompt):
    """The prompt of a session; see :class:`FramesPrompt`."""

    # --- from step to step ------------------------------------------------------------------------------------------

    def _forward(self, target: int | None) -> None:
        before = self.session.step
        self.halted(self.session.forward(target), before)

    def _back(self, target: int) -> None:
        halt = self.session.back(target)
        self.halted(halt, halt.arrival.step)

    def do_step(self, _: str) -> None:
        """``step`` (s): to the next recorded step."""
        self._forward(self.session.step + 1)

    def do_rstep(self, _: str) -> None:
        """``rstep`` (rs): back to the recorded step before."""
        self._back(self.session.step - 1)

    def do_next(self, _: str) -> None:
        """``next`` (n): to the next step on this task level: over what a task does."""
        self._forward(self.session.timeline.following(self.session.step))

    def do_rnext(self, _: str) -> None:
        """``rnext`` (rn): back to the step before on this task level."""
        self._back(self.session.timeline.preceding(self.session.step))

    def do_return(self, _: str) -> None:
        """``return`` (r): to the end of the task that this step is in."""
        self._forward(self.session.timeline.end(self.session.step))

    def do_until(self, step: str) -> None:
        """``until`` (unt) [STEP]: on to a step; without one to a later line, out of a loop."""
        timeline, now = self.session.timeline, self.session.step
        target = self.log.step(step) if step else timeline.onwards(now)
        if target <= now:
            raise ReplayError(f"step {target} is not after this one; goto goes there")
        self._forward(target)

    def do_continue(self, _: str) -> None:
        """``continue`` (c, cont): to the next breakpoint or change of what is watched, else to the end."""
        self._forward(None)

    def do_rcontinue(self, _: str) -> None:
        """``rcontinue`` (rc): back to the breakpoint or change before, else to the start."""
        self._back(0)

    def do_goto(self, step: str) -> None:
        """``goto`` (g) STEP: to any step, forwards or back, whatever is on the way."""
        halt = self.session.go(self.log.step(step))
        self.halted(halt, halt.arrival.step)

    # --- breakpoints ------------------------------------------------------------------------------------------------

    def do_break(self, place: str) -> None:
        """``break`` (b) [STEP | TASK | KIND | FILE:LINE | failure | event [NAME]]: stop there; without one list all.

        A task is a path of names, as par/moving or pick-up; a kind is motion, attempt, block and so on.
        """
        if place:
            self._tell_set(place, temporary=False)
            return
        for each in self.session.breakpoints:
            state = f"{'' if each.enabled else ' (disabled)'}{' (once)' if each.temporary else ''}"
            self.print_lines([f"{each.number:3}  {each.text}{state}: {each.counted}"])

    def do_tbreak(self, place: str) -> None:
        """``tbreak`` PLACE: a breakpoint that ends when it has stopped the plan."""
        self._tell_set(place, temporary=True)

    def _tell_set(self, place: str, *, temporary: bool) -> None:
        made = self.session.set_break(place, temporary=temporary)
        self.print_lines([f"Breakpoint {made.number}: {made.text}: {made.counted}"])

    def do_watch(self, expression: str) -> None:
        """``watch`` EXPR: stop where its value changes: milk.z, holding(left), distance(pr2, milk) < 1, a variable."""
        made = self.session.set_watch(expression, self.frame)
        self.print_lines([f"Watch {made.number}: {expression}: {made.counted}"])

    def do_rwatch(self, expression: str) -> None:
        """``rwatch`` EXPR: back to where its value last changed."""
        halt = self.session.back_to_change(expression, self.frame)
        self.halted(halt, halt.arrival.step)

    def do_clear(self, numbers: str) -> None:
        """``clear`` (cl) [NUMBER ...]: remove breakpoints and watches; without a number all."""
        for each in self._numbered(numbers) if numbers else list(self.session.breakpoints):
            self.session.breakpoints.remove(each)
            print(f"Deleted {each.number}: {visible(each.text)}")

    def do_enable(self, numbers: str) -> None:
        """``enable`` NUMBER ...: have breakpoints stop the plan again."""
        for each in self._numbered(numbers):
            each.enabled = True

    def do_disable(self, numbers: str) -> None:
        """``disable`` NUMBER ...: have breakpoints not stop the plan."""
        for each in self._numbered(numbers):
            each.enabled = False

    def _numbered(self, numbers: str) -> list[Any]:
        return [breakpoint_of(self.session.breakpoints, each) for each in numbers.split()]

    # --- the recording at this step -----------------------------------------------------------------------------------

    def _verb(self, name: str, text: str) -> None:
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
        arguments = [step if each == "STEP" else each for each in chain(before, given, after)]
        main.call(name, self.log, arguments)

    def do_view(self, text: str) -> None:
        """``view`` [--connect URL]: show the recording in the Rerun viewer, at this step; it follows from now on."""
        from replay.view.rrd import follow  # noqa: PLC0415  needs the viewer's library

        url = _words(text)[-1] if text else None
        viewer, self.follow = follow(self.log, self.session.step, url)
        print_message(f"the viewer at {viewer} follows")

    # --- help, end --------------------------------------------------------------------------------------------------

    def do_help(self, command: str) -> None:
        """``help`` (h) [COMMAND]: what a command does; without one, which there are."""
        if not command:
            print(_HELP)
            return
        text = getattr(self, f"do_{command}", None)
        if text is None:
            raise ReplayError(f"there is no command {command}")
        print("\n".join(line.strip() for line in (text.__doc__ or "").replace("``", "").strip().splitlines()))

    def do_quit(self, _: str) -> bool:
        """``quit`` (q, exit): end the debugger."""
        return True

    def do_EOF(self, _: str) -> bool:  # noqa: N802  as cmd calls it
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

    def _complete_place(self, text: str, *_: Any) -> list[str]:
        timeline = self.session.timeline
        names = {*timeline.kinds.values(), *(path[-1] for path in timeline.paths.values()), *timeline.events}
        return _beginning(text, (*names, "failure", "event"))

    def _complete_quantity(self, text: str, *rest: Any) -> list[str]:
        found = _beginning(text, quantity_names(self.log, self.session.step))
        return found or self.completedefault(text, *rest)

    def _complete_object(self, text: str, *_: Any) -> list[str]:
        worlds = self.log.state_at(self.session.step).worlds.values()
        return _beginning(text, (name for world in worlds for name in world.bodies))

    complete_break = complete_tbreak = _complete_place
    complete_watch = complete_rwatch = _complete_quantity
    complete_state = complete_blame = _complete_object

    do_s, do_n, do_r, do_unt = do_step, do_next, do_return, do_until
    do_c = do_cont = do_continue
    do_rs, do_rn, do_rc, do_g = do_rstep, do_rnext, do_rcontinue, do_goto
    do_b, do_cl, do_h = do_break, do_clear, do_help
    do_q = do_exit = do_quit
    complete_b = complete_break


def _add_verb(name: str) -> None:
    """Make a verb of ``pycram-replay`` a command."""

    def do(self: Prompt, text: str) -> None:
        self._verb(name, text)

    do.__doc__ = f"``{name}``: {main.VERBS[name]}, at this step; as pycram-replay {name} --help tells."
    setattr(Prompt, f"do_{name}", do)


for _name in _VERBS:
    _add_verb(_name)


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise ReplayError(f"{text}: {error}") from None


def _beginning(text: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(text)})
