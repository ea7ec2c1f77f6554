"""Texts of robot programs in which numbers are replaced byte for byte.

Files are latin-1, in which every byte is a character. In our comments a letter beyond it loses its
accent, is transliterated, or is written by its number, so that two names stay different.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from hilcell.cell.robot import REFLECTOR
from hilcell.cell.settings import SettingsError, read_bytes, unreadable
from hilcell.compensation.programs import StationProgram

ENCODING = "latin-1"
ASCII = 128  # so many characters
OPENS, CLOSES = ("(", "[", "{"), (")", "]", "}")
MARK = "\xef\xbb\xbf"  # the byte order mark of UTF-8, which editors put first


class Number(NamedTuple):
    """A number of the file: its value and the characters ``start`` to ``end`` that state it."""

    text: str
    start: int
    end: int

    @property
    def value(self) -> float:
        return float(self.text)


class Token(NamedTuple):
    """A token of a file; ``word``: its name in capitals; ``start`` counts characters from the
    file's begin.
    """

    kind: str
    text: str
    start: int
    word: str

    @property
    def end(self) -> int:
        return self.start + len(self.text)


def split(tokens: Sequence[Token], sign: str) -> list[Sequence[Token]]:
    """Split tokens at a sign outside of all brackets."""
    parts, depth, begin = list[Sequence[Token]](), 0, 0
    for n, token in enumerate(tokens):
        depth += (token.text in OPENS) - (token.text in CLOSES)
        if depth == 0 and token.text == sign:
            parts.append(tokens[begin:n])
            begin = n + 1
    return [*parts, tokens[begin:]]


class Edit(NamedTuple):
    """Characters ``start`` to ``end`` of a file and their new text."""

    start: int
    end: int
    text: str


def edited(text: str, edits: list[Edit]) -> str:
    """Return a text with edits that do not overlap."""
    parts, at = list[str](), 0
    for edit in sorted(edits, key=lambda each: each.start):
        parts += [text[at : edit.start], edit.text]
        at = edit.end
    return "".join([*parts, text[at:]])


def formatted(value: float, like: str, decimals: int) -> str:
    """Return a number with ``decimals`` at least, or as many as ``like`` has."""
    exponent = Decimal(like).as_tuple().exponent
    places = max(decimals, -exponent if isinstance(exponent, int) else 0)
    return fixed(value, places)


def fixed(value: float, decimals: int) -> str:
    """Return a number with so many decimals, and a zero without a sign."""
    text = f"{value:.{decimals}f}"
    return text if float(text) else text.removeprefix("-")


def source_text(path: Path, language: str) -> str:
    """Return a file's text in a robot's language; raises `SettingsError`."""
    try:
        text = read_bytes(path).decode(ENCODING)
    except OSError as error:
        raise unreadable(str(path), error) from error
    if "\0" in text:
        raise SettingsError(
            str(path), [f"has NUL bytes: not a {language} text, or saved as UTF-16"]
        )
    return text


def line_below(text: str, at: int, line: str) -> Edit:
    """Return the insertion of a line below that of the character ``at``, with its line end."""
    begin = text.find("\n", at) + 1
    return Edit(begin, begin, line + ("\r\n" if text[:begin].endswith("\r\n") else "\n"))


_LETTERS = (
    "а=a б=b в=v г=g д=d е=e ё=e ж=zh з=z и=i й=j к=k л=l м=m н=n о=o п=p р=r с=s т=t у=u ф=f х=kh "
    "ц=ts ч=ch ш=sh щ=shch ъ=' ы=y ь=' э=e ю=yu я=ya є=ye і=i ї=yi ґ=g ђ=dj ј=j љ=lj њ=nj ћ=c џ=dz "
    "α=a β=b γ=g δ=d ε=e ζ=z η=i θ=th ι=i κ=k λ=l μ=m ν=n ξ=x ο=o π=p ρ=r σ=s ς=s τ=t υ=y φ=f χ=ch "
    "ψ=ps ω=o "
    "ł=l đ=d ı=i œ=oe ŋ=n ħ=h –=- —=- ß=ss ø=o æ=ae °=deg"
)


def plain(text: str, below: int = 256) -> str:
    """Return a text in the characters of `ENCODING`, or in the first ones, as `ASCII`."""
    return "".join(_plain(each, below) for each in unicodedata.normalize("NFC", text))


def _plain(letter: str, below: int) -> str:
    if ord(letter) < below:
        return letter
    bare = unicodedata.normalize("NFKD", letter)
    found = "".join(each for each in bare if not unicodedata.combining(each))
    if found and all(ord(each) < below for each in found):
        return found
    letters = {pair[0]: pair[2:] for pair in _LETTERS.split()}
    known = letters.get(letter.lower()) or letters.get(found.lower())
    if known is None:
        return f"U+{ord(letter):04X}"
    return known.capitalize() if letter.isupper() else known


def module_name(station: str) -> str:
    """Return a station's name of letters, digits and underscores, a letter first.

    It has 24 characters at most, as a module of KRL.
    """
    name = re.sub(r"\W", "_", station, flags=re.ASCII)
    return (name if name[0].isalpha() else f"S_{name}")[:24]


def tool_number(program: StationProgram, usual: int) -> int:
    """Number of the program's tool in the controller's table; ``usual``: the reflector's, unless
    `robot.options` has another. Raises `SettingsError` for a tool without one, or with the
    reflector's: the program would move another tip than it is written for.
    """
    reflector: int = program.options.get("tool", usual)
    if program.tool_name == REFLECTOR:
        return reflector
    if program.tool_number is not None and program.tool_number != reflector:
        return program.tool_number
    problem = (
        "missing: a program of this language selects its tool by the controller's number"
        if program.tool_number is None
        else f"{reflector} is the reflector's in the controller (robot.options.tool, {usual} "
        "without): expected another one"
    )
    raise SettingsError(f"tool {program.tool_name}", [f"number: {problem}"])
