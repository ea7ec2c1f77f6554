"""URDF in: the arm that an independent reader finds. URDF out: only joint origins differ."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilcell.cell.settings import SettingsError
from hilcell.fit.urdf_file import Chain, Urdf, read_robot, read_urdf, urdf_of
from hilcell.geometry.frames import matrix
from hilcell.geometry.kinematics import Arm, Array, forward
from tests.hilcell.fit.chains import chain_forward
from tests.hilcell.fit.urdfs import IRB120, ON_RAIL, PLAIN, reached_m
from tests.hilcell.geometry.test_kinematics import chain_of as random_arm

NAMES = [f"joint_{n}" for n in range(1, 7)]
JOINTS = np.random.default_rng(1).uniform(-2, 2, (5, 6))
EXACT_M = 2e-12  # what twelve decimals leave, in m and as a rotation
ORIGIN = re.compile(r"<origin[^>]*>")
Write = Callable[[str | bytes], Path]


@pytest.fixture
def written(tmp_path: Path) -> Write:
    def write(text: str | bytes) -> Path:
        path = tmp_path / "robot.urdf"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


def in_m(poses_mm: Array) -> Array:
    poses = poses_mm.copy()
    poses[..., :3, 3] /= 1000
    return poses


def peer(
    text: str | bytes, tip: str = "tool0", names: list[str] = NAMES, joints: Array = JOINTS
) -> Array:
    return np.array([reached_m(text, dict(zip(names, q, strict=True)), tip) for q in joints])


def crooked(arm: Arm, rng: np.random.Generator) -> Arm:
    """An arm with the errors of a real robot: lengths 1 mm, angles 2 mrad."""
    count = len(arm)
    return replace(
        arm,
        a_mm=arm.a_mm + rng.normal(0, 1, count),
        d_mm=arm.d_mm + rng.normal(0, 1, count),
        alpha_rad=arm.alpha_rad + rng.normal(0, 2e-3, count),
        offset_rad=arm.offset_rad + rng.normal(0, 2e-3, count),
        beta_rad=arm.beta_rad + rng.normal(0, 2e-3, count),
    )


def problem_of(path: Path, tip: str = "", base: str = "") -> str:
    with pytest.raises(SettingsError) as caught:
        read_urdf(path, tip, base)
    return str(caught.value)


def test_a_robot_is_read_as_an_independent_reader_does(written: Write) -> None:
    urdf = read_urdf(written(IRB120))
    assert (urdf.name, urdf.root, urdf.tip) == ("IRB 120", "base_link", "tool0")
    np.testing.assert_allclose(in_m(chain_forward(urdf.chain, JOINTS)), peer(IRB120), atol=1e-12)
    base, arm = urdf.chain.arm()
    np.testing.assert_allclose(in_m(base @ forward(arm, JOINTS)), peer(IRB120), atol=1e-12)
    np.testing.assert_array_equal(urdf.limits_rad[:, 3], [-np.inf, np.inf])
    np.testing.assert_array_equal(urdf.limits_rad[:, 2], [-1.91986, 1.22173])


def test_rows_of_a_usual_robot_are_those_of_its_data_sheet(written: Write) -> None:
    plain = PLAIN.replace('xyz="0 0 0.27"', 'xyz="0 0.1 0.27"')
    _, arm = read_urdf(written(plain)).chain.arm()
    np.testing.assert_allclose(arm.a_mm, [0, 270, 70, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.degrees(arm.alpha_rad)), [90, 0, 90, 90, 90, 0], atol=1e-8)
    np.testing.assert_allclose(np.abs(arm.d_mm), [290, 100, 0, 302, 0, 72], atol=1e-9)


def calibrated(urdf: Urdf) -> tuple[bytes, Array]:
    """The file of the same robot with errors, and where its tip then is, in m."""
    base, arm = urdf.chain.arm()
    chain = Chain.of(base, crooked(arm, np.random.default_rng(2))).beside(urdf.chain)
    return urdf.with_chain(chain, ["found", "by a fit"]), in_m(chain_forward(chain, JOINTS))


@pytest.mark.parametrize("tip", ["tool0", "far"])
def test_a_calibrated_file_has_the_wanted_arm(written: Write, tip: str) -> None:
    far = (
        '<link name="far"/><joint name="f" type="fixed"><parent link="tool0"/><child link="far"/>'
        '<origin xyz="0.1 0.2 0.3" rpy="1 2 3"/></joint></robot>'
    )
    text = IRB120 if tip == "tool0" else IRB120.replace("</robot>", far)
    content, wanted = calibrated(read_urdf(written(text)))
    np.testing.assert_allclose(peer(content, tip), wanted, atol=EXACT_M)
    assert np.abs(peer(content, tip) - peer(text, tip)).max() > 1e-4
    again = read_urdf(written(content))
    np.testing.assert_allclose(in_m(chain_forward(again.chain, JOINTS)), wanted, atol=EXACT_M)


def test_a_tip_without_a_fixed_joint_leaves_its_own_frame_over(written: Write) -> None:
    urdf = read_urdf(written(IRB120), "link_6")
    content, wanted = calibrated(urdf)
    base, arm = urdf.chain.arm()
    bent = Chain.of(base, crooked(arm, np.random.default_rng(2))).beside(urdf.chain)
    left = in_m(urdf.left_at_tip(bent))
    assert 1e-4 < np.abs(left - np.eye(4)).max() < 1e-2
    np.testing.assert_allclose(peer(content, "link_6") @ left, wanted, atol=EXACT_M)
    np.testing.assert_array_equal(read_urdf(written(IRB120)).left_at_tip(urdf.chain), np.eye(4))


def test_nothing_but_origins_of_the_chain_is_changed(written: Write) -> None:
    content, _ = calibrated(read_urdf(written("\ufeff" + IRB120.replace("\n", "\r\n"))))
    text = content.decode("utf-8-sig").replace("\r\n", "\n")
    comment = "\n  <!-- found\n    by a fit -->"
    assert text.count(comment) == 1
    text = text.replace(comment, "")
    added = re.findall(r'\n    <origin[^>]*/>(?=\n    <parent link="link_3"/>)', text)
    assert len(added) == 1
    text = text.replace(added[0], "")
    assert ORIGIN.sub("<origin>", text) == ORIGIN.sub("<origin>", IRB120)
    same = ['xyz="9 9 9"', 'xyz="0 0 0" rpy="0 0 0"', 'xyz="0.134 0 0.07" rpy="0.1 0.2 0.3"']
    kept = [f"<origin {each}/>" for each in [*same, 'xyz="x"']]
    assert [tag for tag in ORIGIN.findall(text) if tag in IRB120] == kept


def test_an_arm_without_a_file_gets_one(written: Write) -> None:
    base, arm = read_urdf(written(IRB120)).chain.arm()
    arm = replace(crooked(arm, np.random.default_rng(2)), sign=np.array([1.0, -1, 1, 1, -1, 1]))
    content = urdf_of('a "robot" <1>', Chain.of(base, arm), ["never -- or --->"])
    wanted = in_m(base @ forward(arm, JOINTS))
    np.testing.assert_allclose(peer(content), wanted, atol=EXACT_M)
    assert read_urdf(written(content)).name == 'a "robot" <1>'


BRANCH = (
    '<joint name="b" type="fixed"><parent link="link_6"/><child link="camera"/></joint></robot>'
)
MORE = "".join(
    f'<joint name="more_{n}" type="revolute"><parent link="{parent}"/><child link="l{n}"/></joint>'
    for n, parent in enumerate(("tool0", "l0", "l1", "l2"))
)
LOOP = (
    '<joint name="l" type="fixed"><parent link="tool0"/><child link="base_link"/></joint></robot>'
)
PARENTS = (
    '<joint name="l" type="fixed"><parent link="tool0"/><child link="link_3"/></joint></robot>'
)
MANY = "".join(
    f'<joint name="m{n}" type="fixed"><parent link="tool0"/><child link="x{n}"/></joint>'
    for n in range(1000)
)
JOINT_2 = '<joint name="joint_2" type="revolute">'


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("</robot>", "", "XML"),
        ("</robot>", BRANCH, "camera, tool0"),
        ("</robot>", MORE + "</robot>", "10 moving"),
        ("</robot>", LOOP, "loop"),
        ("</robot>", PARENTS, "link_3 .*joint_3, l"),
        ("</robot>", MANY + "</robot>", "1008"),
        (JOINT_2, JOINT_2.replace("revolute", "planar"), "joint_2"),
        (JOINT_2, JOINT_2 + '<mimic joint="joint_1"/>', "joint_2"),
        (JOINT_2, JOINT_2 + "<origin/>", "joint_2"),
        ('<child link="link_2"/>', "", "joint_2"),
        ("0 0 0.27", "0 0 nan", "joint_3: origin xyz"),
        ("0 0 0.27", "0 0 1e300", "joint_3: origin xyz"),
        ("0 0 0.27", "0 0", "joint_3: origin xyz"),
        ("0 0 0.27", "0 0 ${d}", "xacro"),
        ("0 0 0.27", "0 0 270", "metres"),
        ("0.1 0.2 0.3", "0 90 0", "forearm: origin rpy"),
        ('xyz="0 0 0.27"', 'quat_xyzw="0 0 0 1"', "quat_xyzw"),
        ("0 2 0", "0 0 0", "joint_3: axis"),
        ('lower="-1.91986" upper="1.22173"', 'lower="1" upper="1"', "lower 1"),
        ('lower="-1.91986" upper="1.22173"', 'lower="nan" upper="1"', "lower"),
    ],
)
def test_odd_files_are_refused_by_name(written: Write, old: str, new: str, named: str) -> None:
    assert old in IRB120
    said = problem_of(written(IRB120.replace(old, new)))
    assert re.search(named, said), said
    assert "robot.urdf" in said


@pytest.mark.parametrize(
    "text",
    [
        "",
        "solid cube",
        "<robot/>",
        "<sdf/>",
        IRB120.encode("utf-16"),
        IRB120.replace("<robot", '<!DOCTYPE robot [<!ENTITY a "b">]><robot', 1),
        "<robot>" + 100_000 * "<a>",
        IRB120.replace("UTF-8", "Shift_JIS").encode("shift_jis"),
        IRB120.replace("UTF-8", "GBK").encode("gbk"),
        IRB120.replace("UTF-8", "none-such"),
    ],
    ids=[
        "empty",
        "no XML",
        "no joint",
        "another root",
        "UTF-16",
        "document type",
        "too deep",
        "two bytes a letter",
        "one or two bytes",
        "unknown encoding",
    ],
)
def test_what_is_no_urdf_is_refused(written: Write, text: str | bytes) -> None:
    assert "robot.urdf" in problem_of(written(text))


def test_a_tip_is_chosen_by_name(written: Write) -> None:
    text = IRB120.replace("</robot>", BRANCH)
    assert read_urdf(written(text), "camera").tip == "camera"
    longer = IRB120.replace("</robot>", MORE + "</robot>")
    assert read_urdf(written(longer), "tool0").tip == "tool0"
    assert len(read_urdf(written(longer), "l2").arm) == 9
    assert "10 moving" in problem_of(written(longer), "l3")
    assert "base_link, " in problem_of(written(text), "nose")


def test_an_arm_on_a_rail_is_one_chain(written: Write) -> None:
    urdf = read_urdf(written(ON_RAIL))
    assert (urdf.root, urdf.arm.prismatic, len(urdf.arm)) == ("floor", (0,), 7)
    np.testing.assert_array_equal(urdf.limits_rad[:, 0], [-2.5, 4.0])
    names = ["rail", *NAMES]
    joints = np.random.default_rng(3).uniform(-2, 2, (5, 7))
    wanted = peer(ON_RAIL, names=names, joints=joints)
    np.testing.assert_allclose(in_m(urdf.poses(joints)), wanted, atol=1e-12)
    bent = Chain.of(urdf.base, replace(crooked(urdf.arm, np.random.default_rng(2)), tool=urdf.tool))
    chain = bent.beside(urdf.chain)
    moved = in_m(chain_forward(bent, joints))
    again = peer(urdf.with_chain(chain, ["x"]), names=names, joints=joints)
    np.testing.assert_allclose(again, moved, atol=EXACT_M)
    plain = urdf_of("r", bent, ["x"])
    names = [f"joint_{n}" for n in range(1, 8)]
    np.testing.assert_allclose(peer(plain, names=names, joints=joints), moved, atol=EXACT_M)
    assert read_urdf(written(plain)).arm.prismatic == (0,)


def test_a_base_leaves_out_the_joints_below_it(written: Write) -> None:
    urdf = read_urdf(written(ON_RAIL), base="base_link")
    assert (urdf.root, len(urdf.arm)) == ("base_link", 6)
    np.testing.assert_allclose(in_m(urdf.poses(JOINTS)), peer(IRB120), atol=1e-12)
    forearm = read_urdf(written(ON_RAIL), "link_6", "link_3")
    assert (forearm.root, forearm.tip, len(forearm.arm)) == ("link_3", "link_6", 3)
    text = ON_RAIL.replace("</robot>", BRANCH)
    assert "link_6 to link_2" in problem_of(written(text), "link_2", "link_6")
    assert "links: base_link, " in problem_of(written(text), "tool0", "ground")
    assert "camera, tool0" in problem_of(written(text))


def test_of_several_chains_the_only_one_of_six_revolute_joints_is_taken(written: Write) -> None:
    finger = (
        '<joint name="finger" type="prismatic"><parent link="link_6"/><child link="tip"/></joint>'
    )
    text = IRB120.replace("</robot>", finger + "</robot>")
    assert read_urdf(written(text)).tip == "tool0"
    assert len(read_urdf(written(text), "tip").arm) == 7
    on_rail = ON_RAIL.replace("</robot>", finger + "</robot>")
    assert "tip, tool0" in problem_of(written(on_rail))


@pytest.mark.parametrize("named", [("x",), ("", "x"), ("", "", -1.0)])
def test_rows_have_no_links(tmp_path: Path, named: tuple[Any, ...]) -> None:
    with pytest.raises(SettingsError, match="is of a URDF"):
        read_robot(tmp_path / "robot.toml", *named)


def test_a_coupling_is_of_revolute_joints(written: Write) -> None:
    assert read_robot(written(IRB120), coupling=-1.0).arm.coupling == -1.0
    with pytest.raises(SettingsError, match="at least 3 revolute joints, got 2"):
        read_robot(written(IRB120), "link_3", "link_1", 1.0)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.urdf", tmp_path):
        assert str(path) in problem_of(path)


EXACT = 1e-9  # mm, and of a rotation's elements
SEEDS = st.integers(0, 2**32 - 1)
AXES = np.vstack([np.eye(3), -np.eye(3)])


def random_chain(rng: np.random.Generator) -> Chain:
    """Axes in any direction, or as robots have them: parallel, opposite, crossing, in one line."""
    count = int(rng.integers(1, 10))
    frames = [_frame(rng) for _ in range(count + 1)]
    axes = [AXES[rng.integers(6)] if rng.random() < 0.8 else _unit(rng) for _ in range(count)]
    prismatic = tuple(np.flatnonzero(rng.random(count) < 0.3).tolist())
    return Chain(np.array(frames[:-1]), np.array(axes), frames[-1], prismatic)


def _frame(rng: np.random.Generator) -> Array:
    shift = rng.uniform(-1000, 1000, 3) * (rng.random(3) < 0.5)
    quarter = Rotation.from_euler("zyx", rng.integers(-2, 3, 3) * 90, degrees=True)
    slight = Rotation.from_rotvec(rng.normal(size=3) * rng.choice([0.0, 1e-12, 1e-4, 0.1, 2.0]))
    return matrix((quarter * slight).as_matrix(), shift)


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def joints_of(rng: np.random.Generator, chain: Chain | Arm) -> Array:
    count = len(chain) if isinstance(chain, Arm) else len(chain.axes)
    return rng.uniform(-np.pi, np.pi, (5, count))


@given(SEEDS)
def test_every_chain_is_an_arm_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain = random_chain(rng)
    base, arm = chain.arm()
    joints = joints_of(rng, chain)
    np.testing.assert_allclose(
        base @ forward(arm, joints), chain_forward(chain, joints), atol=EXACT
    )


@given(SEEDS)
def test_rows_of_axes_that_are_not_parallel_are_standard_dh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, arm = random_chain(rng).arm()
    crossing = np.abs(np.sin(arm.alpha_rad)) > 0.11
    np.testing.assert_array_equal(arm.beta_rad[crossing], 0.0)
    assert (np.abs(arm.beta_rad) <= 0.11).all()
    assert (arm.a_mm >= 0.0).all()
    assert (np.abs(np.column_stack([arm.a_mm, arm.d_mm])) < 1e5).all()


@given(SEEDS)
def test_every_arm_is_a_chain_exactly_and_returns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, base = random_arm(rng), _frame(rng)
    chain, joints = Chain.of(base, arm), joints_of(rng, arm)
    wanted = base @ forward(arm, joints)
    np.testing.assert_allclose(chain_forward(chain, joints), wanted, atol=EXACT)
    base, arm = chain.arm()
    np.testing.assert_allclose(base @ forward(arm, joints), wanted, atol=EXACT)


@given(SEEDS)
def test_a_chain_beside_another_keeps_its_motion_and_takes_the_other_s_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nominal = random_chain(rng)
    base, arm = nominal.arm()
    joints, bent = joints_of(rng, arm), Chain.of(base, crooked(arm, rng))
    found = bent.beside(nominal)
    np.testing.assert_allclose(
        chain_forward(found, joints), chain_forward(bent, joints), atol=EXACT
    )
    np.testing.assert_array_equal(found.axes, nominal.axes)
    assert np.abs(found.origins[:, :3, :3] - nominal.origins[:, :3, :3]).max() < 0.05


@pytest.mark.parametrize("axis", AXES)
def test_a_chain_beside_itself_is_itself(axis: Array) -> None:
    rng = np.random.default_rng(5)
    chain = random_chain(rng)
    chain.axes[:] = axis
    base, arm = chain.arm()
    found = Chain.of(base, arm).beside(chain)
    np.testing.assert_allclose(found.origins, chain.origins, atol=EXACT)
    np.testing.assert_allclose(found.tip, chain.tip, atol=EXACT)
