"""Text from outside acts nowhere: controls of seven and eight bits, directions, lengths."""

import pytest

from hilcell.sanitize import LONGEST, clean, encodable, harmless

CSI = "\x9b31m"  # one character that begins an escape sequence by itself


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("\x1b[2Jdone", "[2Jdone"),
        (f"{CSI}red", "31mred"),
        ("\x07bell\x7f\r\n", "bell"),
        ("a\u202eb\u2066c\u200bd\ufeffe\u061cf", "abcdef"),
        ("half \udcff a name", "half  a name"),
        ("  at rest  ", "at rest"),
        ("mm " * 100, ("mm " * 100)[:LONGEST].strip()),
    ],
)
def test_what_acts_is_taken_out(text: str, left: str) -> None:
    assert clean(text) == left


@pytest.mark.parametrize("text", ["\x1b[2J", CSI, "\u202e", "\udcff", "\u2028"])
def test_what_is_not_seen_as_itself_is_replaced(text: str) -> None:
    assert harmless(text)[0] == "\N{REPLACEMENT CHARACTER}"
    assert len(harmless(text)) == len(text)


def test_names_that_are_no_text_can_be_written_as_json() -> None:
    assert encodable("run \udcff") == "run ?"
