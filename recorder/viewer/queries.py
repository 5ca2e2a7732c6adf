"""The last reasoning query: a page with its answer and evidence, marks in the scene, and the picture of its camera.

Marks are green for the answer "yes" or without blocking bodies, otherwise red. A query for places has a map on the
floor; the colours of its cells go from blue (hardly suitable) to green (suitable). A taken place is a green point with
its heading, a rejected place red, an untried place grey. Maps are checked, because recordings may come from strangers.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from recorder.records import Query, argument_values, format_failure
from recorder.records.text import NOT_TRIED, TAKEN, by_name, fates, fates_text, rejection_lines, values
from recorder.records.values import name_of, position
from recorder.viewer.marks import LINK, Marks, Values, camera_position, line_through, points_at, target_position
from recorder.viewer.rerun_stream import BLUE, GREEN, GREY, RED, Color, Columns, TimePoint
from recorder.viewer.scene import ViewerScene

if TYPE_CHECKING:
    from recorder.records.log_pb2 import Grid

QUERIES: Final = "queries"
PAGE: Final = "page"
_ACTIVE: Final = re.compile(r"\\|(?<=!)\[|(?<=\])[\[(]|<")


class QueryPage:
    """The page of the last query."""

    def __init__(self, columns: Columns) -> None:
        self._pages = columns.series(columns.path(QUERIES, PAGE), _pages)

    def show(self, record: Query, now: TimePoint) -> None:
        """Show a query."""
        self._pages.add(now, (_page(record),))


def _pages(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    text = pa.array([text for (text,) in rows])
    return rr.TextDocument.columns(text=text, media_type=pa.repeat("text/markdown", len(rows)))


def _page(record: Query) -> str:
    raised = f"raised {format_failure(record.failure)}" if record.HasField("failure") else ""
    lines = [
        _text(f"## {record.name}({values(record.arguments)})"),
        _text(f"**{raised or by_name(record.answer_json)}**"),
        "",
        _text(f"asked at step {record.seq} of {record.world}, took {record.duration_ns / 1e6:.1f} ms"),
        "",
        "| evidence | |",
        "|---|---|",
        *[f"| {_cell(fact.name)} | {_cell(by_name(fact.json))} |" for fact in record.evidence[:]],
        *[f"| rejected | {_cell(line)} |" for line in rejection_lines(record)],
    ]
    return "\n".join(lines)


def _cell(text: str) -> str:
    return _text(text).replace("|", "\\|")


def _text(line: str) -> str:
    """Escape Markdown. Otherwise, a viewer would load pictures from links that the recording of a stranger contains."""
    return _ACTIVE.sub(r"\\\g<0>", " ".join(line.splitlines()))


PICTURE: Final = "picture"
_MAX_CLASSES: Final = 60_000  # maximum number of classes, because the viewer stores a class in 16 bits
MAX_PIXELS: Final = 1 << 24  # maximum number of pixels; pictures of robot cameras have a tenth of this number


class QueryPicture:
    """The picture of the last query with a picture."""

    def __init__(self, columns: Columns, scene: ViewerScene) -> None:
        self._columns = columns
        self._scene = scene
        self._path, self._legend = columns.path(QUERIES, PICTURE), columns.path(QUERIES, PICTURE, "legend")
        self._names = columns.path(QUERIES, PICTURE, "names")
        self._classes: dict[str, int] = {}  # the class number of each body in the picture, by the body's name
        self._colors: dict[str, Color] = {}  # the colour of each body

    def show(self, record: Query, now: TimePoint) -> None:
        """Show the picture of a query, if it has one."""
        if not record.HasField("picture"):
            return
        picture = record.picture
        classes = [0, *(self._class(record.world, body) for body in picture.bodies)]
        size = picture.width * picture.height
        if not 0 < size <= MAX_PIXELS:
            raise ValueError(f"invalid picture: {picture.width} x {picture.height} pixels")
        pixels = np.frombuffer(zlib.decompressobj().decompress(picture.pixels, size), dtype=np.uint8)
        image = np.array(classes, dtype=np.uint16)[pixels].reshape(picture.height, picture.width)
        self._columns.send(self._path, now, rr.SegmentationImage(image))
        seen = [body for number, body in enumerate(picture.bodies, 1) if (pixels == number).any()]
        row = picture.height / (len(seen) + 1)
        places = [(picture.width * 1.1, row * (number + 0.6)) for number in range(len(seen))]
        swatches = rr.Points2D(places, colors=[self._colors[body] for body in seen], radii=[row / 6])
        self._columns.send(self._legend, now, swatches)
        names = [(x, y + row / 4) for x, y in places]
        # a fixed colour, because names in the colours of bodies would be invisible on some backgrounds
        self._columns.send(self._names, now, rr.Points2D(names, labels=seen, colors=[GREY], radii=[0.0]))

    def _class(self, world: str, body: str) -> int:
        number = self._classes.get(body)
        if number is None:
            number = self._classes[body] = min(len(self._classes) + 1, _MAX_CLASSES)
            self._colors[body] = self._scene.color(world, body)
            classes = [
                rr.AnnotationInfo(id=id_, label=name, color=self._colors[name]) for name, id_ in self._classes.items()
            ]
            self._columns.send_static(self._path, rr.AnnotationContext([(0, "nothing near", (0, 0, 0)), *classes]))
        return number


PLACES: Final = "places"
_ABOVE: Final = 0.01  # height in m above the surface, so that the map doesn't hide the marks
_POINT: Final = 0.025  # radius in m
_TAKEN: Final = 0.05
_HEADING: Final = 0.15  # length in m of the arrow of a taken place
_ALPHA: Final = 150
_MAX_LABELS: Final = 200
_COLORS: Final = {TAKEN: GREEN, NOT_TRIED: GREY}


class QueryPlaces(Marks):
    """The map and the samples of the last query for places, until the next such query or motion."""

    def show(self, record: Query, now: TimePoint) -> None:
        """Show a query for places. If the map is invalid, ValueError is raised."""
        if not record.HasField("grid"):
            return
        self.clear(now)
        cells = _cells(record)
        if cells is not None:
            self.add(record.world, (PLACES, record.name, "map"), now, cells)
        spots = spots_of(record.grid) + np.array([0.0, 0.0, _ABOVE])
        if len(spots):
            names = list(fates(record))
            points = rr.Points3D(
                spots,
                colors=[_COLORS.get(name, RED) for name in names],
                radii=[_TAKEN if name == TAKEN else _POINT for name in names],
                labels=[fate.partition("|")[0] for fate in names] if len(names) <= _MAX_LABELS else None,
                show_labels=False,
            )
            self.add(record.world, (PLACES, record.name, "samples"), now, points)
            self.add(record.world, (PLACES, record.name, "taken"), now, *_taken(record, spots, names))


def _taken(record: Query, spots: NDArray[np.float64], names: list[str]) -> list[rr.AsComponents]:
    """Return the taken places with their headings; if no place was taken, a label above the map with the results."""
    text = fates_text(record)
    chosen = [number for number, name in enumerate(names) if name == TAKEN]
    if not chosen:
        return [rr.Points3D([spots.mean(axis=0)], colors=[RED], radii=[_POINT], labels=[text])]
    ways = [(math.cos(yaw), math.sin(yaw), 0.0) for yaw in (record.grid.spots[number].yaw for number in chosen)]
    vectors = np.array(ways) * _HEADING
    return [rr.Arrows3D(origins=spots[chosen], vectors=vectors, colors=[GREEN], radii=[_POINT / 2], labels=[text])]


def _cells(record: Query) -> rr.Mesh3D | None:
    """Return the cells with a score as coloured squares; None if there are no scores."""
    grid = record.grid
    scores = scores_of(grid)
    rows, columns = np.nonzero(scores)
    if not len(rows):
        return None
    x, y, z = grid.origin
    corners = np.stack([columns, rows], axis=1)[:, None, :] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    points = np.empty((len(rows), 4, 3), np.float32)
    points[..., :2] = corners * grid.resolution + (x, y)
    points[..., 2] = z + _ABOVE / 2
    share = scores[rows, columns][:, None]
    colors = np.empty((len(rows), 4), np.uint8)
    colors[:, :3] = share * np.array(GREEN) + (1.0 - share) * np.array(BLUE)
    colors[:, 3] = _ALPHA
    first = 4 * np.arange(len(rows), dtype=np.uint32)[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=points.reshape(-1, 3), triangle_indices=triangles, vertex_colors=np.repeat(colors, 4, axis=0)
    )


MAX_CELLS: Final = 1 << 20  # largest number of cells of a map. Most maps have some thousands of cells.
_FARTHEST: Final = 1e6  # maximum distance in m from the world's origin


def scores_of(grid: Grid) -> NDArray[np.float64]:
    """Return the scores 0..1 of a map's cells (height, width), lowest y first; raise ValueError for an invalid map."""
    width, height = grid.width, grid.height
    if width <= 0 or height <= 0 or width * height > MAX_CELLS:
        raise ValueError(f"invalid map: {width} x {height} cells")
    origin = list(grid.origin)
    if len(origin) != 3 or not all(math.isfinite(part) and abs(part) <= _FARTHEST for part in origin):
        raise ValueError(f"invalid map: the origin is {origin}")
    if not 0.0 < grid.resolution <= _FARTHEST:
        raise ValueError(f"invalid map: cells of {grid.resolution} m")
    try:
        content = zlib.decompressobj().decompress(grid.scores, width * height)
    except zlib.error as error:
        raise ValueError(f"invalid map: it can't be inflated: {error}") from error
    if len(content) != width * height:
        raise ValueError(f"invalid map: {width} x {height} cells with {len(content)} scores")
    return np.frombuffer(content, dtype=np.uint8).reshape(height, width) / 255.0


