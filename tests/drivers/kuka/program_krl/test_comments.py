"""Names of any script in comments of KRL."""

import pytest

from drivers.kuka.program_krl.program import comment
from drivers.program_text import ENCODING, plain


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("Träger 7 µ", "Träger 7 µ"),
        ("Černý Łódź", "Cerný Lódz"),
        ("Бъл-7", "B'l-7"),
        ("Щит", "Shchit"),
        ("Ωμέγα", "Omega"),
        ("孔1", "U+5B541"),
        ("5€ – x", "5U+20AC - x"),
    ],
)
def test_a_name_is_written_in_letters_that_the_controller_shows(name: str, written: str) -> None:
    assert plain(name) == written
    assert plain(name).encode(ENCODING).decode(ENCODING) == written


def test_a_comment_is_one_line() -> None:
    assert comment("a\nb") == "; ab"
