"""Forward kinematics of a chain, part by part: a second way beside that of its arm."""

import numpy as np
from scipy.spatial.transform import Rotation

from hilcell.fit.urdf_file import Chain
from hilcell.geometry.kinematics import Array


def chain_forward(chain: Chain, joints_rad: Array) -> Array:
    """Return the tip's frame in the root link, (..., 4, 4), for ``joints_rad`` (..., n)."""
    tips = [_tip(chain, each) for each in joints_rad.reshape(-1, len(chain.axes))]
    return np.reshape(tips, (*joints_rad.shape[:-1], 4, 4))


def _tip(chain: Chain, joints_rad: Array) -> Array:
    pose = np.eye(4)
    for number, (origin, axis) in enumerate(zip(chain.origins, chain.axes, strict=True)):
        motion, value = np.eye(4), joints_rad[number]
        if number in chain.prismatic:
            motion[:3, 3] = 1000.0 * value * axis
        else:
            motion[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
        pose = pose @ origin @ motion
    return pose @ chain.tip
