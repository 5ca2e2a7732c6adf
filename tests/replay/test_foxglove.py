"""Recordings for Foxglove, read by Foxglove's own packages."""

from __future__ import annotations

import io
import json
import random
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import trimesh
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import make_reader

import replay
from recorder import geometry
from recorder.records.motion import frame_name
from recorder.urdf import read_shapes
from replay.cli.main import main
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mcap.reader import DecodedMessageTuple

    from recorder.geometry import Pose
    from replay.recording import Recording

pytestmark = pytest.mark.needs("Foxglove")

GOLDEN = Path(__file__).parent / "golden"
PLANS = ("demos/0.1.0-fails_to_reach", "motions/0.1.0", "checks/0.1.0")


class Exported:
    """A recording, and what Foxglove reads of its export."""

    def __init__(self, log: Recording, file: Path) -> None:
        self.log = log
        self.layout = json.loads(file.with_suffix(".layout.json").read_text())
        from mcap_protobuf.decoder import DecoderFactory  # noqa: PLC0415  a module of the extra dev

        with file.open("rb") as opened:
            reader = make_reader(opened, decoder_factories=[DecoderFactory()])
            self.messages = list(reader.iter_decoded_messages(log_time_order=False))

    def on(self, topic: str) -> list[DecodedMessageTuple]:
        return [each for each in self.messages if each.channel.topic.startswith(topic)]


@pytest.fixture(scope="module", params=PLANS)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Exported]:
    file, run = tmp_path_factory.mktemp("foxglove") / "run.mcap", GOLDEN / f"{request.param}.mcap"
    assert main(["export", str(run), "--to", "foxglove", str(file)]) == 0
    with replay.open(run) as log:
        yield Exported(log, file)


def test_messages_have_foxglove_s_schemas_and_times_never_decrease(exported: Exported) -> None:
    from foxglove import messages as schemas  # noqa: PLC0415  a module of the extra dev

    before = 0
    for each in exported.messages:
        name, sent = each.decoded_message.DESCRIPTOR.full_name, each.message
        schema = getattr(schemas, name.removeprefix("foxglove.")).get_schema()
        pool = descriptor_pool.DescriptorPool()
        for described in FileDescriptorSet.FromString(schema.data).file:
            pool.Add(described)
        ours = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(sent.data)
        assert ours.SerializeToString() == sent.data
        assert not len(UnknownFieldSet(ours))
        assert before <= sent.log_time
        before = sent.log_time
        stamps = [frame.timestamp for frame in ours.transforms] if each.channel.topic == "/tf" else []
        assert {stamp.seconds * 1_000_000_000 + stamp.nanos for stamp in stamps} <= {sent.log_time}


def places(exported: Exported, until: int) -> dict[str, Pose]:
    """The poses in the world of all frames, after a number of messages on /tf."""
    latest = {
        each.child_frame_id: each for sent in exported.on("/tf")[:until] for each in sent.decoded_message.transforms
    }

    def pose(frame: str) -> Pose:
        if frame == "world":
            return geometry.IDENTITY
        at, turn = latest[frame].translation, latest[frame].rotation
        here = (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w)
        return geometry.multiply(pose(latest[frame].parent_frame_id), here)

    return {frame: pose(frame) for frame in latest}


def test_entities_are_connected_and_poses_are_those_of_the_state(exported: Exported) -> None:
    frames = exported.on("/tf")
    known = places(exported, len(frames))
    assert all(entity.frame_id in {"world", *known} for each in exported.messages for entity in entities(each))
    steps = [each.message.sequence for each in frames]
    ends = [at for at in range(1, len(steps) + 1) if steps[at - 1] != [*steps, -1][at]]
    dice = random.Random(1)
    for at in dice.sample(ends, min(20, len(ends))):
        same(places(exported, at), exported.log.state_at(steps[at - 1]))
    within = [at for at in range(2, len(steps)) if at not in ends and steps[at - 2] == steps[at - 1]]
    for at in dice.sample(within, min(20, len(within))):
        step, now = steps[at - 1], frames[at - 1].message.log_time
        end = frames[next(end for end in ends if end > at) - 1].message.log_time
        sampled = exported.log.state_at(step)
        moment = sampled.world(exported.log[step].world).seconds - (end - now) / 1e9
        same(places(exported, at), state_at(exported.log, step - 1, moment + 1e-6))
    assert within or "motions" not in str(exported.log.path), "moments within a simulation"


