"""Names of frames for other tools and the viewer: each body and link has its own name, in one tree."""

from __future__ import annotations

from urllib.parse import unquote

import pytest
from hypothesis import example, given, strategies as st

from recorder.records import Effect, LoadBody, Mutation
from recorder.records.motion import ROOT, Frame, FrameTree, frame_name

MODEL = b"""<robot name="arm"><link name="base"/><link name="a/b"/><link name="world"/>
<joint name="hinge" type="continuous"><parent link="base"/><child link="a/b"/><axis xyz="0 0 1"/></joint>
<joint name="two" type="fixed"><parent link="a/b"/><child link="world"/></joint></robot>"""

names = st.sampled_from(["world", "world_1", "w", "a", "a/b", "/", "%2F", "tf#", "%77orld"]) | st.text(
    st.characters(exclude_categories=["Cs"]), min_size=1
)


def meant(frame: str) -> tuple[str, str, str]:
    """World, body and link of a frame."""
    world, apart, rest = frame.partition("//")
    body, _, link = (rest if apart else frame).partition("/")
    return (unquote(world) if apart else "world_1"), unquote(body), unquote(link)


@given(world=names, body=names, link=names | st.just(""))
@example(world="world_1", body="world", link="")
@example(world="world", body="cup", link="")
@example(world="world_1", body="world", link="cup")
@example(world="world_1", body="tf#", link="x")
def test_a_frame_tells_what_it_is_of(world: str, body: str, link: str) -> None:
    frame = frame_name(world, body, link)
    assert meant(frame) == (world, body, link)
    assert frame != ROOT
    assert not frame.startswith("tf#/"), "so Rerun calls its own"


@pytest.mark.parametrize(
    ("parts", "name"),
    [
        (("world_1", "pr2"), "pr2"),
        (("world_1", "pr2", "l_gripper_tool_frame"), "pr2/l_gripper_tool_frame"),
        (("world_1", "breakfast cereal, größer"), "breakfast cereal, größer"),
        (("world_2", "pr2", "base_link"), "world_2//pr2/base_link"),
    ],
)
def test_ordinary_names_are_not_escaped(parts: tuple[str, ...], name: str) -> None:
    assert frame_name(*parts) == name


def frames_of(tree: FrameTree, record: Mutation) -> dict[str, Frame]:
    return {frame.child: frame for motion in tree.motions(record) for frame, _ in motion.frames}


@pytest.fixture
def tree() -> FrameTree:
    made = FrameTree()
    made.add_urdf("1", MODEL)
    return made


def loaded(body: str, asset: str = "1") -> Mutation:
    load = LoadBody(body=body)
    load.assets.add(sha256=asset)
    effect = Effect()
    effect.bodies.add(body=body, position=[0, 0, 0], orientation=[0, 0, 0, 1], joints=["hinge"], joint_positions=[0.5])
    return Mutation(world="world_1", load_body=load, effect=effect)


@pytest.mark.parametrize("body", ["arm", "world", "a/b", "a"])
def test_frames_form_a_tree_whatever_the_names_of_bodies_and_links(tree: FrameTree, body: str) -> None:
    frames = frames_of(tree, loaded(body))
    assert {frame.link for frame in frames.values()} == {"", "a/b", "world"}
    for name in list(frames):
        for _ in range(4):
            name = frames[name].parent if name in frames else name  # noqa: PLW2901
        assert name == ROOT


def test_a_body_that_is_loaded_again_has_the_links_of_its_new_model(tree: FrameTree) -> None:
    tree.add_urdf("2", b'<robot name="cup"><link name="cup"/></robot>')
    assert len(frames_of(tree, loaded("thing"))) == 3
    second = loaded("thing", "2")
    second.effect.bodies[0].ClearField("joints")
    second.effect.bodies[0].ClearField("joint_positions")
    assert list(frames_of(tree, second)) == ["thing"]


def test_only_frames_that_changed_are_listed(tree: FrameTree) -> None:
    frames_of(tree, loaded("arm"))
    moved = Mutation(world="world_1")
    moved.effect.bodies.add(body="arm", joints=["hinge"], joint_positions=[1.0])
    assert list(frames_of(tree, moved)) == ["arm/a%2Fb"]
