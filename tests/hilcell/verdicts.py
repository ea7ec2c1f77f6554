"""Verdicts and frames of every type, complete as a journal needs them.

A test that wants others replaces the fields that it is about.
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec.structs import replace

from hilcell.model.frame import Frame, MeasuredBase, MeasuredStation, TouchedBase, frame_type
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import (
    AxesJudged,
    Backlash,
    Cause,
    ChangedSince,
    CurvesUsed,
    DriftJudged,
    DriverConforms,
    FaceError,
    Faces,
    FacesCompared,
    Fitted,
    Judged,
    LengthsChecked,
    LostMotionJudged,
    MeasuredLength,
    MeasuredReflector,
    Oriented,
    Parameter,
    PoseTested,
    Proved,
    Rechecked,
    ReflectorsCompared,
    Revisited,
    SignChecked,
    StripRepeats,
    Suspected,
    Suspicion,
    Touched,
    Verdict,
)
from hilcell.ports import Array

JUDGED = Judged(
    holds=True,
    mean_mm=0.05,
    mean_tolerance_mm=0.12,
    max_mm=0.1,
    max_tolerance_mm=0.3,
    mean_U_mm=0.04,
    max_U_mm=0.05,
    decided=Outcome.ACCEPTED,
    decision=Outcome.ACCEPTED.decision,
)
UNDECIDED = replace(
    JUDGED,
    holds=False,
    mean_mm=0.1,
    decided=Outcome.UNDECIDED,
    decision=Outcome.UNDECIDED.decision,
)
REJECTED = replace(
    JUDGED, holds=False, mean_mm=0.2, decided=Outcome.REJECTED, decision=Outcome.REJECTED.decision
)
FITTED = Fitted(
    holds=True,
    method="trilinear",
    loocv={"trilinear": {"mean": 0.04, "p95": 0.08, "max": 0.1}},
    reason="least miss",
    refused={},
    curves=CurvesUsed(used=False, reason="no sweeps"),
    outliers=[],
)
SIGN = SignChecked(holds=True, limit=0.5, before_mm=1.0, corrected_mm=0.1, ratio=0.1)
DOUBLED = replace(SIGN, holds=False, corrected_mm=2.0, ratio=2.0)
RECHECKED = Rechecked(holds=True, verdict="valid", drift_mm=0.02, drift_u_mm=0.01, doubt="")
UPDATED = replace(RECHECKED, verdict="update", drift_mm=0.3)
REDO = replace(RECHECKED, holds=False, verdict="redo", drift_mm=0.9)
TOUCHED = Touched(holds=True, station="S300")
SUSPICION = Suspicion(cause=Cause.TRACKER_MOVED, size=0.3, unit="mm", noticed_by="revisited poses")
REVISITED = Revisited(holds=True, ratio=1.0, limit=2.0, suspicion=None, suspected=[])
SUSPECTED = Suspected(holds=False, suspected=[SUSPICION.text])
BACKLASH = Backlash(holds=True, found_mm=0.2, limit_mm=0.4)
STRIP = StripRepeats(holds=True, found_mm=0.01, limit_mm=0.05)
SINCE = ChangedSince(holds=True, before="1-made", suspected=[], beyond=[], compared=9)
POSE_TESTED = PoseTested(holds=True, ap_mm=0.05, ap_u95_mm=0.02, ap_limit_mm=0.2)
LOST_MOTION = LostMotionJudged(
    holds=True,
    mean_mm=0.03,
    max_mm=0.05,
    points=4,
    lost_urad=[4.0, 5.0, 6.0],
    U_urad=[9.0, 9.0, 9.0],
    limit_urad=60.0,
)
LENGTHS = LengthsChecked(
    holds=True, lengths=[MeasuredLength(("N1", "N2"), 1000.0, 1000.01, 0.05)], wrong=[]
)
FACES = FacesCompared(
    holds=True, nests=[Faces("N1", 0.01, -0.02, 0.1)], summary="N1 differs most", wrong=[]
)
REFLECTORS = ReflectorsCompared(
    holds=True, reflectors=[MeasuredReflector("cube", 0.01, 0.02, 0.1, 0.01)], wrong=[]
)
TRACKER_AXES = AxesJudged(
    holds=False,
    nests=[FaceError("N1", 3000.0, -20.0, 0.05, -0.02, 0.001, 0.002, 0.004, 0.015)],
    collimation_urad=12.0,
    collimation_U_urad=2.0,
    transit_urad=None,
    transit_U_urad=None,
    index_urad=-3.0,
    index_U_urad=1.0,
)
TRACKER_DRIFT = DriftJudged(
    holds=True,
    nest="N1",
    minutes=10.0,
    points=21,
    trend_mm=(0.001, 0.004, -0.002),
    trend_U_mm=0.006,
    range_mm=0.012,
    noise_mm=0.003,
    limit_mm=0.02,
)
ORIENTED = Oriented(holds=True, before_mean_deg=0.05, mean_deg=0.01, reflectors_moved_mm=0.003)
PROVED = Proved(
    holds=False,
    found="opposite directions",
    expected="one direction",
    values={"rail.options.counts_per_mm": -1000.0},
)
CONFORMS = DriverConforms(holds=True, driver="lines", broken=[])

# One of each type, with optional fields as well, by its keys.
VERDICTS: dict[str, Verdict] = {
    "validation.S1100": JUDGED,
    "validation.S300": UNDECIDED,
    "validation.others": replace(JUDGED, max_deg=0.01, max_tolerance_deg=0.03, max_U_deg=0.004),
    "targets": REJECTED,
    "iso9283": POSE_TESTED,
    "orientation": ORIENTED,
    "fit": replace(FITTED, orientation="as the position"),
    "sign": SIGN,
    "commissioning.scale": PROVED,
    "recheck": replace(UPDATED, doubt="the tracker may have moved"),
    "touch": TOUCHED,
    "revisits": REVISITED,
    "revisits.closing": replace(
        REVISITED, holds=False, ratio=3.0, suspicion=SUSPICION, suspected=[SUSPICION.text]
    ),
    "reversal": LOST_MOTION,
    "suspicions": SUSPECTED,
    "since": replace(
        SINCE,
        holds=False,
        suspected=["changed since"],
        beyond=[Parameter("x of S300", "mm", 1.0, 2.0, 0.3)],
    ),
    "known-length": LENGTHS,
    "two-face": FACES,
    "two-face.closing": FACES,
    "reflectors": REFLECTORS,
    "tracker-axes": TRACKER_AXES,
    "tracker-drift": TRACKER_DRIFT,
    "backlash": BACKLASH,
    "station-repeatability": STRIP,
    "conformance lines": CONFORMS,
}

UNIT = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
NO_COVARIANCE = [[0.0] * 6 for _ in range(6)]
WORLD = Frame(matrix=UNIT)
BASE = MeasuredBase(
    matrix=UNIT,
    covariance=NO_COVARIANCE,
    circle_rms_mm=[0.01, 0.01],
    radius_mm=[900.0, 200.0],
)
STATION = MeasuredStation(
    matrix=UNIT,
    covariance=NO_COVARIANCE,
    rms_mm=0.01,
    strip_mm=300.0,
    tool_uncertainty_mm=0.02,
    cube_uncertainty_mm=0.03,
    left_out=[],
)
TOUCHED_BASE = TouchedBase(
    matrix=UNIT,
    covariance=NO_COVARIANCE,
    visit=1,
    growth=0.0,
    poses=6,
    left_out=[],
    pull=0.5,
    misfit=1.0,
    shift_mm=(0.1, 0.0, 0.0),
    along_rail_mm=0.1,
    turn_urad=(1.0, 2.0, 3.0),
    growth_um_m=0.0,
    u_before_mm=0.2,
    u_after_mm=0.05,
)
FRAMES: dict[str, Frame] = {
    "world": WORLD,
    "base": BASE,
    "station.S300": STATION,
    "touch.S300": TOUCHED_BASE,
}


def plain(fact: Verdict | Frame) -> dict[str, Any]:
    """Return a verdict or a frame as the body of its record."""
    body: dict[str, Any] = msgspec.to_builtins(fact)
    return body


def framed(key: str, **changes: Any) -> dict[str, Any]:
    """Return the body of a key's frame with other fields; one that was taken over has no more."""
    kind = Frame if "calibration" in changes else frame_type(key)
    return plain(next(each for each in FRAMES.values() if type(each) is kind)) | changes


def base_at(matrix: Array) -> MeasuredBase:
    """Return a measured base with the matrix (4, 4)."""
    return replace(BASE, matrix=matrix.tolist())
