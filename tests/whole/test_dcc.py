"""A run's certificate is read back by pydcc, a reader by others."""

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from hilcell.report.dcc import dcc_bytes
from hilcell.report.facts import read_facts
from tests.whole.golden import GoldenRuns


@pytest.fixture
def pydcc(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return pydcc without its checks of signature and schema.

    The one refuses to load beside OpenSSL 3.0.10 and later, whose version it cannot read; the
    other loads the schema from the PTB's site.
    """
    unused = ModuleType("certvalidator")
    for name in ("CertificateValidator", "ValidationContext", "errors"):
        setattr(unused, name, None)
    monkeypatch.setitem(sys.modules, "certvalidator", unused)
    found = importlib.import_module("dcc.dcc")
    monkeypatch.setattr(found, "DCCXMLValidator", lambda: None)
    return found


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the packages that pydcc needs
def test_pydcc_reads_the_certificate_of_a_run(
    tmp_path: Path, golden: GoldenRuns, pydcc: Any
) -> None:
    golden["small"].copied_to(tmp_path)
    read = pydcc.DCC(byte_array=dcc_bytes(read_facts(tmp_path / "small")))
    assert (read.is_loaded(), read.version(), read.mandatory_language()) == (True, "3.1.2", "en")
    assert read.uid().startswith("small-")
    assert read.calibration_laboratory_name() == "not stated"
    assert read.item_id()["identifications"]["identification"][0]["value"] == "860112"
    result = golden["small"].end["result"]["validation"]["S1100"]["chosen"]
    found = {name: body["real"] for name, body in read.get_calibration_results("name", "en")}
    means = [found[name] for name in found if "S1100, after" in name and name.endswith(" mean")]
    mean = means[-1]  # the chosen correction's comes last
    assert mean["value"] == f"{result['mean']:.4f}"
    assert mean["unit"] == "\\milli\\metre"
    assert float(mean["expandedUnc"]["coverageProbability"]) == 0.95