def spots_of(grid: Grid) -> NDArray[np.float64]:
    """Return the positions of a map's sampled places in m (n, 3). If a place is invalid, ValueError is raised."""
    positions = [list(spot.position) for spot in grid.spots]
    for spot, place in zip(grid.spots, positions, strict=True):
        if len(place) != 3 or not all(math.isfinite(part) and abs(part) <= _FARTHEST for part in place):
            raise ValueError(f"invalid place at {place}")
        if not math.isfinite(spot.yaw):
            raise ValueError(f"invalid place: its yaw is {spot.yaw}")
    return np.array(positions, dtype=np.float64).reshape(-1, 3)


_MAX_LETTERS: Final = 60
_ANSWERS: Final = "answers"
_NO: Final = ("false", "null", "[]", "")
#: Words for blocking, by the name of the evidence that contains the blocking bodies.
_BLOCKING: Final = {"obstacles": "is in the way", "hidden_by": "hides it"}


class QueryMarks(Marks):
    """Target, posture, contacts and obstacles of the last query, until the next task begins."""

    def hide_label(self, now: TimePoint) -> None:
        """Hide the label of the target, because it would be next to the label of a failure."""
        for path in self._paths:
            if path.endswith("/target"):
                self._columns.send(path, now, rr.Points3D.from_fields(show_labels=False))

    def show(self, record: Query, now: TimePoint) -> None:
        """Show a query."""
        self.clear(now)
        if not record.world:
            return
        values, evidence = argument_values(record.arguments, strict=True), argument_values(record.evidence, strict=True)
        if not values and not evidence:
            return
        good = not evidence["obstacles"] if "obstacles" in evidence else record.answer_json not in _NO
        for name, shape in self._shapes(record, values, evidence, GREEN if good else RED):
            self.add(record.world, (_ANSWERS, record.name, name), now, shape)

    def _shapes(
        self, record: Query, values: Values, evidence: Values, color: Color
    ) -> Iterator[tuple[str, rr.AsComponents]]:
        scene, world = self.scene, record.world
        body = target_position(scene, world, {name: value for name, value in values.items() if name != "camera"})
        target = position(evidence.get("position")) or body
        if target is not None:
            yield "target", points_at([target], color, [f"{record.name}: {by_name(record.answer_json)}"[:_MAX_LETTERS]])
        for fact, verb in _BLOCKING.items():
            names = evidence.get(fact)
            poses = {name: scene.pose(world, name) for name in names} if isinstance(names, dict) else {}
            positions = {name: pose[0] for name, pose in poses.items() if pose is not None}
            if positions:
                yield fact, points_at(list(positions.values()), RED, [f"{name} {verb}" for name in positions])
        robot_name = name_of(values.get("robot"))
        camera = camera_position(scene, world, values["camera"], robot_name) if "camera" in values else None
        if camera is not None and body is not None:
            yield "sight", line_through([camera, body], color)
        contacts = [point for value in evidence.get("points") or () if (point := position(value)) is not None]
        if contacts:
            yield "contacts", points_at(contacts, color)
        joints, link = evidence.get("joints"), values.get("gripper")
        if isinstance(joints, dict) and isinstance(link, str):
            posture = scene.posture(world, robot_name, link, joints)
            if posture:
                yield "posture", line_through(posture, color, LINK)
