"""A cell's record for an auditor: whole, signed, and proven without a database."""

from __future__ import annotations

import getpass
import json
import os
import shutil
import sys
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, generate_private_key
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    KeySerializationEncryption,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)
from sqlalchemy import text

from hilcell.commands.cli import main
from hilcell.journal.runs import CALIBRATION, read_records
from hilcell.plant.audit import MANIFEST, SIGNATURE, is_inside
from hilcell.plant.database import Database
from hilcell.plant.record import run_record
from hilcell.plant.tables import FRAME, POINT, RUN, VERDICT
from tests.hilcell.commands.full_disk import files_limited_to
from tests.hilcell.plant.conftest import NOW, refused
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import command
from tests.whole.golden import GoldenRuns

RUN_NAME = "small"
PASSPHRASE = "s3cr-t"


def private(
    path: Path,
    key: Ed25519PrivateKey | RSAPrivateKey | None = None,
    encryption: KeySerializationEncryption | None = None,
) -> Path:
    """Write a private key as openssl does."""
    made = key if key is not None else Ed25519PrivateKey.generate()
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

    def said(self, words: list[str], code: int = 2) -> str:
        return refused(*words[1:], code=code)

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
    shutil.copy(first.folder / "plant.db", tmp_path)
    return Auditor(tmp_path, first.signer)


@pytest.fixture
def auditor(first: Auditor, empty: Auditor) -> Auditor:
    shutil.copytree(first.out, empty.out)
    return empty


def test_an_export_holds_all_of_a_cell_and_is_proven(first: Auditor, empty: Auditor) -> None:
    auditor = empty
    auditor.said(auditor.export(), 0)
    auditor.said(auditor.verify(), 0)
    signature, signed = ((auditor.out / name).read_bytes() for name in (SIGNATURE, MANIFEST))
    auditor.signer.public_key().verify(signature, signed)  # as openssl does
    (folder,) = (auditor.out / "runs").iterdir()
    journal = first.folder / "runs" / RUN_NAME
    record = run_record(RUN_NAME, read_records(journal))
    kept = {path.stem: json.loads(path.read_text()) for path in folder.glob("*.json")}
    assert kept["run"]["head"] == record.rows[RUN][0]["head"]
    assert len(kept["points"]) == len(record.rows[POINT])
    assert {each["key"] for each in kept["frames"]} == {each["key"] for each in record.rows[FRAME]}
    assert {each["key"] for each in kept["verdicts"]} == {
        each["key"] for each in record.rows[VERDICT]
    }
    document = (folder / "documents" / CALIBRATION).read_bytes()
    assert document == (journal / CALIBRATION).read_bytes()


def test_an_archive_is_proven_as_a_folder_is(auditor: Auditor) -> None:
    place = auditor.folder / "out.ZIP"
    auditor.said(auditor.export(out=place), 0)
    auditor.said(auditor.verify(place), 0)
    with zipfile.ZipFile(place, "a") as archive:
        archive.writestr("more.txt", "more")
    assert "more.txt" in command(*auditor.verify(place)).stderr
    content = bytearray(place.read_bytes())
    content[200:260] = bytes(60)
    place.write_bytes(content)
    done = command(*auditor.verify(place))
    assert done.returncode == 1
    assert "run.json" in done.stderr
    place.write_bytes(content[:1000])
    auditor.said(auditor.verify(place))


def test_a_file_that_is_twice_in_an_archive_is_named(auditor: Auditor) -> None:
    """Programs differ in which of both they read."""
    place = auditor.folder / "twice.zip"
    auditor.said(auditor.export(out=place), 0)
    with zipfile.ZipFile(place, "a") as archive:
        name = next(each for each in archive.namelist() if each.endswith("run.json"))
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr(name, archive.read(name))
    done = command(*auditor.verify(place))
    assert done.returncode == 1
    assert f"{name}: is no regular file" in done.stderr


