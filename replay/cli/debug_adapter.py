"""``debug --dap``: a server for the Debug Adapter Protocol, by which an editor controls the debugger.

The main thread executes the editor's requests in order. A second thread reads the requests, so that ``pause`` and
``disconnect`` reach a plan while it runs. See https://microsoft.github.io/debug-adapter-protocol/specification.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, BinaryIO, Final, TypeAlias, cast

from recorder.records import Failure, Output, Query, Task, argument_values
from replay.cli import main
from replay.cli.console import print_message, visible
from replay.cli.debug import Prompt, first_step
from replay.debug.guided_plan import GuidedPlan, PlanEnded
from replay.debug.session import MOVES, Halt, Session, breakpoint_at
from replay.errors import NoSuchName, ReplayError
from replay.recording import Recording
from replay.report import phrases
from replay.retrace.plan_process import PlanProcess
from replay.state.state import Body, World

if TYPE_CHECKING:
    _Lister = Callable[[], Iterable["_Variable"]]

Message: TypeAlias = "dict[str, Any]"

_STDIN, _STDOUT = 0, 1
_LOOPBACK: Final = "127.0.0.1"
_THREAD: Final = 1  # the editor sees one thread for all branches, because only one branch runs at a time
_FAILURES: Final = "failure"  # name of the filter for exception breakpoints
_TASK_FRAMES: Final = 1_000_000  # smallest id of a frame that represents a task
_CAPABILITIES: Final = {
    **dict.fromkeys(
        (
            "supportsConfigurationDoneRequest", "supportsFunctionBreakpoints", "supportsDataBreakpoints",
            "supportsEvaluateForHovers", "supportsStepBack", "supportsGotoTargetsRequest",
            "supportsCompletionsRequest", "supportsExceptionInfoRequest", "supportsTerminateRequest",
        ),
        True,
    ),
    "exceptionBreakpointFilters": [{"filter": _FAILURES, "label": "Failures", "default": False}],
}  # fmt: skip
#: The protocol's names for the reasons of stops.
_LINE, _TASK, _DATA, _EXCEPTION = "breakpoint", "function breakpoint", "data breakpoint", "exception"
#: Requests that move the plan, and the moves (:data:`replay.debug.session.MOVES`).
_MOVES: Final = {
    "continue": "continue",
    "reverseContinue": "rcontinue",
    "next": "next",
    "stepIn": "step",
    "stepOut": "return",
    "stepBack": "rnext",
}


def serve(port: int | None, recording: str | None = None) -> None:
    """Serve an editor on stdin and stdout, or on a port of this machine.

    With port 0, a free port is chosen, and printed on stderr. If the editor doesn't name a recording, ``recording`` is
    debugged.
    """
    if port is None:
        # a thread that reads sys.stdin would still hold the lock of sys.stdin when Python ends
        reading, writing = os.fdopen(os.dup(_STDIN), "rb"), os.fdopen(os.dup(_STDOUT), "wb")
        os.dup2(sys.stderr.fileno(), _STDOUT)  # native code and verbs print to this file descriptor
        Adapter(reading, writing, recording).run()
        return
    with socket.create_server((_LOOPBACK, port)) as listening:
        print_message(f"waiting for an editor on port {listening.getsockname()[1]}")
        connected, _ = listening.accept()
    with connected, connected.makefile("rb") as reading, connected.makefile("wb") as writing:
        Adapter(cast("BinaryIO", reading), cast("BinaryIO", writing), recording).run()
        with contextlib.suppress(OSError):  # the editor may have closed the connection
            connected.shutdown(socket.SHUT_RDWR)  # this ends the thread that reads the requests


@dataclass(slots=True)
class _Variable:
    """A variable in an editor's list. The function ``parts`` returns the parts of the variable's value."""

    name: str
    value: str
    type: str = ""
    expression: str = ""  # expression for the value in the plan's frame
    watched: str = ""  # expression for the value in recorded states
    parts: _Lister | None = None


class Adapter:
    """The server of an editor's requests about a plan."""

    def __init__(self, reading: BinaryIO, writing: BinaryIO, recording: str | None = None) -> None:
        self._reading = reading
        self._writing = writing
        self._given = recording
        self._requests: SimpleQueue[Message | None] = SimpleQueue()
        self._sent = 0
        self._open = contextlib.ExitStack()  # recording, plan
        self._prompt: Prompt | None = None
        self._client: Message = {}  # the editor's capabilities
        self._start = 0  # first step at which the plan will stop
        self._then: Callable[[], None] | None = None  # a function that is called after the response
        self._recording: subprocess.Popen[str] | None = None  # the process that records a plan for this session
        self._ending = False  # whether the editor has disconnected
        self._numbers: dict[int, str] = {}  # kinds of breakpoints by number
        self._lists: list[_Lister] = []  # functions that list variables, which an editor may unfold
        self._listed: dict[tuple[int, str], _Variable] = {}

    def run(self) -> None:
        """Answer requests until the editor disconnects."""
        threading.Thread(target=self._read, daemon=True).start()
        with contextlib.suppress(BrokenPipeError), self._open:  # the editor's process may have ended
            while (request := self._requests.get()) is not None:
                self._answer(request)
                if request.get("command") == "disconnect":
                    break

    # --- messages ---------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        """Queue requests. Some requests also stop the running plan."""
        while (request := _message(self._reading)) is not None:
            if request.get("command") == "pause":
                if self._recording is not None:
                    self._recording.send_signal(signal.SIGINT)
                if self._prompt is not None:
                    self._prompt.session.plan.copies.pause_wanted = True
            elif request.get("command") in ("disconnect", "terminate"):
                self._end()
            self._requests.put(request)
        self._end()
        self._requests.put(None)

    def _end(self) -> None:
        self._ending = True
        if self._recording is not None:
            self._recording.terminate()
        if self._prompt is not None:
            self._prompt.session.plan.copies.killed = True

    def _send(self, kind: str, **content: object) -> None:
        self._sent += 1
        text = json.dumps({"seq": self._sent, "type": kind, **content}).encode()
        self._writing.write(b"Content-Length: %d\r\n\r\n%b" % (len(text), text))
        self._writing.flush()

    def _event(self, name: str, **body: object) -> None:
        self._send("event", event=name, body=body)

    def _output(self, text: str, category: str = "console") -> None:
        if text:
            self._event("output", category=category, output=visible(text))

    def _answer(self, request: Message) -> None:
        command, given = str(request.get("command")), request.get("arguments") or {}
        answered = {"request_seq": request.get("seq", 0), "command": command}
        self._then = None
        try:
            body = getattr(self, f"_on_{command}", partial(self._on_other, command))(given)
        except (ReplayError, KeyboardInterrupt) as error:  # a pause during an evaluation raises KeyboardInterrupt
            text = str(error) or "interrupted"
            plain = text.replace("{", "(").replace("}", ")")  # the protocol replaces {variables} in messages
            facts = {"error": {"id": 1, "format": plain, "showUser": command in ("launch", "attach")}}
            self._send("response", success=False, message=text, body=facts, **answered)
            return
        self._send("response", success=True, body=body or {}, **answered)
        if self._then is not None:
            self._then()

    @property
    def _session(self) -> Session:
        return self._at_prompt.session

    @property
    def _at_prompt(self) -> Prompt:
        if self._prompt is None:
            raise ReplayError("nothing was launched")
        return self._prompt

    # --- begin and end ----------------------------------------------------------------------------------------------

    def _on_initialize(self, arguments: Message) -> Message:
        self._client = arguments
        return _CAPABILITIES

    def _on_launch(self, arguments: Message) -> None:
        """Open a recording (``recording``), or first record a plan (``program``, ``args``, ``log``)."""
        program = arguments.get("program")
        recording = arguments.get("recording") or (None if program else self._given)
        if not recording and not program:
            raise ReplayError("launch: give 'recording' (a file), or 'program' (a plan that is recorded first)")
        if not recording:
            recording = self._recorded(str(program), list(arguments.get("args", ())), arguments.get("log"))
        log = self._open.enter_context(Recording(recording))
        step = first_step(log, arguments.get("step"))
        source = bool(arguments.get("recordedSource"))
        process = PlanProcess(log, arguments.get("plan"), arguments.get("arguments"), recorded_source=source)
        plan = self._open.enter_context(GuidedPlan(process))
        self._start = min(step, plan.last)
        self._prompt = Prompt(Session(log, plan))
        self._output("".join(f"note: {each}\n" for each in plan.notes))
        self._then = partial(self._event, "initialized")

    _on_attach = _on_launch

    def _recorded(self, program: str, arguments: Sequence[str], log: str | None) -> str:
        if not Path(program).is_file():
            raise ReplayError(f"{program}: there is no such plan")
        file = log or str(Path(tempfile.mkdtemp(prefix="pycram-debug-")) / f"{Path(program).stem}.mcap")
        command = [sys.executable, "-m", "pycram", "run", program, "--log", file, "--overwrite", *arguments]
        with self._progress(f"recording {Path(program).name}"):
            self._recording = subprocess.Popen(  # noqa: S603  the user has chosen the plan
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
            if self._ending:
                self._recording.terminate()
            with self._recording as process:
                for line in process.stdout or ():
                    self._output(line, "stdout")
        self._recording = None
        if not Path(file).is_file():
            raise ReplayError(f"{program}: the plan left no recording; see its output")
        return file

    def _on_configurationDone(self, _: Message) -> None:  # noqa: N802  the protocol defines this name and the names below
        move = partial(self._session.go, self._start)
        self._then = partial(self._move, move, "entry", f"running the plan up to step {self._start}")

    def _on_disconnect(self, _: Message) -> None:
        """Do nothing, because the thread that reads requests has already ended the plan."""

    def _on_terminate(self, _: Message) -> None:
        self._then = partial(self._event, "terminated")

    # --- breakpoints ------------------------------------------------------------------------------------------------

    def _on_setBreakpoints(self, arguments: Message) -> Message:  # noqa: N802
        file = _file(arguments)
        return self._set(_LINE, [f"{file}:{each['line']}" for each in arguments.get("breakpoints", ())], file)

    def _on_setFunctionBreakpoints(self, arguments: Message) -> Message:  # noqa: N802
        return self._set(_TASK, [each["name"] for each in arguments["breakpoints"]])

    def _on_setExceptionBreakpoints(self, arguments: Message) -> Message:  # noqa: N802
        return self._set(_EXCEPTION, [each for each in arguments["filters"] if each == _FAILURES])

    def _on_setDataBreakpoints(self, arguments: Message) -> Message:  # noqa: N802
        return self._set(_DATA, [each["dataId"] for each in arguments["breakpoints"]])

    def _on_dataBreakpointInfo(self, arguments: Message) -> Message:  # noqa: N802
        name = arguments["name"]
        listed = self._listed.get((arguments.get("variablesReference", 0), name))
        watched = (listed.watched or listed.expression) if listed is not None else name
        if not watched:
            return {"dataId": None, "description": f"{name} can't be watched"}
        return {"dataId": watched, "description": watched, "accessTypes": ["write"], "canPersist": True}

    def _set(self, kind: str, places: Sequence[str], file: str = "") -> Message:
        """Replace the breakpoints of a kind; if a file is given, only the breakpoints in this file."""
        old = self._session.breakpoints
        kept = [each for each in old if self._numbers.get(each.number) != kind]
        old[:] = [each for each in old if each in kept or (file and (each.line is None or each.line[0] != file))]
        return {"breakpoints": [self._added(kind, place) for place in places]}

    def _added(self, kind: str, place: str) -> Message:
        try:
            if kind == _DATA:
                made = self._session.set_watch(place, self._at_prompt.frame)
            else:
                made = self._session.set_break(place)
        except ReplayError as error:
            return {"verified": False, "message": str(error)}
        self._numbers[made.number] = kind
        line = {} if made.line is None else {"line": made.line[1], "source": self._source(made.line[0])}
        return {"id": made.number, "verified": True, "message": made.counted, **line}

    # --- from step to step ------------------------------------------------------------------------------------------

    def _on_other(self, command: str, arguments: Message) -> Message:
        if command not in _MOVES:
            raise ReplayError(f"the request {command} isn't supported")
        name = "rstep" if arguments.get("granularity") == "instruction" and command == "stepBack" else _MOVES[command]
        self._then = partial(self._move, partial(MOVES[name], self._session), "step")
        return {"allThreadsContinued": True} if command == "continue" else {}

    def _on_goto(self, arguments: Message) -> None:
        self._then = partial(self._move, partial(self._session.go, arguments["targetId"]), "goto")

    def _on_gotoTargets(self, arguments: Message) -> Message:  # noqa: N802
        found = breakpoint_at(self._session.log, self._session.timeline, 0, f"{_file(arguments)}:{arguments['line']}")
        line = found.line[1] if found.line is not None else arguments["line"]
        return {"targets": [{"id": step, "label": f"step {step}", "line": line} for step in found.steps]}

    def _on_pause(self, _: Message) -> None:
        self._session.plan.copies.pause_wanted = False  # the previous request has already reported its stop

    def _move(self, move: Callable[[], Halt], reason: str, title: str = "") -> None:
        """Move the plan, and send the step and the reason of the stop to the editor."""
        prompt, before = self._at_prompt, self._session.step
        try:
            with self._progress(title):
                halt = move()
        except ReplayError as error:
            if isinstance(error, PlanEnded) or self._session.step < 0:
                self._output(f"{error}\n", "important")
                self._event("terminated")
            else:  # there is no further step, or the plan was interrupted twice
                self._stopped("pause", str(error))
            return
        step = halt.arrival.step
        for output in self._session.log.records(Output, before + 1, step + 1):
            self._output(f"{output.text}\n", "stdout")
        with contextlib.redirect_stdout(io.StringIO()):
            prompt.halted(halt, step)
        met = [each.number for each in halt.met]
        kinds = [self._numbers[each] for each in met if each in self._numbers]
        if halt.arrival.reason == "interrupted":
            reason = "pause"
        if halt.arrival.text:
            self._output(f"the plan differs from its recording after step {step}: {halt.arrival.text}\n", "important")
        if reason == "entry" and self._failure() is not None:
            kinds = [_EXCEPTION]
        shown = f"step {step}: {phrases.record_line(self._session.log[step])}"
        self._stopped(kinds[0] if kinds else reason, shown, met)

    def _stopped(self, reason: str, description: str, met: Sequence[int] = ()) -> None:
        self._lists.clear()
        self._listed.clear()
        body: Message = {"reason": reason, "description": description, "threadId": _THREAD, "allThreadsStopped": True}
        if reason == _EXCEPTION and (failure := self._failure()) is not None:
            body["text"] = failure.type
        self._event("stopped", **body, **({"hitBreakpointIds": list(met)} if met else {}))

    @contextlib.contextmanager
    def _progress(self, title: str) -> Iterator[None]:
        """Report a long action to an editor that shows progress."""
        with contextlib.ExitStack() as ending:
            if title and self._client.get("supportsProgressReporting"):
                number = str(self._sent)
                self._event("progressStart", progressId=number, title=title)
                ending.callback(self._event, "progressEnd", progressId=number)
            yield

    # --- variables, frames and sources at a step --------------------------------------------------------------------

    def _on_threads(self, _: Message) -> Message:
        step = self._session.step if self._prompt is not None else -1
        return {"threads": [{"id": _THREAD, "name": self._session.log[step].thread if step >= 0 else "plan"}]}

    def _on_stackTrace(self, arguments: Message) -> Message:  # noqa: N802
        """Return the plan's frames, innermost first, and then the tasks around the step as labels."""
        frames: list[Message] = []
        for number, each in enumerate(self._at_prompt.stack):
            place = {"source": self._source(each["file"]), "line": each["line"], "column": 1}
            frames.append({"id": number, "name": each["function"], **place})
        for task in self._session.timeline.around(self._session.step):
            label = {"line": 0, "column": 0, "presentationHint": "label"}
            frames.append({"id": _TASK_FRAMES + task.started.seq, "name": phrases.node(task), **label})
        first = arguments.get("startFrame") or 0
        last = first + arguments["levels"] if arguments.get("levels") else len(frames)
        return {"stackFrames": frames[first:last], "totalFrames": len(frames)}

    def _source(self, file: str) -> Message:
        recorded = Path(file) in self._session.plan.recorded_files
        return {"name": Path(file).name, "path": file, **({"origin": "recorded source"} if recorded else {})}

    def _on_scopes(self, arguments: Message) -> Message:
        frame = arguments["frameId"]
        scopes: dict[str, _Lister] = (
            {"Locals": partial(self._locals, frame)}
            if frame < _TASK_FRAMES
            else {"Parameters": partial(self._parameters, frame - _TASK_FRAMES)}
        )
        scopes |= {"World": self._worlds, "Beliefs": self._beliefs, "Last query": self._last_query}
        listed = [(name, self._reference(lister)) for name, lister in scopes.items()]
        return {"scopes": [{"name": name, "variablesReference": number, "expensive": False} for name, number in listed]}

    def _reference(self, lister: _Lister | None) -> int:
        if lister is None:
            return 0
        self._lists.append(lister)
        return len(self._lists)

    def _on_variables(self, arguments: Message) -> Message:
        reference = arguments["variablesReference"]
        if not 0 < reference <= len(self._lists):
            raise ReplayError("the plan has moved to another step, so this list of variables is out of date")
        found = []
        for each in self._lists[reference - 1]():
            self._listed[reference, each.name] = each
            texts = {"name": each.name, "value": each.value, "type": each.type, "evaluateName": each.expression}
            shown = {key: visible(text) for key, text in texts.items() if text or key == "value"}
            found.append({**shown, "variablesReference": self._reference(each.parts)})
        return {"variables": found}

    def _locals(self, frame: int, **within: str) -> list[_Variable]:
        """Return the variables of a frame, or the parts of a variable (``expression``)."""
        question, given = ("parts", within) if within else ("variables", {"arguments": False})
        return [
            _Variable(**each, parts=partial(self._locals, frame, expression=each["expression"]) if parts else None)
            for each in self._session.plan.ask(question, frame=frame, **given)
            for parts in [each.pop("parts")]
        ]

    def _parameters(self, step: int) -> list[_Variable]:
        task = self._session.log[step]
        values = argument_values(task.parameters) if isinstance(task, Task) else {}
        return [_Variable(name, phrases.value(value)) for name, value in values.items()]

    def _state(self) -> Iterable[World]:
        return self._session.log.state_at(self._session.step).worlds.values()

    def _worlds(self) -> list[_Variable]:
        opened = [each for each in self._state() if each.open]
        if len(opened) == 1:
            return _bodies(opened[0], "")
        return [
            _Variable(each.title, phrases.plural(len(each.bodies), "object"), parts=partial(_bodies, each, each.name))
            for each in opened
        ]

    def _beliefs(self) -> list[_Variable]:
        believed = [each for world in self._state() for each in world.believed()]
        texts = [f"{phrases.vector(each.position)} {phrases.learned(each.source, each.step)}" for each in believed]
        return [_Variable(each.object, text, each.robot) for each, text in zip(believed, texts, strict=True)]

    def _last_query(self) -> list[_Variable]:
        query = next(iter(self._session.log.backwards(self._session.step, Query)), None)
        if query is None:
            return []
        facts = {"question": phrases.question(query), "answer": phrases.answer(query), "step": str(query.seq)}
        if query.candidates:
            facts["reasons"] = phrases.reasons(query)
        return [_Variable(name, value) for name, value in facts.items()]

    def _on_evaluate(self, arguments: Message) -> Message:
        """Evaluate an expression, or execute a command of the prompt that was typed at the editor's console."""
        text, prompt = str(arguments["expression"]).strip(), self._at_prompt
        if 0 <= arguments.get("frameId", -1) < _TASK_FRAMES:
            prompt.frame = arguments["frameId"]
        if arguments.get("context") == "repl" and hasattr(prompt, f"do_{text.partition(' ')[0]}"):
            before, printed = self._session.step, io.StringIO()
            with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                prompt.onecmd(text)
            if self._session.step != before:
                self._then = lambda: self._stopped("goto", f"step {self._session.step}")
            return {"result": visible(printed.getvalue().rstrip("\n")), "variablesReference": 0}
        if not prompt.stack:
            raise ReplayError("no function of the plan runs at this step")
        answer = self._session.plan.ask("evaluate", frame=prompt.frame, expression=text, pretty=False)
        self._output(answer["printed"], "stdout")
        if "error" in answer:
            raise ReplayError(answer["error"])
        return {"result": visible(answer["value"]), "variablesReference": 0}

    def _on_completions(self, arguments: Message) -> Message:
        text = str(arguments["text"])[: arguments["column"] - 1]
        word, prompt = text.rpartition(" ")[2], self._at_prompt
        names = prompt.completedefault(word) + ([] if " " in text else prompt.completenames(text))
        return {"targets": [{"label": each, "start": len(text) - len(word), "length": len(word)} for each in names]}

    def _on_source(self, arguments: Message) -> Message:
        path = Path((arguments.get("source") or {}).get("path", ""))
        recorded = self._session.plan.recorded_files
        if path not in recorded:
            raise NoSuchName("recorded source", str(path), [str(each) for each in recorded])
        return {"content": recorded[path].decode("utf-8", "replace"), "mimeType": "text/x-python"}

    def _failure(self) -> Failure | None:
        record = self._session.log[self._session.step]
        failure: Failure | None = getattr(record, "failure", None)
        return failure if failure is not None and record.HasField("failure") else None

    def _on_exceptionInfo(self, _: Message) -> Message:  # noqa: N802
        failure = self._failure()
        if failure is None:
            raise ReplayError("nothing failed at this step")
        log, printed = self._session.log, io.StringIO()
        with contextlib.redirect_stdout(printed):
            try:
                main.call("why", log, [str(self._session.step)])
            except ReplayError:  # the plan's own code failed, outside of all tasks
                main.call("why", log, [])
        return {
            "exceptionId": failure.type,
            "description": f"{failure.message}\n\n{printed.getvalue().strip()}",
            "breakMode": "always",
            "details": {"message": failure.message, "typeName": failure.type, "stackTrace": failure.traceback},
        }


def _bodies(world: World, prefix: str) -> list[_Variable]:
    carriers = {name: world.carrier(name) for name in world.bodies}
    return [
        _Variable(
            name,
            phrases.vector(body.position) + (f", {phrases.carrier(held)}" if (held := carriers[name]) else ""),
            body.type,
            parts=partial(_quantities, world, body, prefix),
        )
        for name, body in world.bodies.items()
    ]


def _quantities(world: World, body: Body, prefix: str) -> list[_Variable]:
    name = ".".join(repr(each) if not each.isidentifier() else each for each in (prefix, body.name) if each)
    numbers = [*zip("xyz", body.position, strict=True), *body.joints.items()]
    held = world.carrier(body.name)
    return [
        *(_Variable(each, phrases.number(value), watched=f"{name}.{each}") for each, value in numbers),
        _Variable("orientation", phrases.vector(body.orientation), watched=f"{name}.orientation"),
        _Variable("carrier", held.carrier if held is not None else "none", watched=f"{name}.carrier"),
    ]


def _file(arguments: Message) -> str:
    return str(arguments["source"].get("path") or arguments["source"].get("name"))


def _message(reading: BinaryIO) -> Message | None:
    """Read a message; return None at the end of the input, and for input that isn't a message."""
    length = 0
    while (line := reading.readline()).strip():
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length" and value.strip().isdigit():
            length = int(value)
    text = reading.read(length) if length else b""
    if not text or len(text) < length:
        return None
    message: Message = json.loads(text)
    return message
