"""Local variables of the plan's functions when an error was raised, for ``why``.

No code of users is called for them: values of Python's own types are written out, an object of a world by its name, any
other by the name of its type.
"""

from __future__ import annotations

import enum
import re
from contextlib import suppress
from itertools import islice
from pathlib import Path, PurePosixPath
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Final

from recorder.records import StackFrame, Variable, escaped, failure
from recorder.records.traceback_text import MAX_ERRORS
from recorder.secrets import LEFT_OUT, is_secret
from recorder.tracing import journal
from recorder.tracing.call_stack import is_plan, plan_frame

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from types import FrameType

    from recorder.records import Failure

MAX_FRAMES: Final = 16  # innermost ones
MAX_VARIABLES: Final = 20  # of a frame
MAX_CHARACTERS: Final = 80  # of a value

_MAX_ITEMS: Final = 6  # of a list
_MAX_DEPTH: Final = 3  # of lists within lists
_MAX_BITS: Final = 256  # of an integer
_ELLIPSIS: Final = "..."
_MARK: Final = "_pycram_frames"  # an error's attribute: the recording and the frames that its records hold already
_IGNORED: Final = (ModuleType, FunctionType, BuiltinFunctionType, type)  # a module's imports and definitions
_TYPE_ALONE: Final = re.compile(r"<[\w.]+>")
_EXACT: Final = frozenset({type(None), bool, int, float, complex, range, type(Path()), PurePosixPath})
_BRACKETS: Final[Mapping[type, tuple[str, str]]] = {
    list: ("[", "]"),
    tuple: ("(", ")"),
    set: ("{", "}"),
    frozenset: ("frozenset({", "})"),
    dict: ("{", "}"),
}


def failure_with_frames(error: BaseException, *, errors: int = MAX_ERRORS) -> Failure:
    """An error as :func:`failure` has it, with the plan's frames if they are recorded."""
    record = failure(error, errors=errors)
    if journal.keeps_local_variables():
        with suppress(Exception):  # of an error's own methods
            record.frames.extend(_new_frames(error))
    return record


def _new_frames(error: BaseException) -> list[StackFrame]:
    """The plan's frames that led to an error, outermost first, without those that an earlier record of it holds."""
    recording, known = vars(error).get(_MARK, (0, frozenset()))
    if recording != journal.recording_number():
        known = frozenset()
    frames = [(frame, line) for frame, line in _frames(error) if id(frame) not in known][-MAX_FRAMES:]
    vars(error)[_MARK] = journal.recording_number(), known.union(id(frame) for frame, _ in frames)
    return [
        StackFrame(
            file=escaped(frame.f_code.co_filename),
            line=line,
            function=escaped(frame.f_code.co_name),
            variables=[Variable(name=name, value=value) for name, value in _variables(frame)],
        )
        for frame, line in frames
    ]


def _frames(error: BaseException) -> list[tuple[FrameType, int]]:
    """The plan's frames of the traceback, and those that were running around them, with their lines."""
    trace = error.__traceback__
    outer: list[tuple[FrameType, int]] = []
    around = trace.tb_frame.f_back if trace is not None else None
    while (around := plan_frame(around)[0]) is not None:
        outer.append((around, around.f_lineno))
        around = around.f_back
    inner = []
    while trace is not None:
        if is_plan(trace.tb_frame):
            inner.append((trace.tb_frame, trace.tb_lineno))
        trace = trace.tb_next
    return [*reversed(outer), *inner]


def _variables(frame: FrameType) -> Iterator[tuple[str, str]]:
    """Names and values, in the order of their first assignment.

    Of a module, that has many and imports some, the last ones that have more to show than their type.
    """
    try:
        values = {
            name: value
            for name, value in list(frame.f_locals.items())
            if type(name) is str and name.isidentifier() and name[:2] != "__" and not issubclass(type(value), _IGNORED)
        }
    except RuntimeError:  # another thread is changing them
        return
    texts = [(name, LEFT_OUT if is_secret(name) else described(value)) for name, value in values.items()]
    if frame.f_locals is frame.f_globals:
        texts = [(name, text) for name, text in texts if not _TYPE_ALONE.fullmatch(text)][-MAX_VARIABLES:]
    for name, text in texts[:MAX_VARIABLES]:
        yield name, text if len(text) <= MAX_CHARACTERS else text[: MAX_CHARACTERS - len(_ELLIPSIS)] + _ELLIPSIS


def described(value: Any, depth: int = 0) -> str:
    """A value in a few words, without calling any code but Python's and PyCRAM's own."""
    kind = type(value)
    if kind is str or kind is bytes:
        return repr(value[: MAX_CHARACTERS + 1])
    if kind is int and value.bit_length() > _MAX_BITS:
        return f"<int of {value.bit_length()} bits>"
    if kind in _EXACT:
        return repr(value)
    return _collection(value, depth) if kind in _BRACKETS else _other(value)


def _other(value: Any) -> str:
    kind = type(value)
    module, name = (str(type.__getattribute__(kind, each)) for each in ("__module__", "__qualname__"))
    if module == "numpy":
        return _of_numpy(value, name)
    if issubclass(kind, enum.Enum):
        return f"{name}.{object.__getattribute__(value, '_name_')}"
    if module.startswith("pycram.world.") and type(own := getattr(value, "name", None)) is str:
        return f"<{name} {own}>"
    return f"<{name}>"


def _collection(value: Any, depth: int) -> str:
    kind = type(value)
    before, after = _BRACKETS[kind]
    if not value:
        return f"{before}{after}" if kind not in (set, frozenset) else f"{kind.__name__}()"
    if depth >= _MAX_DEPTH:
        return f"{before}{_ELLIPSIS}{after}"
    try:
        some: Iterable[Any] = list(islice(value.items() if kind is dict else value, _MAX_ITEMS))
    except RuntimeError:  # another thread is changing it
        some = ()
    if kind is dict:
        texts = [f"{described(key, depth + 1)}: {_item(key, item, depth + 1)}" for key, item in some]
    else:
        texts = [described(item, depth + 1) for item in some]
    if len(value) > len(texts):
        texts.append(_ELLIPSIS)
    return f"{before}{', '.join(texts)}{',' if kind is tuple and len(value) == 1 else ''}{after}"


def _item(key: object, item: object, depth: int) -> str:
    return LEFT_OUT if type(key) is str and is_secret(key) else described(item, depth)


def _of_numpy(value: Any, name: str) -> str:
    """A number or a small array of NumPy's by its values, a larger array by its shape."""
    dtype = getattr(value, "dtype", None)
    if dtype is None or dtype.kind not in "biuf":
        return f"<{name}>"
    if name != "ndarray":
        return repr(value.item())
    shape = "x".join(map(str, value.shape))
    return f"array({described(value.tolist())})" if value.size <= _MAX_ITEMS * 2 else f"<array {shape} of {dtype.name}>"
