"""The house keeps its own rules: directions of imports, sizes, no paths of a machine."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("hilcell", "drivers", "procedures", "fakes", "tests", "benchmarks")
MODULES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def test_the_import_contract_holds() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_stay_small(path: Path) -> None:
    assert len(path.read_text("utf-8").splitlines()) <= 500


def test_no_vendor_is_named_outside_drivers() -> None:
    vendors = ("leica", "emscon", "geocom", "siko", "kuka", "krl", "fanuc")
    for room in ("hilcell", "procedures"):
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text("utf-8").lower()
            assert not [v for v in vendors if v in text], path


def test_help_is_quick_to_import() -> None:
    """What --help needs: nothing heavy. Timings stand in benchmarks/."""
    code = (
        "import sys, hilcell.commands.cli; print([m for m in ('numpy', 'scipy', 'rich', 'canopen', "
    )
    code += "'msgspec') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
