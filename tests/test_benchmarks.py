"""A benchmark that is asked for help, or for what it does not know, measures nothing."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

import benchmarks

COMMANDS = sorted(
    path.stem
    for path in Path(benchmarks.__path__[0]).glob("*.py")
    if "def main(" in path.read_text("utf-8")
)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_printed_and_nothing_made(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module(f"benchmarks.{name}")
    monkeypatch.chdir(tmp_path)
    assert module.__doc__
    first, wrong = module.__doc__.split("\n", 1)[0][:40], "--no-such-word"
    for word, code in (("--help", 0), (wrong, 2)):
        monkeypatch.setattr("sys.argv", [name, word])
        with pytest.raises(SystemExit) as ended:
            module.main()
        assert ended.value.code == code
    said = capsys.readouterr()
    assert first in said.out
    assert "usage: " in said.err
    assert list(tmp_path.iterdir()) == []
