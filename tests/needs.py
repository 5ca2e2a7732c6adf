"""What tests need of the machine, and whether it is there: programs, graphics libraries, a driver that draws, packages.

A fixture or a test that needs something says so with :func:`need`, or is marked ``@pytest.mark.needs("Xvfb")``. What
isn't there skips the test; one line at the end of the run sums up. Where ``CI`` is set it is a failure instead.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
import shutil
import subprocess
import sys
from collections import Counter
from typing import TYPE_CHECKING, Final

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

_SYSTEM: Final = "`make system-packages`"
_DEV: Final = "`make test`"
_LONG: Final = "`make test-long`"
_REASON: Final = "this machine has no "
#: Modules that only the environment of the long measures has.
_PACKAGES: Final = {"Ray": "ray", "PyAV": "av", "polars": "polars", "datasets": "datasets"}
#: Modules of the extra `dev` that only some tests use.
_DEV_PACKAGES: Final = {"Jupyter": "nbclient", "RTAMT": "rtamt", "Foxglove": "mcap_protobuf", "xacro": "xacro"}
_BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
#: What the viewer's window loads when it opens.
_WINDOW_LIBRARIES: Final = (
    "libX11-xcb.so.1",
    "libXcursor.so.1",
    "libXi.so.6",
    "libXrandr.so.2",
    "libxkbcommon-x11.so.0",
)
#: Two network cards that lead to each other, in a machine of their own.
_CABLE: Final = ("ip", "link", "add", "name", "here", "type", "veth", "peer", "name", "there")
#: Asks each driver for its devices; a library without a driver has none.
_DEVICES: Final = """
import ctypes
class Create(ctypes.Structure):
    _fields_ = [("type", ctypes.c_int), ("next", ctypes.c_void_p), ("flags", ctypes.c_uint), ("application", ctypes.c_void_p),
                ("layer_count", ctypes.c_uint), ("layers", ctypes.c_void_p), ("count", ctypes.c_uint), ("names", ctypes.c_void_p)]
vulkan = ctypes.CDLL("libvulkan.so.1")
instance, count = ctypes.c_void_p(), ctypes.c_uint(0)
made = vulkan.vkCreateInstance(ctypes.byref(Create(type=1)), None, ctypes.byref(instance))
assert made == 0 and vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None) == 0 and count.value > 0
"""


def _loads(*libraries: str) -> bool:
    try:
        for library in libraries:
            ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _runs(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=60, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def _is_installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def browser() -> str | None:
    """The browser's program; None if there is none."""
    return next((name for name in _BROWSERS if shutil.which(name)), None)


#: How each is found. They are looked at once in a process, and only when a test asks.
_FOUND: Final[dict[str, Callable[[], bool]]] = {
    "Xvfb": lambda: shutil.which("Xvfb") is not None,
    "XTest": lambda: _loads("libX11.so.6", "libXtst.so.6"),
    "OpenGL": lambda: _loads("libGL.so.1", "libGLX_mesa.so.0"),
    "Vulkan driver": lambda: _runs(sys.executable, "-c", _DEVICES),
    "window libraries": lambda: _loads(*_WINDOW_LIBRARIES),
    "Chromium": lambda: _runs(browser() or "", "--version"),
    "network namespaces": lambda: _runs("unshare", "-rn", *_CABLE),
    **{name: functools.partial(_is_installed, module) for name, module in {**_PACKAGES, **_DEV_PACKAGES}.items()},
}


@functools.cache
def has(what: str) -> bool:
    """Return whether this machine has it.

    Args:
        what: one of the names above.
    """
    return _FOUND[what]()


def need(*names: str) -> None:
    """Skip the test that runs if this machine lacks something; where ``CI`` is set, fail it.

    Args:
        names: what it needs.
    """
    missing = [name for name in names if not has(name)]
    if missing:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{_REASON}{', no '.join(missing)}")


def _maker(name: str) -> str:
    return _LONG if name in _PACKAGES else _DEV if name in _DEV_PACKAGES else _SYSTEM


def summary(reasons: Iterable[str]) -> str | None:
    """Return the line that sums up what was skipped for what is missing; None if nothing was.

    Args:
        reasons: why tests were skipped.
    """
    of_needs = [reason.partition(_REASON)[2] for reason in reasons if _REASON in reason]
    if not of_needs:
        return None
    names = Counter(name for text in of_needs for name in text.split(", no "))
    tests = f"{len(of_needs)} test{'s' if len(of_needs) > 1 else ''}"
    missing = [name for name in _FOUND if name in names]
    makers = list(dict.fromkeys(_maker(name) for name in missing))
    install = f"{' and '.join(makers)} install{'s' if len(makers) == 1 else ''} them"
    return f"{tests} skipped: {', '.join(f'no {name}' for name in missing)}; {install}"


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Look at what a test is marked with before its fixtures start something."""
    for mark in item.iter_markers("needs"):
        need(*mark.args)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None, None, None]:
    """Write the line below everything else; workers have no terminal, and leave it to who started them."""
    yield
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None and not hasattr(session.config, "workerinput"):
        line = summary(report.longrepr[2] for report in terminal.getreports("skipped"))
        if line is not None:
            terminal.write_line(line, yellow=True)