def same(found: dict[str, Pose], state: Any) -> None:
    for world in state.worlds.values():
        for body in world.bodies.values():
            for link, (position, orientation) in state.link_poses(body).items():
                frame = frame_name(world.name, body.name, "" if link == state.urdf(body).root else link)
                assert found[frame][0] == pytest.approx(position, abs=1e-9)
                assert geometry.angle(found[frame][1], orientation) < 1e-6


def entities(each: DecodedMessageTuple) -> list[Any]:
    return list(getattr(each.decoded_message, "entities", ()))


def test_models_are_the_meshes_of_the_scene(exported: Exported) -> None:
    wanted = defaultdict(list)
    for name in exported.log.assets:
        for shapes in read_shapes(exported.log.assets[name], "visual").values() if name.endswith(".urdf") else ():
            for shape in shapes:
                if shape.kind == "mesh":
                    wanted[shape.size].append(triangles(exported.log.assets[shape.mesh], shape.mesh[-3:]))
    models = [model for each in exported.messages for entity in entities(each) for model in entity.models]
    assert bool(models) == bool(wanted)
    for model in models:
        x, y, z = triangles(model.data, "glb").T
        turned = np.stack((x, -z, y), axis=0).T  # the y axis of GLB points up
        meshes = wanted[model.scale.x, model.scale.y, model.scale.z]
        assert any(mesh.shape == turned.shape and np.allclose(mesh, turned, atol=1e-6) for mesh in meshes)


def triangles(content: bytes, suffix: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    mesh: Any = trimesh.load(io.BytesIO(content), file_type=suffix, force="mesh", process=False)
    return np.asarray(mesh.vertices[mesh.faces])


def test_the_old_pose_is_repeated_before_a_change(exported: Exported) -> None:
    """Foxglove interpolates between poses; without the old pose, an object would glide to its new place."""
    latest: dict[str, Any] = {}
    for each in exported.on("/tf"):
        for frame in each.decoded_message.transforms:
            old = latest.get(frame.child_frame_id, frame)
            if (old.translation, old.rotation) != (frame.translation, frame.rotation):
                gap = frame.timestamp.ToNanoseconds() - old.timestamp.ToNanoseconds()
                assert gap <= 1 or exported.log[each.message.sequence].HasField("simulate")
            latest[frame.child_frame_id] = frame


def test_tasks_failures_and_properties_are_shown(exported: Exported) -> None:
    states = [each.decoded_message.value for each in exported.on("/task/")]
    labels = [text.text for each in exported.on("/failures") for entity in entities(each) for text in entity.texts]
    if "demos" in str(exported.log.path):
        assert {"pick-up", "pick-up failed", ""} <= set(states)
        assert labels[-1].startswith("PickUp failed: Unreachable: right arm can't reach")
    properties = [(each.channel.topic, each.decoded_message.value) for each in exported.on("/property/")]
    if "checks" in str(exported.log.path):
        assert ("/property/1", "violated") in properties


def panels(content: dict[str, Any]) -> list[dict[str, Any]]:
    from foxglove import layouts  # noqa: PLC0415  a module of the extra dev

    if content["type"] == "panel":
        return [content]
    assert content.keys() == layouts.SplitContainer(items=[])._to_dict().keys()
    return [panel for item in content["items"] for panel in panels(item["content"])]


def test_the_layout_has_foxglove_s_form_and_topics_of_the_file(exported: Exported) -> None:
    from foxglove import layouts  # noqa: PLC0415  a module of the extra dev

    assert exported.layout.keys() <= layouts.Layout(content=layouts.LogPanel())._to_dict().keys()
    topics = {each.channel.topic for each in exported.messages}
    for panel in panels(exported.layout["content"]):
        kind, config = panel["panelType"], panel["config"]
        known = getattr(layouts, f"{kind}Panel")()._to_dict()
        assert panel.keys() <= known.keys()
        assert (panel["panelType"], panel["version"]) == (known["panelType"], known["version"])
        assert config.keys() <= known["config"]._to_dict().keys()
        shown = [path["value"].partition(".")[0] for path in config.get("paths", ())]
        assert {*shown, *config.get("topics", ()), config.get("topicToRender", "/log")} <= topics | {"/failures"}


def test_files_are_only_replaced_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["export", str(GOLDEN / "0.1.0.mcap"), "--to", "foxglove", str(tmp_path / "run.mcap")]
    (tmp_path / "run.layout.json").write_text("mine")
    assert main(command) == 2
    assert "run.layout.json exists; name another file, or add --overwrite" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["run.layout.json"]
    assert main([*command, "--overwrite"]) == 0
    assert main(command) == 2
