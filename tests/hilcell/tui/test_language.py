"""The screen in German: the same screens as in English, with no word cut that is whole there."""

from __future__ import annotations

import pytest

from hilcell.language import ENGLISH, Language, language_of, speaking
from tests.hilcell.tui.all_screens import form_of, isolated, screens_of
from tests.hilcell.tui.recording_app import Press, Stage, run_app

__all__ = ["isolated"]

GERMAN = language_of("de_DE")
SMALL, LARGE = (80, 24), (120, 40)
CROWDED = ("", "running", "suspended", "fault", "done")  # the form, points, prompt, alarm, verdict
pytestmark = pytest.mark.usefixtures("isolated")


def shown(language: Language, state: str, size: tuple[int, int]) -> dict[str, str]:
    """Return what all screens over a run show, or the form where there is none."""
    seen: dict[str, str] = {}

    async def walk(app: Stage, pilot: Press) -> None:
        seen.update(await (screens_of if state else form_of)(app, pilot))

    with speaking(language):
        run_app(walk, state, size=size)
    return seen


@pytest.mark.parametrize(
    ("state", "size"), [*((state, SMALL) for state in CROWDED), ("", LARGE), ("running", LARGE)]
)
def test_no_word_is_cut_in_german_that_is_whole_in_english(
    state: str, size: tuple[int, int]
) -> None:
    english, german = shown(ENGLISH, state, size), shown(GERMAN, state, size)
    assert german.keys() == english.keys()
    cut = {
        name: german[name] for name in german if german[name].count("…") > english[name].count("…")
    }
    assert not cut, "\n".join(cut.values())
    if state and size == SMALL:  # the footer keeps its two rows
        first, last = german["run"].splitlines()[-2:]
        assert "Esc STOP" in first
        assert "Hilfe" in last
