"""The Digital Calibration Certificate has the schema's structure and the report's figures."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np
import pytest
from dsi_unit import DsiUnit
from msgspec.structs import replace

from hilcell.atomic_files import NotWritten
from hilcell.calibration.budget import Coverage
from hilcell.calibration.decision_rule import guard_band
from hilcell.model.outcome import Outcome
from hilcell.model.results import OrientationFigures
from hilcell.report import dcc
from hilcell.report.budgets import TargetBudget
from hilcell.report.dcc import CELSIUS, DEGREE, FORMS, HECTOPASCAL, MM, PERCENT, dcc_bytes, quantity
from hilcell.report.facts import Facts
from hilcell.report.first_page import FirstPage
from hilcell.report.tables import Tables
from tests.hilcell.report.dcc_structure import DCC, SI, faults
from tests.hilcell.report.journals import AFTER_MM, BEFORE_MM, DEVICES, plan_record, validated_run
from tests.hilcell.verdicts import JUDGED

TRACKER = {"kind": "tracker", "device": "Tracker", "model": "AT901", "serial": "402871"}
PASSED = replace(
    JUDGED, mean_mm=0.2, mean_tolerance_mm=0.35, max_mm=0.3, max_tolerance_mm=0.6,
    mean_U_mm=0.03, max_U_mm=0.04,
)  # fmt: skip
PARTIES = {
    "laboratory": "Muster GmbH", "laboratory_address": "Messweg 4", "country": "DE",
    "customer": "A & B <Aero>",
}  # fmt: skip


def run(folder: Path, simulated: bool = False, **stated: str) -> Facts:
    cell = plan_record()["cell"] | {"certificate": PARTIES, "uncertainty": stated}
    writer = validated_run(folder, simulated=simulated, cell=cell)
    writer.event("connected", devices=[*DEVICES, TRACKER])
    for name, mean_mm in (("S1100", 0.2), ("S300", 0.4)):
        found = replace(PASSED, holds=mean_mm < 0.3, mean_mm=mean_mm, max_mm=mean_mm + 0.1)
        writer.journal.append("verdict", f"validation.{name}", found)
    writer.state("calibration", "validated")
    return writer.facts()


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> Facts:
    """Return a real run that passes at one of two stations; a certificate is missing."""
    folder = tmp_path_factory.mktemp("dcc") / "r"
    return run(folder, tracker_certificate="TC-1", smr_certificate="SC-2")


@pytest.fixture
def root(facts: Facts) -> Any:
    return parsed(facts)


def parsed(facts: Facts) -> Any:
    return ElementTree.fromstring(dcc_bytes(facts))


def texts(root: Any, path: str) -> list[str]:
    return ["".join(each.itertext()).strip() for each in root.iterfind(path.replace("dcc:", DCC))]


def figures(root: Any, name: str, ref: str) -> list[tuple[str, ...]]:
    """Return value, unit, U and k of a list's quantity."""
    lists = [
        each for each in root.iter(f"{DCC}list")
        if "".join(each.find(f"{DCC}name").itertext()).strip() == name
    ]  # fmt: skip
    found = [q for q in lists[0].iter(f"{DCC}quantity") if q.get("refType") == ref]
    names = ("value", "unit", "uncertainty", "coverageFactor")
    return [tuple(q.findtext(f".//{SI}{each}", "") for each in names) for q in found]


def test_the_schemas_order_holds_throughout(facts: Facts, root: Any) -> None:
    """And its rules notice an element that is missing, a word, and an id that is there twice."""
    assert dcc_bytes(facts) == dcc_bytes(facts)
    assert faults(root) == []
    core = root.find(f"{DCC}administrativeData/{DCC}coreData")
    core.remove(core.find(f"{DCC}endPerformanceDate"))
    root.find(f".//{SI}unit").text = "mm"
    for each in list(root.iter(f"{DCC}statement"))[:2]:
        each.set("id", "one")
    found = [fault.partition(":")[0] for fault in faults(root)]
    assert found == ["coreData", "unit", "id one twice", "id one twice"]


def test_figures_are_those_of_the_report_with_u_and_k(facts: Facts, root: Any) -> None:
    mean, largest = FirstPage(facts).results_at("S1100")
    ((value, unit, _, k),) = figures(root, "S1100, after, chosen", "hilcell_mean")
    assert (value, unit, k) == (f"{mean.after:.4f}", "\\milli\\metre", "2")
    assert figures(root, "S1100, before", "hilcell_largest")[0][0] == f"{largest.before:.4f}"
    assert figures(root, "S1100, before", "hilcell_targets")[0][:2] == ("4", "\\one")
    verdicts = [
        (each.outcome or Outcome.REJECTED).short
        for name in ("S1100", "S300")
        for each in FirstPage(facts).results_at(name)
    ]
    assert verdicts == ["pass", "pass", "fail", "pass"]
    conformity = ".//dcc:quantity/dcc:measurementMetaData//dcc:conformity"
    assert texts(root, conformity) == verdicts


