"""The page of figures: in words, to the width, with no line drawn and no number cut."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot

from hilcell.tui.text.finished import report_lines
from tests.hilcell.tui.all_screens import SAID, SHOWN, isolated
from tests.hilcell.tui.recording_app import RecordingApp, press, run_app, text_of
from tests.hilcell.tui.views import drawn

__all__ = ["isolated"]


@pytest.mark.parametrize("width", [38, 59, 78, 99, 139])
def test_the_figures_are_in_words_and_fit(width: int) -> None:
    lines = report_lines(SHOWN, None).lines(width)
    text = "\n".join(line.plain for line in lines)
    assert max(line.cell_length for line in lines) <= width
    assert not set("│┃━┏…") & set(text)
    for raw in ("True", "machine_seed", "idw", "chosen:", "station_held", "None"):
        assert raw not in text
    for words in ("yes, no device moved", "station held", "as sent", "paper method", "corrected"):
        assert words in " ".join(text.split())
    assert text.count("0.1100") == 3


def test_a_run_that_did_not_finish_states_its_fault_and_no_table() -> None:
    found = SHOWN | {"state": "faulted", "fault": "Tracker: measure: beam broken; " * 5}
    text = drawn(report_lines(found, None))
    assert " ".join(text.split()).count("beam broken;") == 5
    assert "paper method" not in text


@pytest.mark.usefixtures("isolated")
def test_output_of_another_kind_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        for text in ("", "no JSON", "[1]", "{\n}"):
            monkeypatch.setitem(SAID, "show", text)
            await press(pilot, "o")
            assert "no figures" in text_of(app)
            await press(pilot, "q")

    run_app(act, "done")
