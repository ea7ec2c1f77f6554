"""Themes: contrast (WCAG 2.2), colour blindness (Machado, Oliveira and Fernandes 2009), states."""

from __future__ import annotations

import asyncio
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from rich.segment import Segment

from hilcell.commands.cli import whole_parser
from hilcell.ports import Array
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import ASCII, UNICODE, Glyphs
from hilcell.tui.terminal.themes import NAMES, PALETTES, TONES, Palette
from hilcell.tui.text.run import STATES
from tests.hilcell.tui.all_screens import form_of, isolated, screens_of
from tests.hilcell.tui.recording_app import SIZE, RecordingApp, options, painted
from tests.hilcell.tui.sample_runs import sample_runs

MATRICES = {
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_WHITE = np.array([0.9505, 1.0, 1.089])


def linear(colour: str) -> Array:
    """Return ``#rrggbb`` as linear RGB (3,)."""
    coded = np.array([int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)])
    found: Array = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    return found


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours, 1 to 21."""
    low, high = sorted(float(_TO_XYZ[1] @ linear(each)) for each in (one, other))
    return (high + 0.05) / (low + 0.05)


def distance(one: str, other: str, eyes: str) -> float:
    """Return how far apart two colours are (CIE76) for eyes of a kind."""
    return float(np.linalg.norm(_lab(one, eyes) - _lab(other, eyes)))


def _lab(colour: str, eyes: str) -> Array:
    seen = np.clip(MATRICES[eyes] @ linear(colour), 0.0, 1.0)
    share = _TO_XYZ @ seen / _WHITE
    f = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


__all__ = ["isolated"]

LEAST = 4.5  # WCAG 2.2, success criterion 1.4.3
FRAME = " ▔▁"  # drawn, not read
CLEAR = 20.0  # CIE76; about 2 is just seen
by_palette = pytest.mark.parametrize("palette", PALETTES, ids=lambda palette: palette.name)


@by_palette
@pytest.mark.parametrize("tone", TONES)
def test_tones_are_read_on_the_ground_and_under_their_own_text(palette: Palette, tone: str) -> None:
    colour = getattr(palette, tone)
    assert contrast(colour, palette.background) >= LEAST
    assert contrast(palette.on, colour) >= LEAST


@by_palette
def test_text_is_read_wherever_it_stands(palette: Palette) -> None:
    for ground in (palette.background, palette.cursor):
        assert contrast(palette.text, ground) >= LEAST
    assert contrast(palette.dim, palette.background) >= LEAST


@by_palette
@pytest.mark.parametrize("eyes", MATRICES)
def test_good_warn_and_bad_differ_for_colour_blind_eyes(palette: Palette, eyes: str) -> None:
    for one, other in combinations(("good", "warn", "bad"), 2):
        apart = distance(getattr(palette, one), getattr(palette, other), eyes)
        assert apart >= CLEAR, (one, other, apart)


@by_palette
def test_nothing_else_has_the_colour_of_a_simulation(palette: Palette) -> None:
    others = {getattr(palette, tone) for tone in TONES if tone != "sim"}
    assert palette.sim not in others | {palette.text, palette.dim}


def test_the_formula_is_the_standards() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)


def hard_to_read(app: RecordingApp) -> str:
    """Return what is printed with too little contrast, as the terminal gets it."""
    found = [
        f"{segment.text!r}: {ratio:.2f}"
        for strip in painted(app)
        for segment in strip
        if segment.text.strip(FRAME) and (ratio := contrast_of(segment)) < LEAST
    ]
    return "\n".join(found)


def contrast_of(segment: Segment) -> float:
    style = segment.style
    assert style is not None
    assert style.color is not None
    assert style.bgcolor is not None
    return contrast(style.color.get_truecolor().hex, style.bgcolor.get_truecolor().hex)


@pytest.mark.usefixtures("isolated")
@pytest.mark.parametrize("theme", NAMES)
def test_every_letter_on_every_screen_is_read(theme: str) -> None:
    async def run_app(state: str) -> dict[str, str]:
        app = RecordingApp(options(Path("/runs"), theme=theme), state)
        async with app.run_test(size=SIZE) as pilot:
            walk = screens_of if state else form_of
            return await walk(app, pilot, hard_to_read)

    for state in ("intolerant", ""):
        problems = {name: text for name, text in asyncio.run(run_app(state)).items() if text}
        assert not problems, problems


def test_the_command_offers_every_theme_and_no_other() -> None:
    wanted = [whole_parser().parse_args(["tui", "--theme", name]).theme for name in NAMES]
    assert tuple(wanted) == NAMES
    with pytest.raises(SystemExit):
        whole_parser().parse_args(["tui", "--theme", "none"])
    assert whole_parser().parse_args(["tui"]).theme == NAMES[0]


@pytest.mark.parametrize("glyphs", [UNICODE, ASCII], ids=["unicode", "ascii"])
def test_each_state_has_a_word_and_a_shape_of_its_own(glyphs: Glyphs) -> None:
    words = [word for word, _ in STATES.values()]
    shapes = [glyphs.states[key].lower() for key in STATES]
    assert set(glyphs.states) == set(STATES) == set(sample_runs())
    assert len(set(words)) == len(words)
    assert len(set(shapes)) == len(shapes)
    assert all(tone in TONES for _, tone in STATES.values())


def test_every_state_of_a_run_can_be_shown() -> None:
    for name, story in sample_runs().items():
        view = RunView("r")
        for record in story.records:
            view.take(record)
        assert view.state in STATES, name


def test_ascii_shapes_are_ascii() -> None:
    shapes = [*ASCII.states.values(), ASCII.fresh, ASCII.moving, ASCII.stale, ASCII.lost]
    shapes += [ASCII.full, ASCII.empty, ASCII.mark, ASCII.rule, ASCII.over_left, ASCII.over_right]
    shapes += [ASCII.degree, ASCII.plus_minus, ASCII.delta, ASCII.dot]
    assert "".join(shapes).isascii()
