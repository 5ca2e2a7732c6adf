"""Required packages: their versions, their extras of pyproject.toml, and how to install an extra.

Messages name a checkout, because the project "pycram" on PyPI is another project.
"""

from __future__ import annotations

import contextlib
import importlib.util
import platform
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final

from recorder.tracing.interrupts import Uninterrupted

#: The extra that installs each module. The renderer requests "render", which also contains trimesh, by name.
_EXTRAS: Final = {
    module: extra
    for extra, modules in {
        "executor": (
            "greenlet", "pybullet", "pybullet_data", "scipy", "trimesh", "collada", "example-robot-data", "rich",
        ),
        "motion": ("ompl", "toppra"),
        "xacro": ("xacro",),
        "render": ("PIL", "jinja2"),
        "viewer": ("pyarrow", "rerun", "rerun_cli", "rerun_sdk"),
        "runs": ("duckdb",),
        "test": ("pytest",),
        "video": ("av",),
        "ray": ("ray", "fsspec"),
    }.items()
    for module in modules
}  # fmt: skip
#: Packages whose versions a recording contains.
_RECORDED: Final = (
    "pycram", "pybullet", "mcap", "protobuf", "numpy", "trimesh", "example-robot-data", "ompl", "toppra", "rerun-sdk",
)  # fmt: skip
#: Releases that simulate bit for bit alike: each release has verified recordings of the other releases.
_SAME_ENGINE: Final = {"3.2.7", "3.2.7 (pybullet-arm64)", "3.2.8 (pybullet-arm64)"}


class NotInstalled(ModuleNotFoundError):
    """A package of an extra isn't installed."""

    def __init__(self, name: str, extra: str) -> None:
        super().__init__(f"{name} isn't installed; {hint(extra)}", name=name)
        self.extra = extra


def hint(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml, or a note that there are no wheels."""
    if extra == "motion" and (sys.platform, platform.machine()) != ("linux", "x86_64"):
        return "the extra 'motion' has no wheels for this system; only continuous motions need this extra"
    return f"in a checkout of PyCRAM: pip install '.[{extra}]'"


@contextlib.contextmanager
def needed(extra: str | None = None) -> Iterator[None]:
    """Run a block that imports an optional module. The error names ``extra``, by default the module's first extra.

    NotInstalled is raised if an extra installs the missing module, otherwise ModuleNotFoundError.
    """
    try:
        yield
    except NotInstalled as error:
        if extra is None:
            raise
        raise NotInstalled(str(error.name), extra) from error
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in _EXTRAS:
            raise
        raise NotInstalled(name, extra or _EXTRAS[name]) from error


def require(*modules: str) -> None:
    """Raise :class:`NotInstalled` if a module isn't installed, without importing the modules."""
    for name in modules:
        if importlib.util.find_spec(name) is None:
            raise NotInstalled(name, _EXTRAS[name])


class LazyModule:
    """A module that is imported when its first attribute is read; raises ModuleNotFoundError if it isn't installed."""

    def __init__(self, name: str) -> None:
        package = name.partition(".")[0]
        if importlib.util.find_spec(package) is None:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        with Uninterrupted():  # in libraries with lazy imports, Ctrl-C would be lost
            value = getattr(importlib.import_module(self._name), attribute)
        setattr(self, attribute, value)
        return value


@cache
def _installed() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415  slow

    def installed(package: str) -> str | None:
        try:
            return version(package)
        except PackageNotFoundError:
            return None

    found = {package: installed(package) or "not installed" for package in _RECORDED}
    if (other := installed("pybullet-arm64")) is not None:
        both = found["pybullet"] != "not installed"
        found["pybullet"] = f"{found['pybullet']}, " * both + f"{other} (pybullet-arm64)"
    return found


def versions() -> dict[str, str]:
    """Return the versions of the packages that a recording depends on, the platform, and the process's arguments."""
    from recorder.records.values import without_secrets  # noqa: PLC0415  heavy, and help texts don't need it

    return _installed() | {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "arguments": " ".join(without_secrets(sys.argv)),
    }


def other_versions(then: Mapping[str, str], *names: str) -> tuple[str, ...]:
    """Return "NAME VERSION instead of RECORDED VERSION" for each package that now has another version."""
    now = versions()
    return tuple(
        f"{name} {now[name]} instead of {then[name]}"
        for name in names
        if then.get(name, now[name]) != now[name]
        and not (name == "pybullet" and {now[name], then[name]} <= _SAME_ENGINE)
    )
