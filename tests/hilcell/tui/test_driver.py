"""Esc in the bytes of a terminal: never missed, and not seen where there is none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.tui.terminal.driver import has_escape


@pytest.mark.parametrize(
    "read",
    [b"\x1b", b"a\x1b", b"\x1b\x1b", b"\x1b[A\x1b", b"\x1b ", b"\x1bq", b"\x1b\r", b"\x1b\x1b[A",
     b"\x1b\x03", b"\x1b[27u", b"\x1b[27;1u", b"\x1b[27;1:1u", b"\x1b[27;5:2u", b"xx\x1b[27uyy",
     "\x1bé".encode()],
)  # fmt: skip
def test_esc_is_seen(read: bytes) -> None:
    assert has_escape(read)


@pytest.mark.parametrize(
    "read",
    [b"", b"a", b"27u", b"\x1b[A", b"\x1bOP", b"\x1b[1;5C", b"\x1b[15~", b"\x1b[<0;10;5M",
     b"\x1b[M !!", b"\x1b[200~pasted\x1b[201~", b"\x1b[I", b"\x1b[?2026;2$y", b"\x1b[27;1:3u",
     b"\x1b[27;2;13~", b"\x1b[127u", b"\x1b[2727u", b"\x1bP>|XTerm(390)\x1b\\",
     b"\x1b]11;rgb:0000/0000/0000\x1b\\", b"\x1b_Gi=1;OK\x1b\\"],
)  # fmt: skip
def test_other_keys_and_answers_of_terminals_are_no_esc(read: bytes) -> None:
    assert not has_escape(read)


@given(st.binary(), st.binary())
def test_esc_is_seen_wherever_it_ends_a_read(before: bytes, after: bytes) -> None:
    assert has_escape(before + b"\x1b")
    assert has_escape(before + b"\x1b[27u" + after)


@given(st.text(st.characters(exclude_characters="\x1b")))
def test_text_is_no_esc(text: str) -> None:
    assert not has_escape(text.encode("utf-8", "surrogatepass"))
