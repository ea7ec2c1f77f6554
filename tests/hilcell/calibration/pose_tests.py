"""A result of the pose test of ISO 9283 that was not measured."""

from __future__ import annotations

from hilcell.calibration.iso9283 import Cube, Distance, Pose, PoseTest, WorstPoses


def made_up() -> PoseTest:
    """Return a test of two poses, without angles and limits."""
    poses = {
        "P1": Pose(
            [1850.0, 0.0, 950.0], 30, 1.21, 0.7, 0.7, 0.7, 0.149, 0.066, 0.011, 0.06, 0.03, 0.01
        ),
        "P3": Pose(
            [1490.0, 360.0, 1310.0], 30, 1.504, 0.9, 0.9, 0.8, 0.149, 0.075, 0.011, 0.07, 0.03, 0.01
        ),
    }
    return PoseTest(
        cycles=30,
        velocity_percent=100.0,
        load_kg=None,
        rated_load_kg=None,
        warm_up_min=None,
        stabilisation_s=0.5,
        temperature_c=None,
        tracker_noise_mm=0.01,
        corrected_by="",
        cube=Cube(900.0, [1850.0, 0.0, 950.0], "C1-C2-C7-C8"),
        poses=poses,
        distance=Distance("P2", "P4", 1247.1, 0.3871, 0.2, 0.2, 0.2, 0.0375, 0.0728, 0.0191),
        worst=WorstPoses(1.504, 0.149, "P3", 0.075, 0.011, "P3"),
        orientation={},
        not_measured=["AP_a", "AP_b", "AP_c", "RP_a", "RP_b", "RP_c"],
        deviations=["the load is not stated (iso9283.load_kg, iso9283.rated_load_kg)"],
        limits={},
    )
