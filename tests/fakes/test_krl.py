from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.kuka.krl import (
    KrlError,
    aggregate,
    boolean,
    parse_aggregate,
    parse_boolean,
    parse_integer,
)


def test_aggregate_text() -> None:
    text = aggregate("E6POS", {"X": 1620.0, "Y": -1e-9, "S": 2})
    assert text == "{E6POS: X 1620.00000, Y 0.00000, S 2}"


@pytest.mark.parametrize(
    "text", ["{E6AXIS: A1 1.5, A2 -3}", "{A1 1.5,A2 -3}", " {e6axis:A1 1.5,A2 -3e0} "]
)
def test_aggregate_is_read_with_and_without_its_type(text: str) -> None:
    assert parse_aggregate(text, "E6AXIS") == {"A1": 1.5, "A2": -3.0}


@pytest.mark.parametrize(
    "text",
    ["", "{}", "{E6POS: A1 1}", "{A1 nan}", "{A1 inf}", "{A1}", "A1 1", "{A1 1,5}", "{A1 1; A2 2}"],
)
def test_what_krl_would_not_take_is_refused(text: str) -> None:
    with pytest.raises(KrlError):
        parse_aggregate(text, "E6AXIS")


def test_booleans_and_integers() -> None:
    assert [parse_boolean(boolean(value)) for value in (True, False)] == [True, False]
    assert parse_integer(" 42 ") == 42
    for parse, text in ((parse_boolean, "1"), (parse_integer, "4.2")):
        with pytest.raises(KrlError):
            parse(text)


@given(st.dictionaries(st.sampled_from(["A1", "A2", "A6"]), st.floats(-360, 360), min_size=1))
def test_round_trip(members: dict[str, float]) -> None:
    back = parse_aggregate(aggregate("E6AXIS", members), "E6AXIS")
    assert back == pytest.approx(members, abs=6e-6)
