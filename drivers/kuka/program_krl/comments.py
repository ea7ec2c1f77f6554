"""Comments of KRL: names of any script in the letters that a controller shows.

A controller's texts are latin-1. A letter beyond it loses its accent or is transliterated. One that
no table here has is written by its number, so that two names stay two.
"""

from __future__ import annotations

import unicodedata

from hilcell.clean import clean

CODING = "latin-1"
ASCII = 128  # so many characters
_LETTERS = (
    "а=a б=b в=v г=g д=d е=e ё=e ж=zh з=z и=i й=j к=k л=l м=m н=n о=o п=p р=r с=s т=t у=u ф=f х=kh "
    "ц=ts ч=ch ш=sh щ=shch ъ=' ы=y ь=' э=e ю=yu я=ya є=ye і=i ї=yi ґ=g ђ=dj ј=j љ=lj њ=nj ћ=c џ=dz "
    "α=a β=b γ=g δ=d ε=e ζ=z η=i θ=th ι=i κ=k λ=l μ=m ν=n ξ=x ο=o π=p ρ=r σ=s ς=s τ=t υ=y φ=f χ=ch "
    "ψ=ps ω=o "
    "ł=l đ=d ı=i œ=oe ŋ=n ħ=h –=- —=- ß=ss ø=o æ=ae °=deg"
)


def comment(text: str) -> str:
    """Return a line of comment, which `CODING` can write."""
    return f"; {plain(clean(text))}"


def plain(text: str, below: int = 256) -> str:
    """Return a text in the characters of `CODING`, or in the first ones, as `ASCII`."""
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
