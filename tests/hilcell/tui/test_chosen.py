"""What the run's screen says of the point under the cursor, and of keys that do nothing yet."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot

from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import RecordingApp, press, run_app, text_of

__all__ = ["isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


def test_a_point_is_chosen_only_by_somebody() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "b", "b")  # the points, in place of an alarm
        assert "last point: grid point 0-0-4" in text_of(app)
        await press(pilot, "up")
        assert "chosen point: grid point 0-0-3" in text_of(app)

    run_app(act, "fault")


def test_the_space_bar_promises_nothing_while_an_engine_starts() -> None:
    async def act(app: RecordingApp, _: Pilot[int]) -> None:
        assert "space  pause" in text_of(app)
        assert "go on" not in text_of(app)

    run_app(act, "checking", size=(80, 24))
