"""The kinds of causes, as data: each says what was found, and carries the steps of the records that it rests on.

The names of the classes' ``kind`` and of their fields are those of ``why --json`` (docs/why.md): they don't change.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.records import Fluent, Plain, Query, Refusal, Task
    from recorder.tasks import Node
    from replay.history.source import Line


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause of a failure.

    Attributes:
        kind: what kind it is.
        steps: of the records that it rests on, in order.
    """

    kind: ClassVar[str]
    steps: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Change:
    """A record that changed a body or joint.

    Attributes:
        step: of the record.
        body: name of the body.
        joint: name of its joint; "" for its pose.
        how: as in :class:`replay.history.blame.Blame`, or "attached", "detached", "in-hand" (it was moved itself while
            a hand held it, and stays in that hand).
        task: the start of the innermost motion or handler, or else task, that it is part of; None if the plan itself
            did it.
        handler: the start of the handler's call that it is part of, whose cause is its event; None if it is of none.
        line: the plan's line that asked for it; None if that isn't known.
        mover: what the record's command moved, if that is something else: a body, or ``JOINT of BODY``.
        distance: by how much it changed, m or of a revolute joint rad.
        angle: by how much it turned, rad.
        by_fork: whether whoever forked the run did it, not the plan.
    """

    step: int
    body: str
    joint: str = ""
    how: str = ""
    task: Task | None = None
    line: Line | None = None
    mover: str = ""
    distance: float = 0.0
    angle: float = 0.0
    handler: Task | None = None
    by_fork: bool = False


@dataclass(frozen=True, slots=True)
class Swallowed(Cause):
    """An earlier task failed, or was cancelled, the plan went on, and so a later one lacked what it needs.

    Attributes:
        precondition: what it lacked: "held" (the arm holds the object), "hand-free" (the arm holds nothing), "clear"
            (the object isn't in the way), "joint-moved", "at-pose" (the robot stands where it was sent), "posture"
            (of the arm), "camera-directed", "result" (of a task, in a variable).
        subject: name of the object, joint or variable; "" for none.
        arm: name of the arm; "" for none.
        failed: the earlier task.
        line: the plan's line that asked for that; None if that isn't known.
        went_on: the plan's line with which it went on; None if that isn't known.
        also: earlier tasks that would have done as well, and failed too, as with the other arm.
        skipped: the plan's line that skipped what would have used the variable, as a loop over nothing does; or None.
    """

    kind = "swallowed-failure"
    precondition: str
    subject: str
    arm: str
    failed: Node
    line: Line | None
    went_on: Line | None
    also: tuple[Node, ...] = ()
    skipped: Line | None = None


@dataclass(frozen=True, slots=True)
class Refused(Cause):
    """What the plan asked for was refused, the plan went on, and so a later motion lacked what that would have done.

    Attributes:
        precondition: what it lacked: "held", "hand-free", "clear", "joint-moved" and "result" as of :class:`Swallowed`;
            "moved" (the object or robot is elsewhere), "loaded" (the object exists).
        subject: name of the object, joint or variable.
        asked: the record of the refusal.
        line: the plan's line that asked for it; None if that isn't known.
        went_on: the plan's line with which it went on; None if that isn't known.
        handler: the start of the handler's call that asked for it; None if it was none.
    """

    kind = "refused"
    precondition: str
    subject: str
    asked: Refusal
    line: Line | None
    went_on: Line | None
    handler: Task | None = None


@dataclass(frozen=True, slots=True)
class HandState(Cause):
    """A hand didn't hold what it should, or held something that it shouldn't.

    Attributes:
        precondition: "held": the arm should have held the object; "hand-free": it should have been free of it.
        body: name of the object.
        arm: name of the arm that was to act.
        holder: who held the object at the failure, as ``CARRIER (LINK)`` or the name of an arm; "" if nobody did.
        change: the record since when that was so; None if it was so from the beginning.
    """

    kind = "hand-state"
    precondition: str
    body: str
    arm: str
    holder: str
    change: Change | None


@dataclass(frozen=True, slots=True)
class Physics(Cause):
    """An object fell, tipped or moved in simulation after it had been where the plan wanted it.

    Attributes:
        body: name of the object.
        how: "fell", "tipped" or "moved".
        distance: how far it moved, m.
        fall: by how much it is lower, m.
        tilt: by how much it leans more, rad.
        moved_at: the step of the simulation in which it began to move.
        line: the plan's line that simulated; None if that isn't known.
        stood_on: name of what it stood on, and what was moved then; "" if nothing was, or that isn't known.
        since: the step of the success, or of the plan's own change, after which it moved.
        lets: the changes that let it, of which one did; none if nothing but time passed.
        speed: m/s with which it began to move when it was let go of; None if it wasn't.
        spin: rad/s, likewise.
        hand: name of the arm that let go of it; "" if none did.
    """

    kind = "physics"
    body: str
    how: str
    distance: float
    fall: float
    tilt: float
    moved_at: int
    line: Line | None
    since: int
    stood_on: str = ""
    lets: tuple[Change, ...] = ()
    speed: float | None = None
    spin: float | None = None
    hand: str = ""


@dataclass(frozen=True, slots=True)
class Raised(Cause):
    """The plan's own code raised the failure, or made the mistake that Python or PyCRAM refused.

    Attributes:
        type: of what was raised.
        line: the plan's line.
        own: whether it is a ``raise`` or ``assert`` of the plan's; else that line made a mistake.
        task: the branch or other task in which it did; None outside of all.
        answers: the last queries and waits of that task before it, whose answers it may have judged by; before them
            the end of the last motion, if that failed; of a ``whenever`` the last change of its fluents.
    """

    kind = "raised"
    type: str
    line: Line
    own: bool
    task: Node | None
    answers: tuple[Query | Task | Fluent, ...] = ()


