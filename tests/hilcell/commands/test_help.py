"""The help of all commands: each in one group, and a word at the wrong place is put right."""

from __future__ import annotations

from collections import Counter

import pytest

from hilcell.commands.cli import GROUPS, main, whole_parser


def test_every_command_stands_in_one_group_of_the_help() -> None:
    parser = whole_parser()
    assert parser.commands is not None
    grouped = Counter(name for names in GROUPS.values() for name in names)
    assert set(grouped) == set(parser.commands.choices)
    assert set(grouped.values()) == {1}
    text = parser.format_help()
    places = [text.index(f"\n{title}:") for title in GROUPS]
    assert places == sorted(places)
    for title, names in GROUPS.items():
        section = text.partition(f"\n{title}:\n")[2].partition("\n\n")[0]
        assert [line.split()[0] for line in section.splitlines() if line[4] != " "] == [*names]
    assert "exit codes:" in text
    assert "--version" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--json show last", "`hilcell show .. --json`"),
        ("--runs=x runs", "`hilcell runs .. --runs`"),
        ("--verson", "unknown option --verson"),
        ("--verson", "--version"),
        ("show last --bogus", "unknown option --bogus"),
        ("shwo last", "unknown command 'shwo'"),
        ("show last more", "hilcell show: unexpected argument more"),
        ("show last more", "`hilcell show --help`"),
        ("plant show -x", "hilcell plant show: unknown option -x"),
    ],
)
def test_a_word_at_the_wrong_place_is_named_with_the_right_one(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`hilcell --json show last` proposed --version."""
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
