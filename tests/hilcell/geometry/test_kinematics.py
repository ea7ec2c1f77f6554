"""Forward kinematics against an independent composition of rotations and translations."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from hilcell.geometry.frames import pose_from_zyx
from hilcell.geometry.kinematics import Arm, forward, link_transforms


def arm_of(rng: np.random.Generator) -> Arm:
    return Arm(
        a_mm=rng.uniform(-1000, 1000, 6),
        alpha_rad=rng.uniform(-np.pi, np.pi, 6),
        d_mm=rng.uniform(-1000, 1000, 6),
        offset_rad=rng.uniform(-np.pi, np.pi, 6),
        sign=rng.choice([-1.0, 1.0], 6),
        tool=pose_from_zyx(*rng.uniform(-200, 200, 3), *rng.uniform(-180, 180, 3)),
        beta_rad=rng.uniform(-0.1, 0.1, 6),
    )


def peer_link(arm: Arm, row: int, joint: float) -> RigidTransform:
    """Return Rot(z) Trans(z) Trans(x) Rot(x) Rot(y) as a product of five motions."""
    theta = arm.sign[row] * joint + arm.offset_rad[row]
    return (
        RigidTransform.from_rotation(Rotation.from_euler("z", theta))
        * RigidTransform.from_translation([0, 0, arm.d_mm[row]])
        * RigidTransform.from_translation([arm.a_mm[row], 0, 0])
        * RigidTransform.from_rotation(Rotation.from_euler("x", arm.alpha_rad[row]))
        * RigidTransform.from_rotation(Rotation.from_euler("y", arm.beta_rad[row]))
    )


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_forward_agrees_with_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, joints = arm_of(rng), rng.uniform(-np.pi, np.pi, (3, 6))
    for q, pose, links in zip(
        joints, forward(arm, joints), link_transforms(arm, joints), strict=True
    ):
        peer = RigidTransform.identity()
        for row in range(6):
            link = peer_link(arm, row, q[row])
            np.testing.assert_allclose(links[row], link.as_matrix(), atol=1e-9)
            peer = peer * link
        np.testing.assert_allclose(pose, peer.as_matrix() @ arm.tool, atol=1e-8)
