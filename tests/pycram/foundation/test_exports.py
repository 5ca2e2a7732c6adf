"""Tracebacks and pickles name the module from which users import a failure."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from pycram.failures import PycramError

FACES = ("pycram.failures", "pycram.designator", "pycram.process_module", "pycram.fluent")


@pytest.mark.parametrize("name", FACES)
def test_exported_failures_have_their_public_module(name: str) -> None:
    face = importlib.import_module(name)
    failures = [kind for kind in map(vars(face).get, face.__all__) if isinstance(kind, type)]
    modules = {kind.__name__: kind.__module__ for kind in failures if issubclass(kind, PycramError)}
    assert modules == dict.fromkeys(modules, name)
    assert modules


@pytest.mark.slow
def test_a_traceback_names_the_public_module_though_nothing_has_imported_it() -> None:
    program = "from pycram.bullet_world import BulletWorld; BulletWorld('WINDOW')"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.stderr.splitlines()[-1].startswith("pycram.failures.BadArgument: type = 'WINDOW'")
