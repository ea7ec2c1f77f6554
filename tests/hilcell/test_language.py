"""Texts in other languages: which one, what stands in for a missing one, no lag behind the code."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from string import Formatter

import pytest

from hilcell.commands.cli import main
from hilcell.language import (
    ENGLISH,
    Language,
    date_text,
    decimal,
    language_of,
    of_environment,
    packages,
    retold,
    speaking,
    tr,
)
from hilcell.languages.__main__ import Catalogue, keys_of
from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from hilcell.run.prompts import TEXTS
from hilcell.tui.process import run_in_thread
from tests.hilcell.report.journals import validated_run

GERMAN = language_of("de_DE")
# Words that no German text has; code and quoted words of the program are taken off before.
ENGLISH_WORDS = re.compile(
    r"\b(the|and|of|is|are|not|with|until|nothing|moves|points?|steps?|limit|worst|mean|alarms|"
    r"check|this|that|which|from|by|at|measured|moved|robot|rail|slide|cell|run|tool|target)\b"
)
OURS = re.compile(
    r"`[^`]*`|„[^“]*“|\{[^}]*\}|\[\[tool\]\]|\(Tian et al.*?\)|/dev/\S*|--\w+|"
    r"state:\w+|operator:\w+|calibration\.json"
)


@pytest.mark.parametrize(
    ("environment", "locale"),
    [
        ({}, ""),
        ({"LANG": "C"}, ""),
        ({"LANG": "C.UTF-8"}, ""),
        ({"LANG": "POSIX"}, ""),
        ({"LANG": "en_US.UTF-8"}, ""),
        ({"LANG": "xx_YY.UTF-8"}, ""),
        ({"LANG": "../../de"}, ""),
        ({"LANG": "de_DE.UTF-8"}, "de_DE"),
        ({"LANG": "de_AT@euro"}, "de_AT"),
        ({"LANG": "de_QQ"}, "de"),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "en_GB.UTF-8"}, ""),
        ({"LANG": "en_GB.UTF-8", "LC_MESSAGES": "de_DE.UTF-8"}, "de_DE"),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "de_DE.UTF-8", "LC_ALL": "C"}, ""),
        ({"LANG": "de_DE.UTF-8", "LANGUAGE": "en:de"}, ""),
        ({"LANG": "en_US.UTF-8", "LANGUAGE": "fr:de"}, "de"),
        ({"LANG": "C.UTF-8", "LANGUAGE": "de"}, ""),
    ],
)
def test_the_environment_names_the_language_as_for_gettext(
    environment: Mapping[str, str], locale: str
) -> None:
    assert of_environment(environment).locale == locale


def test_texts_figures_and_dates_are_those_of_the_language_within_its_context_only() -> None:
    day = datetime(2026, 3, 4, tzinfo=UTC)
    seen = []
    for language in (ENGLISH, GERMAN, language_of("de_CH")):
        with speaking(language):
            seen.append(
                (tr("limit {limit_mm:.3f}", limit_mm=0.5), decimal("1.5 mm"), date_text(day))
            )
    assert seen == [
        ("limit 0.500", "1.5 mm", "2026-03-04"),
        ("Grenze 0,500", "1,5 mm", "04.03.2026"),
        ("Grenze 0.500", "1.5 mm", "04.03.2026"),
    ]
    assert tr("limit") == "limit"


@pytest.mark.parametrize("translated", ["{lenght} mm", "{length", "{length:q}", "{} {0}"])
def test_english_stands_in_for_what_is_missing_or_does_not_fit(translated: str) -> None:
    with speaking(Language("de", {"{length} mm": translated})):
        assert tr("{length} mm", length=3) == "3 mm"
        assert tr("nobody has said this") == "nobody has said this"


@pytest.mark.parametrize("package", packages())
def test_german_lacks_no_text_of_the_code_and_has_no_other(package: str) -> None:
    catalogue = Catalogue.of(package, "de")
    assert catalogue.missing == []
    assert catalogue.unused == []
    assert catalogue.file.read_text("utf-8") == catalogue.content("de")


def _fields(text: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(text) if name is not None}


@pytest.mark.parametrize("package", packages())
def test_german_texts_have_the_values_of_the_english_ones_and_no_english_word(
    package: str,
) -> None:
    for english, german in Catalogue.of(package, "de").texts.items():
        if "{W}" not in english:  # a frame where nothing else is in braces
            assert _fields(german) == _fields(english), english
        assert german.replace(german.strip(), "|") == english.replace(english.strip(), "|"), english
        assert set(re.findall(r"`[^`]*`", german)) == set(re.findall(r"`[^`]*`", english)), english
        found = ENGLISH_WORDS.search(OURS.sub("", german))
        assert found is None, f"{found}: {german}"


def test_an_edited_text_is_missing_and_its_translation_is_outdated(tmp_path: Path) -> None:
    before, now = "Check the stand of the tracker.", "Check the stand of the tracker first."
    catalogue = Catalogue(tmp_path / "de.po", {before: "Stativ prüfen."}, [now])
    assert (catalogue.missing, catalogue.unused) == ([now], [before])
    assert catalogue.outdated(now) == before
    assert catalogue._replace(texts={now: ""}).missing == [now]
    assert before not in catalogue.content("de")


@pytest.mark.parametrize(
    ("sentence", "german"),
    [
        ("Seat the reflector in N1", "Reflektor in N1 setzen"),
        ("Seat the reflector of F2 in F1", "Reflektor von F2 in F1 setzen"),
        ("Seat the reflector on the flange", "Reflektor an den Flansch setzen"),
        ("Wash the dishes", "Wash the dishes"),
    ],
)
def test_what_an_engine_asks_in_english_is_retold(sentence: str, german: str) -> None:
    with speaking(GERMAN):
        assert retold(sentence, TEXTS.values()) == german


def test_a_terminal_of_ascii_spells_german_letters() -> None:
    texts = GERMAN.in_ascii().texts
    assert texts["Robot not reached"] == "Roboter nicht erreicht"
    assert texts["acknowledged"] == GERMAN.texts["acknowledged"] == "quittiert"
    assert texts["Guard open"] == "Schutztuer offen"
    assert not [text for text in texts.values() if set(text) & set("äöüßÄÖÜ„“")]


def test_a_thread_of_the_screen_speaks_its_language() -> None:
    with speaking(GERMAN):
        assert asyncio.run(run_in_thread(tr, "limit")) == "Grenze"


def test_alarms_procedures_and_templates_are_among_the_keys() -> None:
    assert "Robot not reached" in keys_of("drivers.languages")
    assert {"Axis sweeps", "Calibration no longer valid"} <= {*keys_of("procedures.languages")}
    assert "Before the first hole" in keys_of("hilcell.languages")


def test_what_a_script_reads_is_the_same_in_each_language(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    seen = []
    for locale in ("C.UTF-8", "de_DE.UTF-8"):
        monkeypatch.setenv("LC_ALL", locale)
        for words in ("explain HC-B01 --json", "check paper --json", "explain HC-B01"):
            assert main(words.split()) == 0
            seen.append(capfd.readouterr().out)
    assert seen[:2] == seen[3:5]
    assert "Roboter nicht erreicht" in seen[5] != seen[2]


def test_the_first_page_is_in_the_language_of_who_renders_it(tmp_path: Path) -> None:
    validated_run(tmp_path)
    facts = read_facts(tmp_path)
    english, german = report_html(facts), report_html(facts, language=GERMAN)
    assert english == report_html(facts)
    assert 'lang="de"' in german
    assert "Was gemessen wurde" in german
    first = re.search(r'<section class="first".*?</section>\n<section class="part">', german, re.S)
    assert first is not None
    assert re.search(r"\d\d\.\d\d\.20\d\d", first[0])
    assert not re.search(r"\b20\d\d-\d\d-\d\d \d", first[0])
    assert german.partition(first[0])[2] == english.partition('<section class="part">')[2]
