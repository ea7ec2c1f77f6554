"""The language of what people read: texts by catalogue, figures and dates as it writes them.

A text is looked up by its English, which the code holds and which stands in for each missing entry.
Everything is English unless an edge of the program says otherwise with `speaking`: the screen, a
page while it is rendered. So nothing that a script or a journal gets depends on the environment.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cache
from string import Formatter
from typing import TypeVar

from hilcell.errors import HilcellError

GROUP = "hilcell.languages"  # entry points: packages with a catalogue a language, as ``de.po``


@dataclass(frozen=True, eq=False)
class Language(Formatter):
    """``texts`` by their English; ``locale`` is "" for plain English with dates of ISO 8601."""

    locale: str = ""
    texts: Mapping[str, str] = field(default_factory=dict)
    decimal: str = "."

    @property
    def code(self) -> str:
        """The code of HTML: ``de``."""
        return self.locale.partition("_")[0] or "en"

    def text(self, english: str, values: Mapping[str, object]) -> str:
        """Return the text with its values; in English where the translation does not fit them."""
        text = self.texts.get(english, english)
        if not values:
            return text
        try:
            return self.vformat(text, (), values)
        except (LookupError, ValueError):
            return self.vformat(english, (), values)

    def in_ascii(self) -> Language:
        """Return the language for a terminal without its letters: ``ä`` as ``ae``."""
        spelt = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe",
                               "Ü": "Ue", "„": '"', "“": '"'})  # fmt: skip
        return replace(self, texts={key: text.translate(spelt) for key, text in self.texts.items()})

    def format_field(self, value: object, format_spec: str) -> str:
        text = format(value, format_spec)
        return self.figure(text) if isinstance(value, float) else text

    def figure(self, text: str) -> str:
        return text if self.decimal == "." else text.replace(".", self.decimal)


T = TypeVar("T")
ENGLISH = Language()
_SPOKEN: ContextVar[Language] = ContextVar("language", default=ENGLISH)


@contextmanager
def speaking(language: Language) -> Iterator[None]:
    """Show texts in this language, in this context and in tasks and threads that copy it."""
    token = _SPOKEN.set(language)
    try:
        yield
    finally:
        _SPOKEN.reset(token)


def spoken() -> Language:
    return _SPOKEN.get()


def tr(english: str, /, **values: object) -> str:
    """Return a text in the language of the context, its ``{names}`` replaced by values."""
    return _SPOKEN.get().text(english, values)


def retold(sentence: str, forms: Iterable[str]) -> str:
    """Return in the language what another process has said, in English, in one of these forms."""
    for form in forms:
        parts = re.split(r"\{(\w+)\}", form)
        pattern = "".join(
            f"(?P<{part}>.+)" if n % 2 else re.escape(part) for n, part in enumerate(parts)
        )
        if found := re.fullmatch(pattern, sentence):
            return tr(form, **found.groupdict())
    return sentence


def marked(english: T) -> T:
    """Return what it is given: texts, or the values of a table, that `tr` shows elsewhere."""
    return english


def decimal(written: str) -> str:
    """Return written figures with the decimal sign of the language."""
    return _SPOKEN.get().figure(written)


def date_text(moment: datetime) -> str:
    """Return a moment's day as the language writes it."""
    if not (locale := _SPOKEN.get().locale):
        return f"{moment:%Y-%m-%d}"
    from babel.dates import format_date

    return format_date(moment, format="medium", locale=locale)


def of_environment(environ: Mapping[str, str]) -> Language:
    """Return the user's language as gettext chooses it; English where there is no catalogue."""
    named = (environ.get(name, "") for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    locale = next(filter(None, named), "C")
    if re.split(r"[.@]", locale)[0] in ("C", "POSIX"):
        return ENGLISH
    for name in (*environ.get("LANGUAGE", "").split(":"), locale):
        if re.match(r"en(?![a-z])", name):
            return ENGLISH
        if name and (found := language_of(re.split(r"[.@]", name)[0])) is not ENGLISH:
            return found
    return ENGLISH


def packages() -> list[str]:
    """Return the names of the packages that may have catalogues, hilcell's own last."""
    from importlib.metadata import entry_points

    found = {
        (point.dist is not None and point.dist.name == "hilcell", point.module)
        for point in entry_points(group=GROUP)
    }
    return [module for _, module in sorted(found)]


@cache
def language_of(name: str) -> Language:
    """Return the language of a locale, as ``de_AT``; English where there is no catalogue.

    Raises `HilcellError` for a catalogue that cannot be read.
    """
    from importlib import resources  # English needs none of it

    code = name.partition("_")[0]
    files = [resources.files(each) / f"{code}.po" for each in packages()] if code.isalpha() else []
    if not (files := [each for each in files if each.is_file()]):
        return ENGLISH
    from babel import Locale, UnknownLocaleError
    from babel.messages.pofile import PoFileError, read_po
    from babel.numbers import get_decimal_symbol

    texts: dict[str, str] = {}
    for file in files:
        try:
            with file.open("rb") as content:
                entries = read_po(content, code, abort_invalid=True)
        except (PoFileError, UnicodeDecodeError, ValueError) as error:
            raise HilcellError(f"{file}: expected a catalogue of gettext: {error}") from error
        texts |= {str(each.id): str(each.string) for each in entries if each.id and each.string}
    try:
        locale = Locale.parse(name)
    except (UnknownLocaleError, ValueError):
        locale = Locale.parse(code)
    return Language(str(locale), texts, get_decimal_symbol(locale))
