"""What the environment says of its terminal: colours, and shapes beyond ASCII."""

from __future__ import annotations

from itertools import product

import pytest

from hilcell.commands.tui import textual_environment
from hilcell.tui.terminal import has_colours, has_unicode

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


@pytest.mark.parametrize(
    "locale",
    [
        {"LANG": "en_US.UTF-8"},
        {"LANG": "C.utf8"},
        {"LC_CTYPE": "UTF-8"},
        {"LANG": "C", "LC_CTYPE": "de_DE.UTF-8"},
        {"LANG": "C", "LC_CTYPE": "C", "LC_ALL": "C.UTF-8"},
        {"LANG": "en_US.UTF-8", "LC_ALL": ""},
        {"LANG": "en_US.UTF-8@variant"},
        {},
    ],
)
def test_a_locale_with_utf_8_or_none_has_shapes(locale: dict[str, str]) -> None:
    assert has_unicode(XTERM | locale)
    for term in ("vt100", "dumb", "linux"):
        assert not has_unicode({"TERM": term} | locale)


@pytest.mark.parametrize(
    "locale",
    [
        {"LANG": "C"},
        {"LANG": "POSIX"},
        {"LANG": "de_DE"},
        {"LANG": "de_DE.ISO-8859-1"},
        {"LANG": "en_US.UTF-8", "LC_ALL": "C"},
        {"LANG": "en_US.UTF-8", "LC_CTYPE": "POSIX"},
    ],
)
def test_every_other_locale_that_is_named_is_ascii(locale: dict[str, str]) -> None:
    assert not has_unicode(XTERM | locale)


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