def test_each_file_that_was_touched_is_named(auditor: Auditor) -> None:
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
    done = command(*auditor.verify(), "--json")
    assert done.returncode == 1
    found = json.loads(done.stdout)
    assert found["holds"] is False
    names = {f"runs/{folder.name}/{n}.json" for n in ("points", "frames", "verdicts", "devices")}
    assert set(found["findings"]) == names | {"more.txt", "linked", "no-text-?"}


def changed(out: Path) -> None:
    text = (out / MANIFEST).read_text()
    (out / MANIFEST).write_text(text.replace('"runs": 1', '"runs": 2'))


def piped(out: Path) -> None:
    (out / SIGNATURE).unlink()
    os.mkfifo(out / SIGNATURE)


@pytest.mark.parametrize(
    "spoil",
    [
        changed,
        piped,
        lambda out: (out / MANIFEST).unlink(),
        lambda out: (out / SIGNATURE).unlink(),
        lambda out: (out / SIGNATURE).write_bytes(b""),
        lambda out: (out / SIGNATURE).write_bytes(bytes(9999)),
        shutil.rmtree,
    ],
)
def test_a_manifest_that_is_not_proven_is_refused(
    spoil: Callable[[Path], object], auditor: Auditor
) -> None:
    spoil(auditor.out)
    auditor.said(auditor.verify())


def test_another_key_proves_nothing(auditor: Auditor) -> None:
    public(auditor.public, Ed25519PrivateKey.generate())
    auditor.said(auditor.verify())
    pipe = auditor.folder / "pipe"
    os.mkfifo(pipe)
    for place in (pipe, Path("/dev/zero")):
        auditor.said(auditor.verify(place))


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_a_full_disk_leaves_nothing(name: str, empty: Auditor) -> None:
    before = empty.names
    with files_limited_to(8_000):
        line = empty.said(empty.export(out=empty.folder / name), 7)
    assert str(empty.folder / name) in line
    assert empty.names == before


def test_a_hostile_archive_is_one_line(empty: Auditor) -> None:
    """Packed by a method with errors of its own, or with a name that is no text."""
    packed, named = empty.folder / "packed.zip", empty.folder / "named.zip"
    for place, kind in ((packed, zipfile.ZIP_LZMA), (named, zipfile.ZIP_STORED)):
        with zipfile.ZipFile(place, "w", kind) as archive:
            archive.writestr(MANIFEST, bytes(1000))
            archive.writestr("\xe9", b"")
    packed.write_bytes(packed.read_bytes().replace(b"\x5d\x00", b"\xff\xff", 1))
    named.write_bytes(named.read_bytes().replace("\xe9".encode(), b"\xff\xff"))
    empty.said(empty.verify(packed))
    empty.said(empty.verify(named))


@pytest.mark.parametrize("name", ["../key", "/etc/passwd", "a/../../key", "a\\b", "C:x", "", "./a"])
def test_a_manifest_that_names_a_file_outside_is_refused(name: str, auditor: Auditor) -> None:
    """Even where the plant has signed it."""
    assert not is_inside(name)
    manifest = json.loads((auditor.out / MANIFEST).read_text())
    manifest["files"][name] = {"bytes": 1, "sha256": "0"}
    auditor.sign(manifest)
    auditor.said(auditor.verify())


def test_a_signed_manifest_of_another_form_is_refused(auditor: Auditor) -> None:
    manifest = json.loads((auditor.out / MANIFEST).read_text())
    others: list[dict[str, object]] = [
        manifest | {"form": 9}, manifest | {"key": "SHA256:other"}, {"files": []},
    ]  # fmt: skip
    for other in others:
        auditor.sign(other)
        auditor.said(auditor.verify())


