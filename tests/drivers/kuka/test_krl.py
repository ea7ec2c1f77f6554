from __future__ import annotations

import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.device_errors import ProtocolError
from drivers.kuka import krl


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("100", 100),
        ("-3", -3),
        ("22.5", 22.5),
        ("-1.5E-3", -0.0015),
        (".5", 0.5),
        ("TRUE", True),
        ("false", False),
        ("#EX", "#EX"),
        ("#t1", "#T1"),
        ('"#KR210R2700_2 C4 FLR"', "#KR210R2700_2 C4 FLR"),
        (" #P_ACTIVE \0", "#P_ACTIVE"),
    ],
)
def test_values_are_understood(text: str, value: object) -> None:
    parsed = krl.parse(text)
    assert (parsed, type(parsed)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("{A1 1.0, A2 -2.0}", [1.0, -2.0]),
        ("{E6AXIS: A1 1.0, a2 2}", [1.0, 2.0]),
        (' { E6AXIS : A2 .5 ,A1 1E2,M #BASE, OK TRUE, N "A1 7, A2 7"}\0', [100.0, 0.5]),
    ],
)
def test_structures_are_understood(text: str, values: list[float]) -> None:
    assert krl.numbers(text, ("A1", "A2")) == values


@pytest.mark.parametrize(
    "text",
    [
        "", "1,234", "1.2.3", "{X 1,5 Y 2}", "{X 1.0", "{X}", "{X 1.0, X 2.0}", "1 2", "1e999",
        "{X 1.0 Y 2.0}", "{,}", "}", '"open', "\x1b[2J", "{A {A {A {A {A 1}}}}}", "++1",
        "9" * 400,
    ],
)  # fmt: skip
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ProtocolError):
        krl.parse(text)
    with pytest.raises(ProtocolError):
        krl.numbers(text, ("X",))


@pytest.mark.parametrize(
    "text",
    [
        "{X {Y 1}}", "{X 1.0}, {X 2.0}", "{X 1.0, x 2.0}", "{X 1.0, Y 1e999}", "{X 1.0, Y 1e308}",
        "{X 1.2.3}", "1.0", "{X NaN}", "{X inf}", "{X #X}", "{X TRUE}", '{X "1.0"}', "{Y 1.0}",
    ],
)  # fmt: skip
def test_a_structure_is_refused_as_a_whole(text: str) -> None:
    with pytest.raises(ProtocolError):
        krl.numbers(text, ("X",))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_only_finite_targets_are_written(value: float) -> None:
    with pytest.raises(ProtocolError, match="A1"):
        krl.structure("E6AXIS", {"A1": value})


@given(st.dictionaries(st.from_regex(r"\A[A-F][1-6]\Z"), st.floats(-1e6, 1e6), min_size=1))
def test_a_structure_survives_the_trip(components: dict[str, float]) -> None:
    read = krl.numbers(krl.structure("E6AXIS", components), tuple(components))
    assert read == pytest.approx(list(components.values()), abs=5.1e-7)


@given(st.text(max_size=60))
def test_any_text_is_understood_or_refused(text: str) -> None:
    with suppress(ProtocolError):
        assert all(map(math.isfinite, krl.numbers(text, ("X",))))
    try:
        value = krl.parse(text)
    except ProtocolError:
        return
    assert not isinstance(value, float) or math.isfinite(value)
