"""Frames: read as they were written, of the type of their key, or as they were taken over."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from hilcell.journal.log import Log
from hilcell.model.frame import (
    Frame,
    MeasuredBase,
    MeasuredStation,
    TouchedBase,
    decode_frame,
    frame_type,
)
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.verdicts import BASE, FRAMES, STATION, WORLD, plain

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize(("key", "frame"), FRAMES.items())
def test_a_frame_is_read_as_it_was_written(key: str, frame: Frame) -> None:
    text = msgspec.json.encode(frame)
    read = decode_frame(key, msgspec.json.decode(text))
    assert (type(read), read) == (type(frame), frame)
    assert msgspec.json.encode(read) == text


@given(
    st.builds(
        MeasuredBase,
        matrix=st.lists(st.lists(FINITE, min_size=4, max_size=4), min_size=4, max_size=4),
        points=st.lists(st.text()),
        covariance=st.lists(st.lists(FINITE, min_size=6, max_size=6), max_size=6),
        circle_rms_mm=st.lists(FINITE),
        radius_mm=st.lists(FINITE),
    )
)
def test_any_base_is_read_as_it_was_written(base: MeasuredBase) -> None:
    assert decode_frame("base", msgspec.json.decode(msgspec.json.encode(base))) == base


@pytest.mark.parametrize(
    ("key", "kind"),
    [
        ("world", Frame), ("world.1", Frame), ("base", MeasuredBase), ("base.S300", Frame),
        ("station.S300", MeasuredStation), ("three_points.S300", Frame),
        ("touch.S300", TouchedBase), ("own", Frame),
    ],
)  # fmt: skip
def test_a_key_has_its_type(key: str, kind: type[Frame]) -> None:
    assert frame_type(key) is kind


def test_a_frame_that_was_taken_over_has_no_quality() -> None:
    read = decode_frame("base", {"matrix": WORLD.matrix, "calibration": "1-made"})
    assert read == Frame(matrix=WORLD.matrix, calibration="1-made")
    with pytest.raises(msgspec.ValidationError):
        decode_frame("base", {"matrix": WORLD.matrix})


def test_matrix_and_covariance_are_arrays_and_copies() -> None:
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    frame = Frame(matrix=WORLD.matrix, covariance=covariance.tolist())
    np.testing.assert_array_equal(frame.T, np.eye(4))
    np.testing.assert_array_equal(frame.C, covariance)
    np.testing.assert_array_equal(WORLD.C, np.zeros((6, 6)))
    frame.T[0, 3] = 1.0
    np.testing.assert_array_equal(frame.T, np.eye(4))


def test_a_log_gives_a_frame_of_the_type_that_was_asked_for() -> None:
    log = Log()
    log.frames["station.S300"] = STATION
    assert log.frame(MeasuredStation, "station.S300") is STATION
    with pytest.raises(KeyError):
        log.frame(TouchedBase, "station.S300")
    with pytest.raises(KeyError):
        log.frame(MeasuredStation, "station.S1100")


@pytest.mark.parametrize(
    ("key", "frame", "refused"),
    [
        ("base", WORLD, True),
        ("station.S300", BASE, True),
        ("world", BASE, True),
        ("base", replace(WORLD, calibration="1-made"), False),
        ("base", BASE, False),
    ],
)
def test_a_run_keeps_a_frame_of_the_type_of_its_key_alone(
    bed: Bed, key: str, frame: Frame, refused: bool
) -> None:
    def act(session: CellSession, number: int) -> None:
        session.frame(key, frame)

    bed.run(procedure(Points(1, act)))
    said = f"{key!r} is no key of {type(frame).__name__}"
    assert (said in bed.log().fault) is refused
    kept = [plain(each) for name, each in bed.log().frames.items() if name == key]
    assert kept == ([] if refused else [plain(frame)])
