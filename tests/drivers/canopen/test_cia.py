from __future__ import annotations

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen import cia
from drivers.canopen.cia import State


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, State.NOT_READY),
        (0x0640, State.SWITCH_ON_DISABLED),
        (0x0221, State.READY),
        (0x0233, State.SWITCHED_ON),
        (0x1637, State.ENABLED),
        (0x0627, State.ENABLED),
        (0x0607, State.QUICK_STOP_ACTIVE),
        (0x020F, State.FAULT_REACTION),
        (0x0208, State.FAULT),
        (0x0028, State.FAULT),
        (0x0001, State.UNKNOWN),
    ],
)
def test_states_follow_from_the_statusword(statusword: int, state: State) -> None:
    assert cia.state_of(statusword) is state


@given(st.integers(0, 0xFFFF))
def test_an_independent_table_agrees(statusword: int) -> None:
    theirs = [name for name, (mask, bits) in State402.SW_MASK.items() if statusword & mask == bits]
    ours = cia.state_of(statusword)
    assert theirs == ([] if ours is State.UNKNOWN else [ours.value.upper()])


def test_a_drive_that_brakes_has_power_too() -> None:
    """Figure 8: from operation enabled until the end of a quick stop or of a fault's reaction."""
    powered = {State.ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION}
    assert powered == cia.POWERED


def test_control_words_lead_up_to_enabled_and_none_from_a_fault() -> None:
    words = [
        cia.next_control(s) for s in (State.SWITCH_ON_DISABLED, State.READY, State.SWITCHED_ON)
    ]
    assert words == [0x06, 0x07, 0x0F]
    assert cia.next_control(State.QUICK_STOP_ACTIVE) == 0x00
    assert cia.next_control(State.FAULT) is None
    assert cia.next_control(State.FAULT_REACTION) is None


@pytest.mark.parametrize(
    ("word", "enables"),
    [(0x00, False), (0x02, False), (0x06, False), (0x80, False), (0x07, True), (0x0F, True),
     (0x1F, True), (0x3F, True)],
)  # fmt: skip
def test_control_words_that_are_not_sent_after_a_stop(word: int, enables: bool) -> None:
    assert cia.enables(word) is enables


def test_emergencies_have_texts_and_the_end_of_an_error_is_none() -> None:
    """By the code itself, its class, or the fact that it is unknown."""
    texts = {cia.error_text(code) for code in (0x7305, 0x8611, 0x2311, 0x8A00, 0xFF01, 0xA000)}
    assert len(texts) == 6
    assert not cia.is_error(0x0000)
    assert cia.is_error(0x1000)


def test_strip_alarms_and_steps() -> None:
    assert "missing magnet" in cia.alarm_text(1)
    assert "bit 2" in cia.alarm_text(0b101)
    assert cia.alarm_text(0) == ""
    assert cia.step_nm(100.0) == 10_000
