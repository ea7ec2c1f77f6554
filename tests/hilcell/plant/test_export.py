"""A cell's record for an auditor: whole, signed, and proven without a database."""

from __future__ import annotations

import getpass
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.rsa import generate_private_key
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    KeySerializationEncryption,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)
from sqlalchemy import Executable, delete, text, update

from hilcell.commands.cli import main
from hilcell.journal.runs import CALIBRATION, read_records
from hilcell.plant.database import Database
from hilcell.plant.manifest import MANIFEST, SIGNATURE, sound
from hilcell.plant.record import record_of
from hilcell.plant.tables import DOCUMENT, RUN
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.test_refusals import said
from tests.hilcell.plant.year import Model, Run
from tests.whole.golden import GoldenRuns

RUN_NAME = "small"
PASSPHRASE = "s3cr-t"


def private(
    path: Path, key: object = None, encryption: KeySerializationEncryption | None = None
) -> Path:
    """Write a private key as openssl does."""
    made = key if key is not None else Ed25519PrivateKey.generate()
    assert isinstance(made, Ed25519PrivateKey) or hasattr(made, "private_bytes")
    form = (Encoding.PEM, PrivateFormat.PKCS8, encryption or NoEncryption())
    path.write_bytes(made.private_bytes(*form))
    path.chmod(0o600)
    return path


