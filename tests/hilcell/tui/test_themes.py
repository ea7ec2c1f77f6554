"""Colours and glyphs, by the terminal."""

from __future__ import annotations

from dataclasses import fields
from itertools import combinations, product

import numpy as np
import pytest
from rich.color import Color as RichColor
from rich.color import ColorSystem
from rich.segment import Segment

from hilcell.commands.cli import whole_parser
from hilcell.commands.tui import textual_environment
from hilcell.ports import Array
from hilcell.tui.terminal import ASCII, UNICODE, Glyphs, has_colours, has_unicode, to_ascii
from hilcell.tui.text.run import STATES
from hilcell.tui.themes import NAMES, PALETTES, ROLES, SIXTEEN_COLOURS, Palette
from tests.hilcell.tui.all_screens import form_of, isolated, screens_of
from tests.hilcell.tui.recording_app import SIZE, Press, RecordingApp, Stage, painted, run_app
from tests.hilcell.tui.sample_runs import sample_runs
from tests.whole.bench import sweep

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
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
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
FRAME = " ▔▁░▒·"  # drawn, not read: frames, the empty part of a bar, a plot's dotted grid
MARKS, LEAST_OF_MARKS = set(" ▀▄█▌■"), 3.0  # of a plot: success criterion 1.4.11
APART = 14.0  # CIE76, of two fills; about 2 is just seen
by_palette = pytest.mark.parametrize("palette", PALETTES, ids=lambda palette: palette.name)


@by_palette
def test_a_role_is_read_on_every_ground_and_under_its_letters(palette: Palette) -> None:
    for role in ROLES:
        for ground in (palette.ground, palette.panel):
            assert contrast(palette.ink(role), ground) >= LEAST, role
        assert contrast(palette.on(role), palette.fill(role)) >= LEAST, role


@by_palette
def test_text_is_read_wherever_it_stands(palette: Palette) -> None:
    grounds = (palette.ground, palette.panel, palette.cursor, palette.badge)
    for ground in grounds:
        assert contrast(palette.text, ground) >= 9.0
        assert contrast(palette.label, ground) >= 5.0
    for ground in (palette.ground, palette.panel):
        assert contrast(palette.stale, ground) >= 4.9
    for role in ("passed", "ask", "fault"):  # the states of the table's row under the cursor
        assert contrast(palette.ink(role), palette.cursor) >= 4.6, role


@by_palette
def test_high_contrast_is_higher(palette: Palette) -> None:
    if palette.name.startswith("contrast"):
        inks = (*map(palette.ink, ROLES), palette.stale)
        assert min(contrast(ink, palette.ground) for ink in inks) >= 7.0  # AAA


@by_palette
@pytest.mark.parametrize("eyes", MATRICES)
def test_fills_differ_for_colour_blind_eyes(palette: Palette, eyes: str) -> None:
    meant = [role for role in ROLES if role != "label"]  # grey means nothing
    for one, other in combinations(meant, 2):
        apart = distance(palette.fill(one), palette.fill(other), eyes)
        assert apart >= APART, (one, other, apart)


@by_palette
def test_nothing_else_has_the_colour_of_a_simulation(palette: Palette) -> None:
    inks = {palette.ink(role) for role in ROLES if role != "sim"}
    fills = {palette.fill(role) for role in ROLES if role != "sim"}
    others = inks | fills | {palette.text, palette.stale, palette.badge, palette.track}
    assert {palette.sim, palette.sim_fill}.isdisjoint(others)


