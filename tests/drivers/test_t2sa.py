"""Replies of T2SA as its public client documents them, and as bridges of 2020 and 2021 wrote."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.spatialanalyzer import t2sa
from drivers.spatialanalyzer.t2sa import Reply, T2saError


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("ACK-300 Instrument is connected", Reply(True, 300, "Instrument is connected")),
        ("ACK-300 READY;07/27/2021 11:31:06", Reply(True, 300, "READY;07/27/2021 11:31:06")),
        (
            "ERR-201 Command rejected. SA is busy.",
            Reply(False, 201, "Command rejected. SA is busy."),
        ),
        (" ERR-306: Did not find it.", Reply(False, 306, "Did not find it.")),
        ("ACK-300", Reply(True, 300, "")),
    ],
)
def test_replies(line: str, reply: Reply) -> None:
    assert t2sa.parse(line) == reply


@pytest.mark.parametrize("line", ["", "READY", "ACK-30 x", "ACK-3000 x", "NAK-300 x", "ERR-30A x"])
def test_other_lines_are_no_replies(line: str) -> None:
    with pytest.raises(T2saError):
        t2sa.parse(line)


@given(st.text(max_size=60))
def test_any_text_is_a_reply_or_an_error(text: str) -> None:
    try:
        t2sa.parse(text)
    except T2saError:
        return
    assert text.strip().startswith(("ACK-", "ERR-"))


@pytest.mark.parametrize(
    ("body", "xyz_mm"),
    [
        (
            "Single Point Measurement A;M2;M2_P1 result -529.16349,319.1,285.1 8/19/2022 2:45 PM",
            (-529.16349, 319.1, 285.1),
        ),
        ("Single Point Measurement M2_P1 result 1,-2.5,3e2 19.08.2022 14:45 True", (1, -2.5, 300)),
        (
            "Measured single pt M2_P1 result: X:-529.16349;Y:319.1;Z:285.1;07/27/2021 17:02 True",
            (-529.16349, 319.1, 285.1),
        ),
        ("Measured single pt M2_P1 result: X:1.0;Y:2.0;Z:3.0", (1, 2, 3)),
    ],
)
def test_positions(body: str, xyz_mm: tuple[float, ...]) -> None:
    reply = t2sa.parse(f"ACK-300 {body}")
    assert reply.is_result
    np.testing.assert_array_equal(t2sa.position_of(reply, "M2_P1"), xyz_mm)


@pytest.mark.parametrize("x", ["nan", "NaN", "inf", "-INF", "1_0", "", "0x1", "1e9999"])
def test_values_that_are_no_numbers_are_not_finite(x: str) -> None:
    reply = t2sa.parse(f"ACK-300 Measured single pt P1 result: X:{x};Y:2.0;Z:3.0;today")
    assert not np.isfinite(t2sa.position_of(reply, "P1")[0])


@pytest.mark.parametrize(
    "body",
    [
        "READY",
        "Single Point Measurement P1 result 1,5,2,5,3,5 today",
        "Single Point Measurement P1 result 1.0,2.0 today",
        "Single Point Measurement A;G;P10 result 1,2,3 today",
        "Measured single pt P2 result: X:1;Y:2;Z:3;today",
    ],
)
def test_texts_without_the_points_position_are_refused(body: str) -> None:
    with pytest.raises(T2saError):
        t2sa.position_of(t2sa.parse(f"ACK-300 {body}"), "P1")


@pytest.mark.parametrize(
    ("xyz", "form"),
    [
        ([100.0, 0.0, 0.0], "in inches"),
        ([2.54, 0.0, 0.0], "in metres"),
        ([40.0, 0.0, 0.0], "as a deviation from the named point"),
        ([7.0, 0.0, 0.0], ""),
    ],
)
def test_forms_of_a_result(xyz: list[float], form: str) -> None:
    named_mm, near_mm = np.array([2500.0, 0, 0]), np.array([2540.0, 0, 0])
    assert t2sa.other_form(np.array(xyz), named_mm, near_mm, 1.0) == form