def test_each_figure_has_the_uncertainty_of_its_own_limit(facts: Facts, root: Any) -> None:
    for series, errors_mm in (("S1100, before", BEFORE_MM), ("S1100, after, chosen", AFTER_MM)):
        guard = guard_band(facts.log, np.array(errors_mm))
        assert guard.max_mm - guard.mean_mm > 0.001
        found = [
            float(U)
            for name in ("mean", "p95", "largest")
            for _, _, U, _ in figures(root, series, f"hilcell_{name}")
        ]
        wanted_mm = [guard.mean_mm, guard.max_mm, guard.max_mm]
        assert found == pytest.approx(wanted_mm, abs=5.1e-5)


def test_each_series_says_whether_it_is_before_or_after_adjustment(root: Any) -> None:
    found = {
        "".join(each.find(f"{DCC}name").itertext()).strip(): texts(each, ".//dcc:status")
        for each in root.iter(f"{DCC}list")
        if each.get("refType") in {"hilcell_before", "hilcell_chosen"}
    }
    for name in ("S1100", "S300"):
        assert found[f"{name}, before"] == ["beforeAdjustment"]
        assert found[f"{name}, after, chosen"] == ["afterAdjustment"]


def test_a_figure_within_its_uncertainty_of_the_limit_does_not_conform(tmp_path: Path) -> None:
    """0.2 mm with U 0.03 keeps no limit of 0.21: neither pass nor fail in the report."""
    writer = validated_run(tmp_path / "r", simulated=False)
    found = replace(PASSED, holds=False, decided=Outcome.UNDECIDED, mean_tolerance_mm=0.21)
    writer.journal.append("verdict", "validation.S1100", found)
    writer.state("calibration", "validated")
    facts = writer.facts()
    assert [each.outcome for each in FirstPage(facts).results_at("S1100")] == [
        Outcome.UNDECIDED, Outcome.ACCEPTED,
    ]  # fmt: skip
    conformity = ".//dcc:quantity/dcc:measurementMetaData//dcc:conformity"
    assert texts(parsed(facts), conformity) == ["noPass", "pass"]


