"""Plants and studies are optional: without their packages every other command works."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

WITHOUT = """
import importlib, pkgutil, sys
missing = ("sqlalchemy", "alembic", "psycopg", "cryptography", "dask", "distributed", "pyarrow")
sys.modules |= dict.fromkeys(missing)  # an import of them fails
for module in pkgutil.walk_packages(["hilcell"], "hilcell."):
    if not module.name.startswith(("hilcell.plant", "hilcell.study", "hilcell.__main__")):
        importlib.import_module(module.name)
from hilcell.commands.cli import main
print([main(words.split()) for words in ("check paper", "plant show", "study report .")])
"""


@pytest.mark.process
def test_other_commands_need_no_optional_package() -> None:
    command = [sys.executable, "-c", WITHOUT]
    root = Path(__file__).parents[3]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=root)
    assert done.stdout.endswith("[0, 2, 2]\n"), done.stderr
    assert "plant: not installed: sqlalchemy, alembic, psycopg" in done.stderr
    assert "study: pyarrow is not installed" in done.stderr
