from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.kuka import robot_eki as eki
from drivers.kuka.krl import KrlError
from drivers.kuka.robot_eki import EkiError

SHORT = b'<RobotState><Command Id="17" Finished_Id="5"/><Pos A1="1.5" A2="nan"/></RobotState>'


def test_a_command_has_all_values() -> None:
    """A queue that gets no value would shift all later ones."""
    document = eki.command(7, eki.Kind.MOVE, axes=(1.0, -90.0, 90.5, 0.0, 0.25, -6.0), percent=30)
    assert document == (
        b'<RobotCommand Id="7" Type="1" Percent="30" Life="0"><Pos A1="1.000000" A2="-90.000000" '
        b'A3="90.500000" A4="0.000000" A5="0.250000" A6="-6.000000" E1="0.000000"></Pos>'
        b"</RobotCommand>"
    )
    names = [part.split(b"=")[0] for part in document.split() if b"=" in part]
    asked = eki.command(-3, eki.Kind.ASK)
    assert names == [part.split(b"=")[0] for part in asked.split() if b"=" in part]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_target_that_is_not_finite(bad: float) -> None:
    with pytest.raises(EkiError, match="A2"):
        eki.command(7, eki.Kind.MOVE, axes=(0.0, bad, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(EkiError, match="E1"):
        eki.command(7, eki.Kind.MOVE, e1=bad)


@given(st.lists(st.integers(1, 40)))
def test_documents_come_in_any_pieces(cuts: list[int]) -> None:
    stream = SHORT + b"\r\n" + SHORT.replace(b'"17"', b'"18"') + b"<RobotSt"
    found, rest = [], b""
    while stream:
        size = cuts.pop() if cuts else len(stream)
        whole, rest = eki.split(rest + stream[:size], eki.STATE)
        stream = stream[size:]
        found += whole
    assert [eki.parse(document, eki.STATE)[0] for document in found] == [17, 18]
    assert rest == b"<RobotSt"


def test_a_document_without_an_end_is_an_error() -> None:
    eki.split(b"<RobotState>" + b" " * (eki.LONGEST - 12), eki.STATE)
    with pytest.raises(EkiError, match="8193"):
        eki.split(b"<RobotState>" + b" " * (eki.LONGEST - 11), eki.STATE)


def test_values_of_a_state() -> None:
    number, state = eki.parse(SHORT, eki.STATE)
    assert number == 17
    assert state.single("HC_ACK") == 5
    assert state.numbers("$AXIS_ACT", ["A1"]) == [1.5]
    with pytest.raises(KrlError):
        state.numbers("$AXIS_ACT", ["A2"])
    with pytest.raises(EkiError, match="Status/@Mode_Op"):
        state.single("$MODE_OP")


DECLARED = b'<?xml version="1.0" encoding="UTF-8"?>\r\n'


def test_documents_behind_an_xml_declaration_and_in_capitals() -> None:
    loud = SHORT.replace(b"RobotState", b"ROBOTSTATE").replace(b"Finished_Id", b"FINISHED_ID")
    received = DECLARED + SHORT + b"\r\n" + DECLARED + loud
    whole, rest = eki.split(received, eki.STATE)
    assert (len(whole), rest) == (2, b"")
    for document in whole:
        number, state = eki.parse(document, eki.STATE)
        assert (number, state.single("HC_ACK"), state.text("Pos", "A1")) == (17, 5, "1.5")


@pytest.mark.parametrize(
    ("text", "value"),
    [("TRUE", True), ("true", True), ("1", True), ("0", False), ("False", False), ("2", 2)],
)
def test_booleans_as_words_or_numbers(text: str, value: object) -> None:
    document = (
        f'<RobotState><Command Id="1" Stopped="{text}"/><Status Pro_State1="1"/></RobotState>'
    )
    state = eki.parse(document.encode(), eki.STATE)[1]
    found = state.single("HC_STOP")
    assert (found, type(found)) == (value, type(value))
    assert state.single("$PRO_STATE1") == 1
    assert not isinstance(state.single("$PRO_STATE1"), bool)


BOMB = (
    b'<!DOCTYPE RobotState [<!ENTITY a "1"><!ENTITY b "&a;&a;&a;&a;">]>'
    b'<RobotState><Command Id="&b;"/></RobotState>'
)


@pytest.mark.parametrize(
    "document",
    [
        BOMB,
        DECLARED + DECLARED + SHORT,
        DECLARED.replace(b"?>", b"<?>") + SHORT,
        DECLARED + BOMB,
        SHORT.replace(b'Finished_Id="5"', b'Id="17" id="18"'),
        SHORT.replace(b"<Pos", b"<pos A1='0'/><Pos"),
        SHORT.replace(b"<Pos", b"<!-- x --><Pos"),
        SHORT.replace(b"17", "１７".encode()),
        SHORT.replace(b'"17"', b'"&c;"'),
        SHORT.replace(b"<Pos", b"<<Pos"),
        SHORT.replace(b'Id="17"', b'Id="17" Id="18"'),
        SHORT.replace(b"17", b"1.5"),
        SHORT.replace(b"17", b"9" * 5000),
        SHORT.replace(b"Command", b"Other"),
        SHORT.replace(b"Pos A1", b"Command A1"),
        SHORT.replace(b'5"/>', b'5"><Deep/></Command>'),
        SHORT.replace(b"RobotState", b"RobotStatus"),
        b"</RobotState>",
    ],
)
def test_other_documents_are_refused(document: bytes) -> None:
    with pytest.raises(EkiError):
        eki.parse(document, eki.STATE)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_document_or_an_error(data: bytes) -> None:
    for document in (data, SHORT[:40] + data + SHORT[40:]):
        try:
            whole, _ = eki.split(document, eki.STATE)
            for each in whole:
                eki.parse(each, eki.STATE)
        except EkiError:
            pass
