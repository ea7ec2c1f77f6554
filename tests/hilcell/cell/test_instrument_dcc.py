"""Certificates of instruments as DCC: named, used where the cell file says what for, refused."""

from pathlib import Path

import pytest

from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.uncertainty import CertificateError, InstrumentDcc

ERRORS = (
    "<si:valueXMLList>0.002 -0.006 0.004</si:valueXMLList>"
    "<si:unitXMLList>\\milli\\metre</si:unitXMLList>"
    "<si:expandedUncXMLList><si:uncertaintyXMLList>0.003</si:uncertaintyXMLList>"
    "<si:coverageFactorXMLList>2</si:coverageFactorXMLList></si:expandedUncXMLList>"
)
ONE = (
    "<si:value>-4</si:value><si:unit>\\micro\\metre</si:unit>"
    "<si:measurementUncertaintyUnivariate><si:expandedMU><si:valueExpandedMU>3</si:valueExpandedMU>"
    "<si:coverageFactor>1.5</si:coverageFactor></si:expandedMU></si:measurementUncertaintyUnivariate>"
)


def dcc(quantities: str = "", head: str = "", number: str = "TC-2026-0417") -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{head}<dcc:digitalCalibrationCertificate '
        'xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="3.3.0">'
        f"<dcc:administrativeData><dcc:coreData><dcc:uniqueIdentifier>{number}</dcc:uniqueIdentifier>"
        "<dcc:endPerformanceDate>2026-04-17</dcc:endPerformanceDate></dcc:coreData>"
        "<dcc:calibrationLaboratory><dcc:contact><dcc:name><dcc:content>Muster GmbH</dcc:content>"
        "</dcc:name></dcc:contact></dcc:calibrationLaboratory></dcc:administrativeData>"
        f"{quantities}</dcc:digitalCalibrationCertificate>"
    )


def listed(inner: str, id: str = "errors") -> str:
    kind = "realListXMLList" if "XMLList" in inner else "real"
    return f'<dcc:quantity id="{id}"><si:{kind}>{inner}</si:{kind}></dcc:quantity>'


def written(folder: Path, text: str, name: str = "tracker.xml") -> Path:
    place = folder / name
    place.write_text(text, "utf-8")
    return place


def test_number_date_and_laboratory_name_a_certificate(tmp_path: Path) -> None:
    assert (
        InstrumentDcc.read(written(tmp_path, dcc())).words
        == "TC-2026-0417, 2026-04-17, Muster GmbH"
    )


@pytest.mark.parametrize(
    ("inner", "limit_mm"),
    [(ERRORS, 0.006 + 0.003), (ONE, 0.004 + 0.003 * 2 / 1.5)],
    ids=["a list, D-SI 1", "a value in micrometres, D-SI 2.2, k 1.5"],
)
def test_the_largest_error_and_its_u_at_k_2_are_the_limit(
    tmp_path: Path, inner: str, limit_mm: float
) -> None:
    found = InstrumentDcc.read(written(tmp_path, dcc(listed(inner))))
    assert found.largest_error_mm("errors") == pytest.approx(limit_mm)


@pytest.mark.parametrize(
    "text",
    [
        dcc(head='<!DOCTYPE a [<!ENTITY b "c">]>', number="&b;"),
        dcc().replace("</dcc:contact>", ""),
        "<a/>",
        dcc(number=" "),
        dcc(head=" " * 4_000_000),
        "",
    ],
    ids=["document type", "mismatched tag", "another root", "no number", "too long", "empty"],
)
def test_what_is_no_certificate_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(CertificateError):
        InstrumentDcc.read(written(tmp_path, text))


def test_no_file_and_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CertificateError):
        InstrumentDcc.read(tmp_path / "none.xml")
    (tmp_path / "sixteen.xml").write_bytes(dcc().encode("utf-16"))
    with pytest.raises(CertificateError):
        InstrumentDcc.read(tmp_path / "sixteen.xml")


@pytest.mark.parametrize(
    "quantities",
    [
        "",
        2 * listed(ONE),
        listed(ONE.replace("micro", "kilo")),
        listed(ERRORS.replace("coverageFactor", "other")),
        listed(ERRORS.replace(">2<", ">0<")),
        listed(ERRORS.replace(">0.003<", ">0.003 0.003<")),
        listed(ERRORS.replace("0.004", "four")),
        listed(ERRORS.replace("0.004", "NaN")),
        listed(ERRORS.replace("0.004", "12")),
    ],
    ids=["none", "two", "no length", "no factor", "factor 0", "two U", "word", "NaN", "too large"],
)
def test_a_quantity_that_means_something_else_is_refused(tmp_path: Path, quantities: str) -> None:
    found = InstrumentDcc.read(written(tmp_path, dcc(quantities)))
    with pytest.raises(CertificateError):
        found.largest_error_mm("errors")


def cell_file(folder: Path, **keys: str) -> str:
    built_in = Path("hilcell/cells/paper.toml").read_text("utf-8")
    stated = "".join(f'{key} = "{value}"\n' for key, value in keys.items())
    return str(written(folder, f"{built_in}\n[uncertainty]\n{stated}", "cell.toml"))


def test_a_cell_file_names_its_certificates_from_its_own_folder(tmp_path: Path) -> None:
    written(tmp_path, dcc(listed(ERRORS)))
    plain = load_cell(cell_file(tmp_path, tracker_dcc="tracker.xml")).uncertainty
    assert plain.tracker_certificate == "TC-2026-0417, 2026-04-17, Muster GmbH"
    assert (plain.tracker_limit_mm, plain.tracker_source) == (0.015, ""), "it is only named"
    used = load_cell(cell_file(tmp_path, tracker_dcc="tracker.xml#errors")).uncertainty
    assert used.tracker_limit_mm == pytest.approx(0.009)
    assert used.tracker_source.startswith("certificate TC-2026-0417")


def test_every_bad_certificate_is_reported_at_its_line(tmp_path: Path) -> None:
    written(tmp_path, dcc(), "w.xml")
    place = cell_file(tmp_path, tracker_dcc="t.xml", weather_dcc="w.xml#a", smr_dcc="w.xml",
                      smr_certificate="S")  # fmt: skip
    with pytest.raises(SettingsError) as caught:
        load_cell(place)
    assert len(caught.value.problems) == 3
    assert all(problem.startswith(f"{place}:") for problem in caught.value.problems)
