"""RRT-Connect (Kuffner, LaValle, ICRA 2000) and shortcuts, with OMPL (Sucan, Moll, Kavraki, 2012).

OMPL's objects take their seeds from one sequence of the process. Each query restarts the sequence and creates new
objects, so earlier queries don't affect its result.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pycram.planning.space import Clearance, Space, between
from recorder.packages import needed

with needed():
    from ompl import base, geometric, util

if TYPE_CHECKING:
    Array = NDArray[np.float64]

_RANGE: Final = 1.0  # maximum weighted distance by which a tree grows in one step
_SHORTCUTS: Final = 60  # maximum number of attempts to shorten a path
_EMPTY_SHORTCUTS: Final = 25  # number of useless attempts in a row after which shortening ends
_START_TREE: Final = 1  # OMPL's tag for vertices of the tree that begins at the start

_one_query = threading.Lock()  # the process has only one sequence of seeds


class _Edges(base.MotionValidator):  # type: ignore[misc]  # OMPL has no types
    """Checks edges of the trees. OMPL can't pass on errors such as Ctrl-C, so they are stored and end the search."""

    def __init__(self, information: Any, check: Callable[[Array, Array], bool], dimensions: int) -> None:
        super().__init__(information)
        self._check = check
        self._range = range(dimensions)
        self.error: BaseException | None = None

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802  OMPL's name
        if self.error is not None:
            return False
        try:
            return self._check(_row(a, self._range), _row(b, self._range))
        except BaseException as error:  # noqa: BLE001  the error is raised again when OMPL has returned
            # a traceback would keep OMPL's objects until the process exits; OMPL would then print a warning
            self.error = error if isinstance(error, Exception) else error.with_traceback(None)
            return False


def _row(state: Any, dimensions: range) -> Array:
    return np.array([state[i] for i in dimensions])


def search(
    space: Space,
    start: Array,
    goal: Array,
    clearance: Clearance,
    *,
    step: float,
    fine: float,
    seed: int,
    max_checks: int,
) -> tuple[Array | None, Array]:
    """Return a free path (n, d), or None, and the reached configuration (d,) nearest to the goal.

    Between checked configurations, no coordinate changes by more than ``step`` (weighted), or by more than ``fine``
    while the path is shortened. The ``seed`` is from 1 to 2**31. The search ends after ``max_checks`` checks.
    """
    with _one_query:
        level = util.getLogLevel()
        util.setLogLevel(util.LogLevel.LOG_NONE)  # Otherwise OMPL prints messages
        try:
            util.RNG.setSeed(seed)
            found, nearest, error = _search(space, start, goal, clearance, step, fine, max_checks)
        finally:
            util.setLogLevel(level)
    if error is not None:
        raise error
    return found, nearest


def _search(
    space: Space, start: Array, goal: Array, clearance: Clearance, step: float, fine: float, max_checks: int
) -> tuple[Array | None, Array, BaseException | None]:
    dimensions, weights = len(start), space.weights
    real = base.RealVectorStateSpace(dimensions)
    bounds = base.RealVectorBounds(dimensions)
    for number, (low, high) in enumerate(zip(space.lower * weights, space.upper * weights, strict=True)):
        bounds.setLow(number, float(low))
        bounds.setHigh(number, float(high))
    real.setBounds(bounds)
    information = base.SpaceInformation(real)
    budget = max_checks

    def free(a: Array, b: Array) -> bool:
        rows = between(a / weights, b / weights, step / weights)
        return clearance.checks < budget and clearance.free(np.vstack([rows, a / weights]))

    edges = _Edges(information, free, dimensions)
    information.setMotionValidator(edges)
    information.setStateValidityChecker(base.AllValidStateValidityChecker(information))  # edges include both ends
    information.setup()
    ends = []
    for row in (start, goal):
        state = real.allocState()
        for number, value in enumerate(row * weights):
            state[number] = float(value)
        ends.append(state)
    problem = base.ProblemDefinition(information)
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(_RANGE)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: edges.error is not None or clearance.checks >= max_checks))
    found = None
    if edges.error is None and problem.hasExactSolution():
        path = problem.getSolutionPath()
        budget = clearance.checks + max_checks // 8
        step = fine  # shortcuts pass obstacles at a small distance
        simplifier = geometric.PathSimplifier(information)
        simplifier.reduceVertices(path, _SHORTCUTS, _EMPTY_SHORTCUTS)
        simplifier.partialShortcutPath(path, _SHORTCUTS, _EMPTY_SHORTCUTS)
        simplifier.reduceVertices(path, _SHORTCUTS, _EMPTY_SHORTCUTS)  # this call removes the ends of shortcuts
        found = np.array([_row(state, range(dimensions)) for state in path.getStates()]) / weights
        found[0], found[-1] = start, goal
    reached = goal if found is not None else _nearest(information, planner, space, goal)
    return found, reached, edges.error


def _nearest(information: Any, planner: Any, space: Space, goal: Array) -> Array:
    """Return the configuration nearest to the goal in the tree that begins at the start."""
    data = base.PlannerData(information)
    planner.getPlannerData(data)
    vertices = map(data.getVertex, range(data.numVertices()))
    reached = [_row(each.getState(), range(len(goal))) for each in vertices if each.getTag() == _START_TREE]
    rows = np.array(reached) / space.weights
    nearest: Array = rows[int(np.argmin(space.distance(rows, goal)))]
    return nearest