def public(path: Path, key: Ed25519PrivateKey) -> Path:
    form = (Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    path.write_bytes(key.public_key().public_bytes(*form))
    return path


class Auditor:
    """A key of the plant, what was exported, and the commands."""

    def __init__(self, folder: Path, signer: Ed25519PrivateKey) -> None:
        self.folder, self.signer = folder, signer
        self.url = f"sqlite:///{folder}/plant.db"
        self.key, self.public = private(folder / "key", signer), public(folder / "pub", signer)
        self.out = folder / "out"

    def export(self, *more: str, cell: str = "paper", out: Path | None = None) -> list[str]:
        words = ["plant", "export", cell, "--from", self.url, "--key", str(self.key)]
        return [*words, "-o", str(out or self.out), *more]

    def verify(self, place: Path | None = None) -> list[str]:
        return ["plant", "verify", str(place or self.out), "--public-key", str(self.public)]

    def sign(self, manifest: dict[str, object]) -> None:
        content = json.dumps(manifest).encode()
        (self.out / MANIFEST).write_bytes(content)
        (self.out / SIGNATURE).write_bytes(self.signer.sign(content))

    @property
    def names(self) -> set[str]:
        return {each.name for each in self.folder.iterdir()}


@pytest.fixture(scope="module")
def first(golden: GoldenRuns, tmp_path_factory: pytest.TempPathFactory) -> Auditor:
    """Return the auditor of whom all others are copies: a whole calibration was shipped."""
    folder = tmp_path_factory.mktemp("audit")
    journal = golden[RUN_NAME].copied_to(folder / "runs")
    auditor = Auditor(folder, Ed25519PrivateKey.generate())
    assert main(["plant", "init", "--to", auditor.url]) == 0
    assert main(["plant", "ship", str(journal.parent), "--to", auditor.url]) == 0
    assert main(auditor.export()) == 0
    return auditor


@pytest.fixture
def empty(first: Auditor, tmp_path: Path) -> Auditor:
    """Return an auditor who has nothing yet."""
    shutil.copy(first.folder / "plant.db", tmp_path)
    return Auditor(tmp_path, first.signer)


@pytest.fixture
def auditor(first: Auditor, empty: Auditor) -> Auditor:
    """Return an auditor who has the record of the cell."""
    shutil.copytree(first.out, empty.out)
    return empty


def test_an_export_holds_all_of_a_cell_and_is_proven(
    first: Auditor, empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    auditor = empty
    assert "1 records of runs, 1 of them simulated" in said(auditor.export(), 0, capsys)
    assert "are as they were signed" in said(auditor.verify(), 0, capsys)
    (folder,) = (auditor.out / "runs").iterdir()
    journal = first.folder / "runs" / RUN_NAME
    record = record_of(RUN_NAME, read_records(journal))
    kept = {path.stem: json.loads(path.read_text()) for path in folder.glob("*.json")}
    assert kept["run"]["head"] == record.head
    assert len(kept["points"]) == len(record.points)
    assert {each["key"] for each in kept["frames"]} == {each.key for each in record.frames}
    assert {each["key"] for each in kept["verdicts"]} == {each.key for each in record.verdicts}
    document = (folder / "documents" / CALIBRATION).read_bytes()
    assert document == (journal / CALIBRATION).read_bytes()


@pytest.mark.parametrize("name", ["x.tar.gz", "x.TGZ", "x.7z"])
def test_an_archive_of_another_form_is_refused(
    name: str, empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    before = empty.names
    line = said(empty.export(out=empty.folder / name), 2, capsys)
    assert "archive by its name; name a folder or a .zip file" in line
    assert empty.names == before


def test_an_archive_is_proven_as_a_folder_is(
    auditor: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    place = auditor.folder / "out.ZIP"
    said(auditor.export(out=place), 0, capsys)
    assert "are as they were signed" in said(auditor.verify(place), 0, capsys)
    with zipfile.ZipFile(place, "a") as archive:
        archive.writestr("more.txt", "more")
    assert main(auditor.verify(place)) == 1
    assert "more.txt: is not in the manifest" in capsys.readouterr().err
    content = bytearray(place.read_bytes())
    content[200:260] = bytes(60)
    place.write_bytes(content)
    assert main(auditor.verify(place)) == 1
    assert "run.json: cannot be read: " in capsys.readouterr().err
    place.write_bytes(content[:1000])
    assert "neither an exported folder nor its archive" in said(auditor.verify(place), 2, capsys)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_openssl_makes_the_keys_and_verifies_the_signature(
    empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    def openssl(*words: str | Path) -> None:
        subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)

    empty.key, empty.public = empty.folder / "plant.key", empty.folder / "plant.pub"
    openssl("genpkey", "-algorithm", "ed25519", "-out", empty.key)
    openssl("pkey", "-in", empty.key, "-pubout", "-out", empty.public)
    said(empty.export(), 0, capsys)
    said(empty.verify(), 0, capsys)
    signed = ("-in", empty.out / MANIFEST, "-sigfile", empty.out / SIGNATURE)
    openssl("pkeyutl", "-verify", "-pubin", "-inkey", empty.public, "-rawin", *signed)


def test_each_file_that_was_touched_is_named(
    auditor: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder,) = (auditor.out / "runs").iterdir()
    points = folder / "points.json"
    points.write_text(points.read_text().replace("1", "2", 1))
    (folder / "frames.json").write_text("[]")
    (folder / "verdicts.json").unlink()
    (folder / "devices.json").unlink()
    (folder / "devices.json").symlink_to(auditor.key)
    (auditor.out / "more.txt").write_text("more")
    (auditor.out / "linked").symlink_to(auditor.folder)
    Path(os.fsdecode(bytes(auditor.out) + b"/no-text-\xff")).touch()
    assert main([*auditor.verify(), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    name = f"runs/{folder.name}"
    findings = found["findings"]
    assert findings.pop(f"{name}/frames.json").startswith("differs: 2 bytes, signed were ")
    assert found["holds"] is False
    assert findings == {
        f"{name}/points.json": "differs: another SHA-256",
        f"{name}/verdicts.json": "is missing",
        f"{name}/devices.json": "is no plain file",
        "more.txt": "is not in the manifest",
        "linked": "is not in the manifest",
        "no-text-?": "is not in the manifest",
    }


def changed(out: Path) -> None:
    text = (out / MANIFEST).read_text()
    (out / MANIFEST).write_text(text.replace('"runs": 1', '"runs": 2'))


def cut(out: Path) -> None:
    (out / MANIFEST).write_bytes((out / MANIFEST).read_bytes()[:300])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (changed, "manifest.json was changed, or signed by another key than SHA256:"),
        (cut, "manifest.json was changed, or signed by another key than SHA256:"),
        (lambda out: (out / MANIFEST).unlink(), "manifest.json is missing"),
        (lambda out: (out / SIGNATURE).unlink(), "manifest.sig is missing"),
        (lambda out: (out / SIGNATURE).write_bytes(b""), "was changed, or signed by another"),
        (lambda out: (out / SIGNATURE).write_bytes(bytes(9999)), "9999 bytes, wanted at most 64"),
        (shutil.rmtree, "cannot be read: No such file"),
    ],
)
def test_a_manifest_that_is_not_proven_is_one_line(
    spoil: Callable[[Path], object], words: str, auditor: Auditor,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    spoil(auditor.out)
    assert words in said(auditor.verify(), 2, capsys)


def test_what_is_no_record_is_one_line(
    auditor: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = auditor.folder / "pipe"
    os.mkfifo(pipe)
    for place in (pipe, Path("/dev/zero")):
        assert "neither a folder nor a file" in said(auditor.verify(place), 2, capsys)
    (auditor.out / SIGNATURE).unlink()
    os.mkfifo(auditor.out / SIGNATURE)
    assert "manifest.sig is no plain file" in said(auditor.verify(), 2, capsys)


def test_a_full_disk_leaves_nothing(empty: Auditor) -> None:
    """Stood in for by a limit on the size of files, in a process of its own."""
    before = empty.names
    limit = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, 8_000));"
    unkept = "sys.dont_write_bytecode = True;"  # Python would keep half of a module's
    start = "from hilcell.__main__ import entry; sys.exit(entry())"
    for place in (empty.out, empty.folder / "out.zip"):
        words = [sys.executable, "-c", f"{limit} {unkept} {start}", *empty.export(out=place)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (7, "")
        assert done.stderr == f"hilcell: {place}: cannot be written: File too large\n"
    assert empty.names == before


def test_a_hostile_archive_is_one_line(empty: Auditor, capsys: pytest.CaptureFixture[str]) -> None:
    """Packed by what has errors of its own, or named by what is no text."""
    packed, named = empty.folder / "packed.zip", empty.folder / "named.zip"
    for place, kind in ((packed, zipfile.ZIP_LZMA), (named, zipfile.ZIP_STORED)):
        with zipfile.ZipFile(place, "w", kind) as archive:
            archive.writestr(MANIFEST, bytes(1000))
            archive.writestr("\xe9", b"")
    packed.write_bytes(packed.read_bytes().replace(b"\x5d\x00", b"\xff\xff", 1))
    named.write_bytes(named.read_bytes().replace("\xe9".encode(), b"\xff\xff"))
    assert "manifest.json is no plain file" in said(empty.verify(packed), 2, capsys)
    assert "it is neither an exported folder nor its archive" in said(
        empty.verify(named), 2, capsys
    )


def test_another_key_proves_nothing(auditor: Auditor, capsys: pytest.CaptureFixture[str]) -> None:
    public(auditor.public, Ed25519PrivateKey.generate())
    assert "nothing in this record is proven" in said(auditor.verify(), 2, capsys)


@pytest.mark.parametrize("name", ["../key", "/etc/passwd", "a/../../key", "a\\b", "C:x", "", "./a"])
def test_a_manifest_that_names_a_file_outside_is_refused(
    name: str, auditor: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    """Even where the plant has signed it."""
    assert not sound(name)
    manifest = json.loads((auditor.out / MANIFEST).read_text())
    manifest["files"][name] = {"bytes": 1, "sha256": "0"}
    auditor.sign(manifest)
    assert "names 1 files that are not within the record" in said(auditor.verify(), 2, capsys)


def test_a_signed_manifest_of_another_form_is_refused(
    auditor: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = json.loads((auditor.out / MANIFEST).read_text())
    auditor.sign(manifest | {"form": 9})
    assert "form 9, this hilcell verifies 1 to 2; update" in said(auditor.verify(), 2, capsys)
    auditor.sign(manifest | {"key": "SHA256:other"})
    assert "names another key than that which signed it" in said(auditor.verify(), 2, capsys)
    auditor.sign({"files": []})
    assert "manifest.json is none that is known" in said(auditor.verify(), 2, capsys)


def test_a_key_that_cannot_be_used_is_one_line_and_writes_nothing(
    empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(words: str) -> None:
        assert words in said(empty.export(), 2, capsys)
        assert not empty.out.exists()

    private(empty.key, generate_private_key(65537, 2048))
    refused("another kind of key, wanted Ed25519")
    private(empty.key, encryption=BestAvailableEncryption(PASSPHRASE.encode()))
    refused("it is encrypted; export in a terminal")
    empty.key.write_text("-----BEGIN PRIVATE KEY-----\nno\n")
    refused("it is no private key in PEM; `openssl genpkey -algorithm ed25519 -out FILE`")
    empty.key.write_bytes(empty.public.read_bytes())
    empty.key.chmod(0o644)
    refused("it is a public key, wanted the private one; name that one; `openssl genpkey")
    private(empty.key).chmod(0o640)
    refused("others than its owner may use it (mode 0640); `chmod 600` that file")
    empty.key.write_bytes(bytes(100_000))
    refused("too long to be a key")
    empty.key.unlink()
    refused("it cannot be read: No such file or directory")
    assert not any(name.endswith(".part") for name in empty.names)


def test_a_public_key_that_cannot_be_used_is_one_line(
    auditor: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    auditor.public = auditor.key
    assert "it is a private key, wanted the public one" in said(auditor.verify(), 2, capsys)
    auditor.public = auditor.folder / "other"
    auditor.public.write_text("no key")
    assert "it is no public key in PEM" in said(auditor.verify(), 2, capsys)
    rsa = generate_private_key(65537, 2048).public_key()
    form = (Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    auditor.public.write_bytes(rsa.public_bytes(*form))
    assert "another kind of key, wanted Ed25519" in said(auditor.verify(), 2, capsys)


def test_a_terminal_asks_for_the_passphrase(
    empty: Auditor, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    private(empty.key, empty.signer, BestAvailableEncryption(PASSPHRASE.encode()))
    answers: list[str | Exception] = ["wrong", "", "\udcff", EOFError(), PASSPHRASE]

    def answered(_: str) -> str:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(getpass, "getpass", answered)
    while len(answers) > 1:
        line = said(empty.export(), 2, capsys)
        assert "its passphrase is another" in line
        assert PASSPHRASE not in line
    said(empty.export(), 0, capsys)
    said(empty.verify(), 0, capsys)


def test_a_place_that_is_taken_is_left_as_it_is(
    empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    empty.out.mkdir()
    assert "it is there already" in said(empty.export(), 2, capsys)
    assert list(empty.out.iterdir()) == []
    place = empty.folder / "no" / "out"
    assert "cannot be written: No such file" in said(empty.export(out=place), 2, capsys)


def change(url: str, *orders: Executable) -> None:
    with closing(Database(url)) as database, database.transaction() as connection:
        for order in orders:
            connection.execute(order)


def test_a_database_that_was_changed_is_not_signed(
    empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    before = empty.names
    change(empty.url, update(DOCUMENT).values(text=DOCUMENT.c.text + " "))
    line = said(empty.export(), 2, capsys)
    assert "run small: its calibration.json is not the one that was shipped" in line
    change(empty.url, delete(DOCUMENT), update(RUN).values(points=RUN.c.points + 1))
    for place in (empty.out, empty.folder / "out.zip"):
        assert "points that count: the plant's database" in said(empty.export(out=place), 2, capsys)
    assert empty.names == before


@pytest.mark.parametrize(
    "order",
    [
        "UPDATE point SET x_mm = x_mm + 5 WHERE seq = (SELECT min(seq) FROM point)",
        "UPDATE point SET strip_mm = 9e999 WHERE seq = (SELECT min(seq) FROM point)",
        "UPDATE point SET t = '2026-01-01 00:00:00.000000'",
        "UPDATE point SET t = substr(t, 1, 11) || '03:03:03.000000'",  # of the same day
        "UPDATE verdict SET mean_mm = 0.001 WHERE mean_mm IS NOT NULL",
        "UPDATE frame SET matrix = replace(matrix, '1.0', '1.5') WHERE key = 'world'",
        "UPDATE run SET exit = 1",
        "UPDATE run SET \"row\" = replace(\"row\", 'finished', 'aborted')",
        "DELETE FROM verdict",
        "INSERT INTO alarm SELECT digest, 99, ended, 'HC-B23', 'x', 'x', 'x', 'x' FROM run",
        "UPDATE device SET serial = 'other' WHERE kind = 'tracker'",
    ],
)
def test_a_value_that_was_changed_in_the_database_is_not_signed(
    order: str, empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    before = empty.names
    change(empty.url, text(order))
    line = said(empty.export(), 2, capsys)
    assert "1 run is not as shipped: small: the plant's database was changed or damaged" in line
    assert empty.names == before


def test_a_value_that_its_column_cannot_hold_is_one_line(
    empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    change(empty.url, text("UPDATE point SET t = 'yesterday'"))
    assert "run small: the plant has values that cannot be read" in said(empty.export(), 2, capsys)


def test_every_run_that_was_changed_is_named(
    empty: Auditor, model: Model, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = empty.folder / "more"
    for hours, name in enumerate("abcde"):
        model.write(runs, Run(name, "north", "HC-1", NOW - timedelta(hours=hours)))
    assert main(["plant", "ship", str(runs), "--to", empty.url]) == 0
    capsys.readouterr()
    said(empty.export(cell="north", out=empty.folder / "before"), 0, capsys)
    change(empty.url, text("UPDATE run SET robot = 'R-9' WHERE name <> 'b' AND cell = 'north'"))
    line = said(empty.export(cell="north"), 2, capsys)
    assert "4 runs are not as shipped: e, d, c and 1 more" in line


def test_a_run_of_an_earlier_version_is_exported_and_named_as_not_proven(
    empty: Auditor, capsys: pytest.CaptureFixture[str]
) -> None:
    change(empty.url, update(RUN).values(form=2))
    words = "note: 1 of 1 records came from another version of hilcell: whether the plant has them"
    for command in (empty.export(), empty.verify()):
        assert main(command) == 0
        assert words in capsys.readouterr().err
    (folder,) = (empty.out / "runs").iterdir()
    manifest = json.loads((empty.out / MANIFEST).read_text())
    assert manifest["unchecked"] == [f"runs/{folder.name}"]
    empty.sign(manifest | {"form": 1, "unchecked": None})
    assert main([*empty.verify(), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unchecked"] == 1


def test_two_cells_of_one_name_want_a_serial_number(
    empty: Auditor, model: Model, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a run's name of another computer is never a path."""
    runs = empty.folder / "more"
    model.write(runs, Run("a\u202e*b", "north", "HC-1", NOW))
    model.write(runs, Run("b", "north", "HC-2", NOW))
    assert main(["plant", "ship", str(runs), "--to", empty.url]) == 0
    capsys.readouterr()
    line = said(empty.export(cell="north"), 2, capsys)
    assert "2 serial numbers have the name north: HC-1, HC-2; say which with --serial" in line
    said(empty.export("--serial", "HC-1", cell="north"), 0, capsys)
    (folder,) = (empty.out / "runs").iterdir()
    assert folder.name.startswith("a__b-")
    assert "did you mean" in said(empty.export(cell="nroth"), 2, capsys)
    line = said(empty.export("--serial", "HC-9", cell="north"), 2, capsys)
    assert "of serial number HC-9 has shipped no run; there are HC-1, HC-2" in line
