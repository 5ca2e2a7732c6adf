"""``in_thread`` does what would block all branches in a worker, while its branch waits."""

from __future__ import annotations

import queue
import socket
import threading

import pytest

from pycram import tasks
from pycram.failures import Unreachable
from pycram.language import in_thread, par, pursue
from recorder.tracing.context import current_name
from recorder.tracing.span import span
from tests.pycram.language.gates import C, F, Gate, S, fails


def test_other_branches_run_while_a_worker_is_blocked() -> None:
    messages: queue.Queue[str] = queue.Queue()
    receiver, sender = socket.socketpair()
    with receiver, sender, par as s:
        message = s(lambda: in_thread(messages.get, timeout=20))
        received = s(in_thread, receiver.recv, 5)
        s(messages.put, "hello")
        s(sender.send, b"world")
    assert (message, received.result()) == ("hello", b"world")


def test_a_worker_s_error_is_raised_in_the_branch() -> None:
    with pytest.raises(Unreachable), par as s:
        s(in_thread, fails)
    assert s.branches[0].state is F
    with pytest.raises(ZeroDivisionError):
        in_thread(lambda: 1 / 0)
    assert in_thread(int, "12", base=3) == 5  # outside of branches too


def test_a_cancelled_branch_ends_when_its_worker_has() -> None:
    begun, release, ended = Gate(), threading.Event(), []

    def work() -> None:
        begun.open()
        release.wait(20)
        ended.append("worker")

    with pursue as s:
        s(in_thread, work)
        s(lambda: (begun.pass_through(20), threading.Timer(0.01, release.set).start()))
    assert ended == ["worker"]
    assert [branch.state for branch in s.branches] == [C, S]
    assert not [thread for thread in threading.enumerate() if thread.name.endswith(" work")]


def test_a_worker_acts_as_part_of_its_branch() -> None:
    names = []

    def work() -> None:
        names.append(current_name())
        with span("motion", "in the worker"):
            names.append(tasks.current().parent.name)
            assert tasks.current().parent.parent.name.endswith("<lambda>")

    with par as s:
        s(lambda: in_thread(work))
    (branch,) = s.branches
    assert names == [f"par-1 {branch.name} work", "work"]
