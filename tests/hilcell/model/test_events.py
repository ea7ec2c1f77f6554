"""Events are typed as they are read, and those of plug-ins stay as they are."""

import msgspec
import pytest

from hilcell.model.events import (
    ChangesAccepted,
    Closed,
    CommandRefused,
    DeviceBack,
    DeviceLost,
    OtherEvent,
    RemeasureRefused,
    StationAlreadyHeld,
    StepBegun,
    TrackerMoved,
)
from hilcell.model.records import EVENTS, decode_event
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure


def test_an_event_of_a_plug_in_keeps_its_fields_and_says_what_it_is_about() -> None:
    event = decode_event({"what": "glue applied", "station": "S1", "reason": "dry", "grams": 2.5})
    assert event == OtherEvent("glue applied", {"station": "S1", "reason": "dry", "grams": 2.5})
    assert event.text == "glue applied S1: dry"


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (
            RemeasureRefused(key="grid/0", reason="it is fitted"),
            "not re-measured: grid/0: it is fitted",
        ),
        (StationAlreadyHeld(station="S300"), "rail found held at S300"),
        (DeviceLost(device="Rail", reason="no answer", error={}), "device lost: no answer"),
        (DeviceBack(device="rail"), "device back: rail answers again"),
        (
            CommandRefused(command="pause", state="paused"),
            "command refused: pause is not possible while paused",
        ),
        (
            ChangesAccepted(changes=["the drive is another", "the cell file"], by="the operator"),
            "changes accepted by the operator: the drive is another; the cell file",
        ),
        (StepBegun(name="fit", number=6, of=7), "step 6 of 7 begins: fit"),
        (
            TrackerMoved(set_up=1, invalid=["a"], moved_mm=0.3),
            "tracker moved by 0.300 mm: 1 point is measured again",
        ),
        (Closed(problems={"Rail": "x"}), "devices closed, but check Rail: not seen at rest"),
        (Closed(problems={"Tracker": "x"}), "devices closed, but check Tracker"),
    ],
)
def test_an_event_is_said_in_words(event: msgspec.Struct, text: str) -> None:
    read = decode_event(msgspec.to_builtins(event))
    assert type(read) is type(event)
    assert read.text == text


def test_a_plug_in_cannot_write_a_declared_event_that_no_reader_could_read(bed: Bed) -> None:
    """The journal would hold it for ever, and the run could be neither shown nor resumed."""
    assert "step" in EVENTS

    def act(session: CellSession, number: int) -> None:
        session.event("step", wrong=number)

    assert bed.run(procedure(Points(1, act))) == 5
    assert "expected an event of another kind than 'step'" in bed.log().fault
    assert bed.run(procedure(Points(1))) == 0
