"""Breaks are made where they say, refused where they have rotted, and reach every process."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from campaigns.breaks import __main__ as program
from campaigns.breaks.judging import Ended, Run
from campaigns.breaks.patch import Patch, RottenError
from campaigns.breaks.table import Break

ARM = '''
from contextlib import contextmanager
from functools import cached_property

LIMITS = {"low": -2.0, "high": 2.0}
seen = []

class Arm:
    """An arm."""

    length: float = 3.0

    @property
    def doubled(self):
        return 2 * self.length  # not squared

    @cached_property
    def tripled(self):
        return 3 * self.length

    @contextmanager
    def held(self):
        seen.append("held")
        try:
            yield self
        finally:
            seen.append(
                "released",  # always
            )

def sent(a, e):
    """Return the sum."""
    if a < 0:
        return sorted([a, e], key=abs, reverse=True)[0]
    return a - e
'''
SIGN = Break(name="sign", target="arm.sent", old="a - e", new="a + e", breaks="", tests=())


def broken(name: str, old: str, new: str) -> dict[str, object]:
    namespace: dict[str, object] = {"__name__": "arm"}
    exec(Patch("arm", name, old, new).code(ARM, "arm.py"), namespace)
    return namespace


@pytest.mark.parametrize(
    ("name", "old", "new", "shown", "value"),
    [
        ("sent", "(a\n  -e)", "a + e", "sent(5, 2)", 7),
        ("sent", "return a - e", "", "sent(5, 2)", None),
        ("sent", "reverse=True", "", "sent(-5, 2)", 2),
        ("sent", "a < 0", "a < -9", "sent(-5, 2)", -7),
        ("sent", "", "pass", "sent(5, 2)", None),
        ("Arm.doubled", "2", "4", "Arm().doubled", 12.0),
        ("Arm.tripled", "", "return 0", "Arm().tripled", 0),
        ("Arm.length", "", "1.0", "Arm().tripled", 3.0),
        ("LIMITS", '"low"', "'lowest'", "[*LIMITS]", ["lowest", "high"]),
        (
            "Arm.held",
            "seen.append('released')",
            "pass",
            "[*Arm().held().gen][1:] or seen",
            ["held"],
        ),
    ],
)
def test_a_break_is_made(name: str, old: str, new: str, shown: str, value: object) -> None:
    assert eval(shown, broken(name, old, new)) == value


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A project of one module and its tests."""
    (tmp_path / "arm.py").write_text(ARM)
    (tmp_path / "conftest.py").write_text(
        "from hypothesis import settings\nsettings.register_profile('breaks')\n"
    )
    (tmp_path / "test_arm.py").write_text(
        "import subprocess, sys, arm\n"
        "def test_sign():\n"
        "    assert arm.sent(5, 2) == 3\n"
        "def test_far():\n"
        "    code = 'import arm; assert arm.sent(5, 2) == 3'\n"
        "    subprocess.run([sys.executable, '-c', code], cwd=sys.path[0], check=True)\n"
    )
    return tmp_path


@pytest.mark.parametrize(
    "change",
    [
        {"target": "leg.sent"},
        {"target": "arm.received"},
        {"target": "arm.Arm.sent"},
        {"old": "a * e"},
        {"old": "a"},
        {"old": "a -"},
        {"new": "a +"},
        {"new": "a - (e)"},
        {"new": "pass"},
        {"old": "", "new": "break"},
        {"tests": ("test_leg.py",)},
        {"tests": ("test_arm.py::test_leg",)},
    ],
)
def test_a_row_that_has_rotted_is_refused(root: Path, change: dict[str, Any]) -> None:
    sound = replace(SIGN, tests=("test_arm.py::test_sign",))
    assert sound.patch(root).module == "arm"
    with pytest.raises(RottenError):
        replace(sound, **change).patch(root)


JUDGED = """
import json, sys
from pathlib import Path
from campaigns.breaks.judging import Run, run_all
from campaigns.breaks.patch import Patch
patch = Patch("arm", "sent", "a - e", "a + e")
runs = [Run("broken", ["test_arm.py"], patch), Run("sound", ["test_arm.py"])]
for each in run_all(runs, 1, Path(sys.argv[1])):
    print(json.dumps([each.run.name, each.code, [*each.failed]]))
"""


@pytest.mark.process
def test_a_break_reaches_every_process(
    root: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    before = (root / "arm.py").read_bytes()
    done = subprocess.run(
        [sys.executable, "-c", JUDGED, tmp_path_factory.mktemp("runs")],
        cwd=root, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert [json.loads(line) for line in done.stdout.splitlines()] == [
        ["broken", 1, ["test_arm.py::test_sign", "test_arm.py::test_far"]],
        ["sound", 0, []],
    ]
    assert (root / "arm.py").read_bytes() == before


@pytest.mark.parametrize(
    ("code", "fails_without", "verdict"),
    [
        (1, False, []),
        (1, True, ["NOT PROVEN"]),
        (0, False, ["SURVIVED"]),
        (2, False, ["NOT RUN"]),
        (-9, False, ["TIMEOUT"]),
    ],
)
def test_a_test_that_fails_by_the_break_alone_catches_it(
    monkeypatch: pytest.MonkeyPatch, code: int, fails_without: bool, verdict: list[str]
) -> None:
    sign = Patch("arm", "sent", "a - e", "a + e")

    def run_all(runs: list[Run], *_: object) -> list[Ended]:
        failing = {1: ["test_sign"]}
        codes = [code if run.patch else int(fails_without) for run in runs]
        return [
            Ended(run, each, 1.0, failing.get(each, []), "")
            for run, each in zip(runs, codes, strict=True)
        ]

    monkeypatch.setattr(program, "run_all", run_all)
    monkeypatch.setattr(program, "prepare", lambda: None)
    missed = program.judged([Run("sign", ("test_arm.py",), sign)])
    assert [each for each, _ in missed] == verdict