@pytest.mark.parametrize(
    "spoil",
    [
        lambda key: private(key, generate_private_key(65537, 2048)),
        lambda key: private(key, encryption=BestAvailableEncryption(PASSPHRASE.encode())),
        lambda key: key.write_text("-----BEGIN PRIVATE KEY-----\nno\n"),
        lambda key: key.write_bytes(key.with_name("pub").read_bytes()),
        lambda key: key.chmod(0o640),
        lambda key: key.write_bytes(bytes(100_000)),
        Path.unlink,
    ],
)
def test_a_key_that_cannot_be_used_is_one_line_and_writes_nothing(
    spoil: Callable[[Path], object], empty: Auditor
) -> None:
    spoil(empty.key)
    assert str(empty.key) in empty.said(empty.export())
    assert not empty.out.exists()
    assert not any(name.endswith(".part") for name in empty.names)


def rsa(key: Path) -> None:
    made = generate_private_key(65537, 2048).public_key()
    key.write_bytes(made.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))


@pytest.mark.parametrize(
    "spoil", [rsa, lambda pub: private(pub, None), lambda pub: pub.write_text("no key")]
)
def test_a_public_key_that_cannot_be_used_is_one_line(
    spoil: Callable[[Path], object], auditor: Auditor
) -> None:
    spoil(auditor.public)
    assert str(auditor.public) in auditor.said(auditor.verify())


def test_a_terminal_asks_for_the_passphrase(
    empty: Auditor, monkeypatch: pytest.MonkeyPatch
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
        assert PASSPHRASE not in empty.said(empty.export())
    empty.said(empty.export(), 0)
    empty.said(empty.verify(), 0)


def test_a_place_that_is_taken_is_left_as_it_is(empty: Auditor) -> None:
    empty.out.mkdir()
    empty.said(empty.export())
    assert list(empty.out.iterdir()) == []
    empty.said(empty.export(out=empty.folder / "no" / "out"))


@pytest.mark.parametrize(
    "order",
    [
        "UPDATE point SET x_mm = x_mm + 5 WHERE seq = (SELECT min(seq) FROM point)",
        "UPDATE point SET strip_mm = 9e999 WHERE seq = (SELECT min(seq) FROM point)",
        "UPDATE point SET t = substr(t, 1, 11) || '03:03:03.000000'",  # of the same day
        "UPDATE point SET t = 'yesterday'",
        "UPDATE verdict SET mean_mm = 0.001 WHERE mean_mm IS NOT NULL",
        "UPDATE frame SET matrix = replace(matrix, '1.0', '1.5') WHERE key = 'world'",
        "UPDATE run SET exit = 1",
        "UPDATE run SET points = points + 1",
        "UPDATE outcome SET \"row\" = replace(\"row\", 'finished', 'aborted')",
        "DELETE FROM verdict",
        "INSERT INTO alarm SELECT digest, 99, ended, 'HC-B23', 'x', 'x', 'x', 'x' FROM run",
        "UPDATE device SET serial = 'other' WHERE kind = 'tracker'",
        "UPDATE document SET text = text || ' '",
    ],
)
def test_a_value_that_was_changed_in_the_database_is_not_signed(order: str, empty: Auditor) -> None:
    before = empty.names
    with closing(Database(empty.url)) as database, database.transaction() as connection:
        connection.execute(text("PRAGMA ignore_check_constraints = ON"))
        connection.execute(text(order))
    assert RUN_NAME in empty.said(empty.export())
    assert empty.names == before


def test_two_cells_of_one_name_want_a_serial_number(empty: Auditor, model: Model) -> None:
    """And a run's name of another computer is never a path."""
    runs = empty.folder / "more"
    model.write(runs, Run("a\u202e*b", "north", "HC-1", NOW))
    model.write(runs, Run("b", "north", "HC-2", NOW))
    assert main(["plant", "ship", str(runs), "--to", empty.url]) == 0
    assert "HC-1, HC-2" in empty.said(empty.export(cell="north"))
    empty.said(empty.export("--serial", "HC-1", cell="north"), 0)
    (folder,) = (empty.out / "runs").iterdir()
    assert folder.name.startswith("a__b-")
    assert '"north"' in empty.said(empty.export(cell="nroth"))
    assert "HC-1, HC-2" in empty.said(empty.export("--serial", "HC-9", cell="north"))