def test_sixteen_colours_are_those_that_every_terminal_has() -> None:
    values = (getattr(SIXTEEN_COLOURS, each.name) for each in fields(Palette))
    colours = [value for value in values if str(value).startswith("#")]
    found = {RichColor.parse(value).downgrade(ColorSystem.STANDARD) for value in colours}
    assert len(found) == len(set(colours))  # no two become one
    names = {"live": 14, "passed": 10, "ask": 11, "fault": 9, "sim": 13, "label": 7}
    for role, number in names.items():
        ink = RichColor.parse(SIXTEEN_COLOURS.ink(role))
        assert ink.downgrade(ColorSystem.STANDARD).number == number
        assert contrast(SIXTEEN_COLOURS.ink(role), SIXTEEN_COLOURS.ground) >= LEAST
        assert contrast(SIXTEEN_COLOURS.on(role), SIXTEEN_COLOURS.fill(role)) >= LEAST


def test_the_formula_is_the_standards() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)


def hard_to_read(app: RecordingApp) -> str:
    """Return what is printed with too little contrast, as the terminal gets it."""
    found = [
        f"{segment.text!r}: {ratio:.2f}"
        for strip in painted(app)
        for segment in strip
        if segment.text.strip(FRAME)
        and (ratio := contrast_of(segment, app)) < (LEAST_OF_MARKS if is_mark(segment) else LEAST)
    ]
    return "\n".join(found)


def is_mark(segment: Segment) -> bool:
    return set(segment.text) <= MARKS


def contrast_of(segment: Segment, app: RecordingApp) -> float:
    """Return the contrast with what is under it; of a plot's marks also that with the ground.

    The other half of a mark's cell may be another series.
    """
    style = segment.style
    assert style is not None
    assert style.color is not None
    assert style.bgcolor is not None
    ink, under = style.color.get_truecolor().hex, style.bgcolor.get_truecolor().hex
    ground = app.theme_variables["background"] if is_mark(segment) else under
    return max(contrast(ink, under), contrast(ink, ground))


@pytest.mark.usefixtures("isolated")
@pytest.mark.parametrize("theme", [NAMES[0], *sweep(*NAMES[1:])])
def test_every_letter_on_every_screen_is_read(theme: str) -> None:
    async def look(app: Stage, pilot: Press) -> None:
        walk = screens_of if app.story else form_of
        seen = await walk(app, pilot, hard_to_read)
        assert not {name: text for name, text in seen.items() if text}

    for state in ("intolerant", ""):
        run_app(look, state, size=SIZE, theme=theme)


def test_the_command_offers_every_theme_and_no_other() -> None:
    wanted = [whole_parser().parse_args(["tui", "--theme", name]).theme for name in NAMES]
    assert tuple(wanted) == NAMES
    with pytest.raises(SystemExit):
        whole_parser().parse_args(["tui", "--theme", "none"])
    assert whole_parser().parse_args(["tui"]).theme == NAMES[0]


@pytest.mark.parametrize("glyphs", [UNICODE, ASCII], ids=["unicode", "ascii"])
def test_each_state_has_its_word_and_a_shape_that_tells_its_role(glyphs: Glyphs) -> None:
    words = [word for word, _ in STATES.values()]
    assert set(glyphs.states) == set(STATES) == set(sample_runs())
    assert len(set(words)) == len(words)
    roles: dict[str, set[str]] = {}
    for key, (_, role) in STATES.items():
        roles.setdefault(glyphs.states[key], set()).add(role)
    assert all(len(each) == 1 for each in roles.values()), roles
    assert {role for each in roles.values() for role in each} <= set(ROLES)


WGL4 = "►■□●○▲▼◄×√·•█▀▄▌▐░▒▓─│═║╔╗╚╝┌┐└┘├┤┬┴┼°±−≤Δ"


def test_shapes_are_in_the_fonts_of_all_terminals_and_each_has_one_in_ascii() -> None:
    values = (getattr(UNICODE, each.name) for each in fields(Glyphs))
    shapes = "".join(value for value in values if isinstance(value, str))
    shapes += "".join(UNICODE.states.values())
    assert {letter for letter in shapes if not letter.isascii()} <= set(WGL4)
    assert "?" not in to_ascii(WGL4.replace("Δ", ""))
    assert len(to_ascii(WGL4)) == len(WGL4)
    values = (getattr(ASCII, each.name) for each in fields(Glyphs))
    shapes = "".join(value for value in values if isinstance(value, str))
    assert to_ascii(shapes + "".join(ASCII.states.values())).count("?") == 1  # suspended