def test_bounds_and_the_share_that_keeps_them(
    facts: Facts, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors_mm = np.array([0.01, 0.02, 0.03, 0.09])
    coverage = Coverage(errors_mm, np.full(4, 0.05))
    in_use: Any = SimpleNamespace(radii_mm=np.array([0.04, 0.08]))
    budget = TargetBudget(in_use={"S1100": in_use}, coverage={"S1100": coverage})
    monkeypatch.setattr(dcc, "target_budget", lambda *_: budget)
    root = parsed(facts)
    assert faults(root) == []
    found = {ref: figures(root, "S1100", f"hilcell_{ref}")[0][:2]
             for ref in ("boundMean", "boundLargest", "inside")}  # fmt: skip
    assert found == {
        "boundMean": ("0.0600", MM), "boundLargest": ("0.0800", MM), "inside": ("75.0", PERCENT),
    }  # fmt: skip


def test_the_air_has_its_units_and_both_its_ends(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r", simulated=False)
    writer.air = {"temperature_c": 24.5, "pressure_mbar": 990.0, "humidity_percent": 60.0}
    writer.validated("S1900", "before", [(1.0, 0.0, 0.0)])
    writer.journal.append("verdict", "validation.S1100", PASSED)
    writer.state("calibration", "validated")
    found = {
        q.get("refType"): (q.findtext(f".//{SI}value"), q.findtext(f".//{SI}unit"))
        for q in parsed(writer.facts()).iter(f"{DCC}quantity")
        if q.get("refType", "").startswith("basic_")
    }
    assert found == {
        "basic_temperatureMin": ("22.00", CELSIUS), "basic_temperatureMax": ("24.50", CELSIUS),
        "basic_pressureMin": ("990.0", HECTOPASCAL), "basic_pressureMax": ("1013.0", HECTOPASCAL),
        "basic_humidityRelativeMin": ("45.0", PERCENT),
        "basic_humidityRelativeMax": ("60.0", PERCENT),
    }  # fmt: skip


def test_a_revoked_calibration_is_not_valid(root: Any, tmp_path: Path) -> None:
    assert texts(root, ".//dcc:valid") == []
    writer = validated_run(tmp_path / "s", simulated=False)
    writer.journal.append("verdict", "validation.S1100", PASSED)
    writer.state("calibration", "validated")
    writer.event("calibration revoked", reason="wrong reflector")
    root = parsed(writer.facts())
    assert "wrong reflector" in " ".join(texts(root, ".//dcc:statement/dcc:declaration"))
    assert texts(root, ".//dcc:valid") == ["false"]
    assert texts(root, ".//dcc:statements//dcc:conformity") == []


def test_parties_item_instruments_and_air_are_named(root: Any, tmp_path: Path) -> None:
    admin = "dcc:administrativeData/"
    assert texts(root, admin + "dcc:calibrationLaboratory/dcc:contact/dcc:name") == ["Muster GmbH"]
    assert texts(root, admin + "dcc:customer/dcc:name") == ["A & B <Aero>"]
    assert texts(root, admin + "dcc:coreData/dcc:countryCodeISO3166_1") == ["DE"]
    assert "860112" in texts(root, admin + "dcc:items//dcc:value")
    assert {"402871", "TC-1", "SC-2", "not stated", "–", "simulated"} == set(
        texts(root, ".//dcc:measuringEquipment//dcc:value")
    )
    assert texts(root, ".//dcc:influenceCondition/dcc:name")[:3] == [
        "air temperature", "air pressure", "relative humidity",
    ]  # fmt: skip
    assert texts(root, ".//dcc:traceable") == ["false"], "the weather station's is missing"
    all_named = run(tmp_path / "r", tracker_certificate="T-1", smr_certificate="S-1",
                    weather_certificate="W-1")  # fmt: skip
    assert texts(parsed(all_named), ".//dcc:traceable") == ["true"]


def test_orientations_where_they_were_measured(
    facts: Facts, root: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Turned:
        figures: ClassVar = OrientationFigures(mean_deg=0.0123, p95_deg=0.02, max_deg=0.03)

        def __len__(self) -> int:
            return 4

    names = ".//dcc:result/dcc:name"
    assert "Orientation error of the tool" not in texts(root, names)
    monkeypatch.setattr(Tables, "oriented", lambda _: [("S300", "before", Turned())])
    root = parsed(facts)
    assert faults(root) == []
    assert "Orientation error of the tool" in texts(root, names)
    found = [q for q in root.iter(f"{DCC}quantity") if q.findtext(f".//{SI}unit") == "\\degree"]
    assert "0.01230" in [q.findtext(f".//{SI}value") for q in found]


def test_a_simulated_run_traces_to_nothing_and_conforms_to_nothing(tmp_path: Path) -> None:
    root = parsed(run(tmp_path / "r", simulated=True, tracker_certificate="TC-1"))
    assert faults(root) == []
    assert texts(root, ".//dcc:conformity") == []
    assert texts(root, ".//dcc:traceable") == ["false"]
    assert texts(root, ".//dcc:valid") == ["false"]
    assert "Simulation" in texts(root, ".//dcc:statement/dcc:declaration")[0]
    assert "TC-1" not in texts(root, ".//dcc:value")


def test_a_run_without_a_judged_calibration_has_no_certificate(tmp_path: Path) -> None:
    with pytest.raises(NotWritten):
        dcc_bytes(validated_run(tmp_path / "r").facts())
    writer = validated_run(tmp_path / "s")  # killed after the first verdict
    writer.journal.append("verdict", "validation.S1100", PASSED)
    with pytest.raises(NotWritten):
        dcc_bytes(writer.facts())


def test_no_figure_that_is_none_is_certified(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nan"):
        quantity("mean", float("nan"), MM, "hilcell_mean")


def test_a_devices_control_characters_are_no_xml_and_are_replaced(tmp_path: Path) -> None:
    facts = run(tmp_path / "r", tracker_certificate="T\x00C\ufffe")
    assert "T\N{REPLACEMENT CHARACTER}C\N{REPLACEMENT CHARACTER}" in dcc_bytes(facts).decode()


@pytest.mark.filterwarnings("ignore")  # its parser warns of "\\per" whatever it reads
@pytest.mark.parametrize("unit", [MM, DEGREE, CELSIUS, HECTOPASCAL, PERCENT])
def test_units_are_of_d_si(unit: str) -> None:
    assert DsiUnit(unit).valid
    assert re.fullmatch(r"\.\df", FORMS[unit])
