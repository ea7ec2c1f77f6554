"""Forward kinematics of a chain, part by part: a second way beside that of its arm."""

import numpy as np
from scipy.spatial.transform import Rotation

from hilcell.fit.urdf_file import Chain
from hilcell.geometry.kinematics import Array


def chain_forward(chain: Chain, joints_rad: Array) -> Array:
    """Return the tip's frame in the root link, (..., 4, 4), for ``joints_rad`` (..., 6)."""
    tips = [_tip(chain, each) for each in joints_rad.reshape(-1, 6)]
    return np.reshape(tips, (*joints_rad.shape[:-1], 4, 4))


def _tip(chain: Chain, joints_rad: Array) -> Array:
    pose = np.eye(4)
    for origin, axis, angle in zip(chain.origins, chain.axes, joints_rad, strict=True):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix()
        pose = pose @ origin @ turn
    return pose @ chain.tip