XTERM = {"TERM": "xterm-256color"}
COERCED = "C.UTF-8"


def test_a_terminal_has_colours_by_its_name() -> None:
    coloured = ("xterm", "xterm-256color", "linux", "screen", "vt525", "foot", "xterm-kitty")
    bare = ("", "dumb", "unknown", "vt52", "vt100", "vt220", "vt320-w", "xterm-mono", "linux-m")
    assert all(has_colours({"TERM": term}) for term in coloured)
    assert not any(has_colours({"TERM": term, "COLORTERM": "truecolor"}) for term in bare)
    assert not has_colours({})
    assert not has_unicode({"LANG": "C.UTF-8"})


def test_no_color_is_obeyed_whatever_it_says_but_nothing() -> None:
    assert not any(has_colours(XTERM | {"NO_COLOR": value}) for value in ("1", "0", "false"))
    assert has_colours(XTERM | {"NO_COLOR": ""})


UTF_8: tuple[dict[str, str], ...] = (
    {"LANG": "en_US.UTF-8"}, {"LANG": "C.utf8"}, {"LC_CTYPE": "UTF-8"},
    {"LANG": "C", "LC_CTYPE": "de_DE.UTF-8"}, {"LANG": "C", "LC_CTYPE": "C", "LC_ALL": "C.UTF-8"},
    {"LANG": "en_US.UTF-8", "LC_ALL": ""}, {"LANG": "en_US.UTF-8@variant"}, {},
)  # fmt: skip
OTHERS = (
    {"LANG": "C"}, {"LANG": "POSIX"}, {"LANG": "de_DE"}, {"LANG": "de_DE.ISO-8859-1"},
    {"LANG": "en_US.UTF-8", "LC_ALL": "C"}, {"LANG": "en_US.UTF-8", "LC_CTYPE": "POSIX"},
)  # fmt: skip


def test_a_locale_with_utf_8_or_none_has_shapes_and_no_other() -> None:
    for locale in UTF_8:
        assert has_unicode(XTERM | locale), locale
        assert not any(has_unicode({"TERM": t} | locale) for t in ("vt100", "dumb", "linux"))
    for locale in OTHERS:
        assert not has_unicode(XTERM | locale), locale


def test_what_python_wrote_into_its_environment_is_no_claim_of_the_terminals() -> None:
    assert has_unicode(XTERM | {"LC_CTYPE": COERCED})
    assert has_unicode(XTERM | {"LC_CTYPE": COERCED}, coerced=True)
    assert not has_unicode(XTERM | {"LC_CTYPE": COERCED, "LANG": "C"}, coerced=True)
    assert has_unicode(XTERM | {"LC_CTYPE": COERCED, "LANG": "not_HERE.UTF-8"}, coerced=True)
    assert has_unicode(XTERM | {"LC_CTYPE": COERCED, "LC_ALL": COERCED}, coerced=True)


TERMS = ("linux", "screen", "xterm", "vt100", "dumb")
COLOURS = ("16", "256", "truecolor", "none", "auto")
SYSTEMS = {"16": "standard", "none": "truecolor"}


def test_an_option_for_colours_outweighs_the_environment() -> None:
    for colours, term, no_color in product(COLOURS, TERMS, ("", "1")):
        found = textual_environment(colours, {"TERM": term, "NO_COLOR": no_color})
        without = no_color == "1" or term in ("vt100", "dumb")
        chosen = "none" if colours == "auto" and without else colours
        assert found["TEXTUAL_COLOR_SYSTEM"] == SYSTEMS.get(chosen, chosen)
        assert found.get("NO_COLOR") == ("1" if chosen == "none" else None)
        assert found["TEXTUAL_ANIMATIONS"] == "none"