@dataclass(frozen=True, slots=True)
class Fulfiller:
    """What could have made a fluent true.

    Attributes:
        line: the plan's line that sets it; None if only a record tells.
        task: the task that ran it, or should have; None if there is none.
        step: of the record by which it set the fluent last; None if it never did.
        failed: the last motion that failed in that task; None if none did.
        refused: what was refused last in that task; None if nothing was.
    """

    line: Line | None
    task: Node | None
    step: int | None = None
    failed: Node | None = None
    refused: Refusal | None = None


@dataclass(frozen=True, slots=True)
class Pending:
    """What a part of a plan was doing when it was stopped.

    Attributes:
        task: a wait for a fluent, a motion, or another task.
        began: whether it had begun; a motion that hadn't waited for its turn, or for parts of the robot.
        line: the plan's line.
        values: of a wait: the values of its fluents then, by name.
        changed: of a wait: the steps in which one of them got a value meanwhile, the last ones.
        fulfillers: of a wait: what could have fulfilled it.
        holders: of a motion that had not begun: the motions that ran then.
    """

    task: Node
    began: bool
    line: Line | None
    values: Mapping[str, Plain] = field(default_factory=dict)
    changed: tuple[int, ...] = ()
    fulfillers: tuple[Fulfiller, ...] = ()
    holders: tuple[Node, ...] = ()


@dataclass(frozen=True, slots=True)
class Simulated:
    """Simulated time that a line of the plan took.

    Attributes:
        line: the line; None if it isn't known.
        seconds: s of simulated time.
        steps: of the records.
    """

    line: Line | None
    seconds: float
    steps: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Timeout(Cause):
    """A part of the plan missed its deadline.

    Attributes:
        seconds: the limit, s.
        clock: "wall" or "simulated".
        pending: what it was waiting for, or doing, at the deadline.
        line: the plan's line at which it stopped; None if that isn't known.
        took: the tasks that ended within it, the longest first by that clock.
        simulated: of a limit in simulated time, the lines that took most of it.
    """

    kind = "timeout"
    seconds: float
    clock: str
    pending: tuple[Pending, ...]
    line: Line | None
    took: tuple[Node, ...] = ()
    simulated: tuple[Simulated, ...] = ()


@dataclass(frozen=True, slots=True)
class Interrupted(Cause):
    """Somebody, or something else, ended the plan: that is no failure of it.

    Attributes:
        by: "Ctrl-C", "SIGTERM"; "" if the process ended without closing its recording.
        pending: what it was doing.
        line: the plan's line at which it stopped; None if that isn't known.
    """

    kind = "interrupted"
    by: str
    pending: tuple[Pending, ...]
    line: Line | None


@dataclass(frozen=True, slots=True)
class NoLonger(Cause):
    """What the plan relied on was true when it asked, and wasn't any more.

    Attributes:
        asked: the query that was answered yes, or the task that succeeded.
        changes: what has changed of it since then.
    """

    kind = "no-longer-true"
    asked: Query | Node
    changes: tuple[Change, ...]


@dataclass(frozen=True, slots=True)
class Misbelief(Cause):
    """The robot believed an object elsewhere than it was.

    Attributes:
        body: name of the object.
        source: how it came to believe that: "seen", "told" by the world's state, or "placed", where it let go of it.
        learned: the step at which it did; -1: before the recording.
        position: where it believed it, m.
        distance: from there to where it was, m.
        change: what had moved it since; None if that isn't known.
    """

    kind = "misbelief"
    body: str
    source: str
    learned: int
    position: tuple[float, ...]
    distance: float
    change: Change | None


@dataclass(frozen=True, slots=True)
class InTheWay(Cause):
    """Something was in the way, or hid what was looked for.

    Attributes:
        body: name of what was in the way.
        link: its link; "" if it has only one, or that isn't known.
        mover: name of the link, or of the held object, that would have touched it; "" for the camera's view.
        change: what put it there; None if it was there from the beginning.
    """

    kind = "in-the-way"
    body: str
    link: str
    mover: str
    change: Change | None


@dataclass(frozen=True, slots=True)
class NoCandidate(Cause):
    """Of the ways to do it, as grasps or postures, none would do.

    Attributes:
        asked: the choice, with its candidates and why each was rejected.
        count: how many were considered.
    """

    kind = "no-candidate"
    asked: Query
    count: int


@dataclass(frozen=True, slots=True)
class OutOfReach(Cause):
    """The arm doesn't get there from where the robot stands.

    Attributes:
        arm: name of the arm.
        body: name of the object; "" for a target of the plan's.
        distance: from the robot's base to it on the ground, m.
        miss: how far away the nearest posture stays, m; None if that isn't known.
        orientation: xyzw of the tool that was asked for; none if any would have done.
        changes: what put the robot, its torso, and the object, where they are.
    """

    kind = "out-of-reach"
    arm: str
    body: str
    distance: float
    miss: float | None
    orientation: tuple[float, ...]
    changes: tuple[Change, ...]


@dataclass(frozen=True, slots=True)
class Gone(Cause):
    """What the plan used had been removed.

    Attributes:
        body: its name.
        change: the record that removed it.
        loaded: the record that loaded another one of its name since then; None if none did.
    """

    kind = "removed"
    body: str
    change: Change
    loaded: Change | None = None
