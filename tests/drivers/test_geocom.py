"""Lines of GeoCOM as geocompy sends and captures them, and the geometry of its angles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.leica import tracker_geocom as geocom
from drivers.leica.tracker_geocom import GeocomError, Reply, Rpc


@pytest.mark.parametrize(
    ("line", "rpc", "number", "parameters"),
    [
        ("%R1Q,0,0:", Rpc.NULL, 0, ()),
        ("%R1Q,2008,7:1,1", Rpc.DO_MEASURE, 7, (1, 1)),
        ("%R1Q,2108,10:5000,1", Rpc.GET_MEASUREMENT, 10, (5000, 1)),
        ("%R1Q,9037,9:0.1,0.1,0", Rpc.FINE_ADJUST, 9, (0.1, 0.1, 0)),
        ("%R1Q,2028,3:0.000000658,1013.0,20.5,20.5", 2028, 3, (658e-9, 1013.0, 20.5, 20.5)),
    ],
)
def test_requests(line: str, rpc: int, number: int, parameters: tuple[float, ...]) -> None:
    assert geocom.request(rpc, number, *parameters) == line


def test_replies() -> None:
    assert geocom.parse("%R1P,0,0:0") == Reply(0, 0, 0)
    assert geocom.parse("%R1P,0,9:8710") == Reply(0, 9, 8710)
    assert geocom.parse("%R1P,3077,9:0") == Reply(3077, 9, 0)
    found = geocom.parse("%R1P,0,8:0,1100.2503,-2.5001,0.1252,12345,1100.2503,-2.5001,0.1252,12345")
    assert geocom.numbers(found.values, 8)[:4] == (1100.2503, -2.5001, 0.1252, 12345.0)
    assert geocom.parse('%R1P,0,2:0,"TS60, R1000",""').values == ("TS60, R1000", "")


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (r'"TS16 A 1\" R500"', ('TS16 A 1" R500',)),
        ('"TS16 A 1" R500"', ('TS16 A 1" R500',)),
        (r'"TS60 0.5\""', ('TS60 0.5"',)),
        ('"TS60 0.5""', ('TS60 0.5"',)),
        (r'"TS16 1\", R500",3', ('TS16 1", R500', "3")),
        (r'"a\\b","c"', (r"a\b", "c")),
        ('"TS16 1", R500"', ("TS16 1", ' R500"')),
    ],
)
def test_a_name_may_have_the_mark_of_an_arcsecond_in_it(text: str, values: tuple[str, ...]) -> None:
    assert geocom.parse(f"%R1P,0,2:0,{text}").values == values


@pytest.mark.parametrize(
    "line",
    ["", "?", "%R1P,0,1", "%R1P,0:0", "%R1P,0,-1:0", "%R1P,a,1:0", "%R1Q,0,1:", '%R1P,0,1:0,"a"b'],
)
def test_other_lines_are_no_replies(line: str) -> None:
    with pytest.raises(GeocomError):
        geocom.parse(line)


@pytest.mark.parametrize("values", [(), ("1", "2"), ("1", "2", "three"), ("1", "2", "")])
def test_values_of_another_kind_or_number_are_refused(values: tuple[str, ...]) -> None:
    with pytest.raises(GeocomError, match="3"):
        geocom.numbers(values, 3)


@given(st.text(max_size=60))
def test_any_text_is_a_reply_or_an_error(text: str) -> None:
    try:
        geocom.parse(text)
    except GeocomError:
        return
    assert text.startswith("%R1P,")


def test_hz_turns_clockwise_in_a_right_handed_frame() -> None:
    quarter = math.pi / 2
    np.testing.assert_allclose(geocom.position_mm(0.0, quarter, 2.0), [2000, 0, 0], atol=1e-9)
    np.testing.assert_allclose(geocom.position_mm(quarter, quarter, 2.0), [0, -2000, 0], atol=1e-9)
    np.testing.assert_allclose(geocom.position_mm(1.0, 0.0, 2.0), [0, 0, 2000], atol=1e-9)


@given(
    st.floats(-1e4, 1e4).filter(lambda x: abs(x) > 1), st.floats(-1e4, 1e4), st.floats(-3e3, 3e3)
)
def test_angles_lead_back_to_their_place(x: float, y: float, z: float) -> None:
    at_mm = np.array([x, y, z])
    hz, v = geocom.angles_to(at_mm)
    assert 0 <= hz <= math.tau
    assert 0 <= v <= math.pi
    distance_m = float(np.linalg.norm(at_mm)) / 1000
    np.testing.assert_allclose(geocom.position_mm(hz, v, distance_m), at_mm, atol=1e-6)


def test_the_class_of_accuracy_is_a_length_along_and_an_angle_across() -> None:
    arcsec = geocom.RAD_PER_ARCSEC
    std_mm = geocom.class_std_mm(np.array([10_000.0, 0.0, 0.0]), 0.6, 1.0 * arcsec)
    np.testing.assert_allclose(std_mm, [0.6, 0.0485, 0.0485], atol=1e-4)
