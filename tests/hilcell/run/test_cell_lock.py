"""Locks of devices: one folder for all users, and what others have planted there is left alone."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path
from uuid import uuid4

import pytest

from hilcell.journal.journal import StorageError
from hilcell.ports import Identity
from hilcell.run import cell_lock
from hilcell.run.cell_lock import OVERRIDE, CellLocked, lock_of_device, locked, locks_folder
from tests.hilcell.run.bed import Bed, Live
from tests.hilcell.run.rig import Points, procedure

PLACE = "10.0.0.1:7000"


@pytest.fixture
def usual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the usual folder, as on a machine on which nobody has made it yet."""
    monkeypatch.delenv(OVERRIDE)
    monkeypatch.setattr(cell_lock, "USUAL", tmp_path / "run-lock" / "hilcell")
    monkeypatch.setattr(cell_lock, "BEFORE_SET_UP", tmp_path / "tmp-locks")
    (tmp_path / "run-lock").mkdir()
    return tmp_path / "run-lock" / "hilcell"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


def test_all_users_share_one_folder_and_its_files(usual: Path) -> None:
    """Whatever TMPDIR and the umask say; nobody may remove another's lock."""
    before = os.umask(0o077)
    try:
        with locked(lock_of_device(PLACE), "rail", "r"):
            pass
    finally:
        os.umask(before)
    assert locks_folder() == (usual, "")
    assert mode(usual) == 0o1777
    assert [mode(each) for each in usual.iterdir()] == [0o666]


def test_no_folder_of_a_user_decides(usual: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = lock_of_device(PLACE)
    monkeypatch.setenv("TMPDIR", str(usual.parent))
    monkeypatch.setattr(tempfile, "tempdir", None)
    assert lock_of_device(PLACE) == first
    assert lock_of_device("10.0.0.2:7000") != first


def test_a_machine_that_has_no_such_folder_says_so(usual: Path) -> None:
    usual.parent.rmdir()
    folder, note = locks_folder()
    assert mode(folder) == 0o1777
    assert str(usual) in note


def test_a_folder_of_the_plant_s_own(
    usual: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(OVERRIDE, str(tmp_path / "own"))
    assert locks_folder() == (tmp_path / "own", "")
    monkeypatch.setenv(OVERRIDE, str(tmp_path / "none" / "own"))
    with pytest.raises(StorageError, match="none/own"):
        lock_of_device(PLACE)  # never a silent fallback
    assert not usual.exists()


def test_a_folder_that_is_a_link_is_not_used(usual: Path, tmp_path: Path) -> None:
    (tmp_path / "victim").mkdir()
    usual.symlink_to(tmp_path / "victim")
    folder, note = locks_folder()
    assert folder == tmp_path / "tmp-locks"
    assert note
    folder.rmdir()
    folder.symlink_to(tmp_path / "victim")
    with pytest.raises(StorageError, match="tmp-locks"):
        locks_folder()
    assert [*(tmp_path / "victim").iterdir()] == []


def given_away(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a folder belong to another user."""
    if os.getuid() == 0:
        os.chown(folder, 4711, 4711)
    else:
        monkeypatch.setattr(os, "getuid", lambda: 4711)


@pytest.mark.parametrize("folder", ["run-lock/hilcell", "tmp-locks"])
def test_a_folder_of_another_user_is_not_used_and_nothing_in_its_place(
    usual: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    """He could remove a lock that is held, and a second engine would get past it."""
    if folder == "tmp-locks":
        usual.parent.rmdir()
    assert locks_folder()[0] == tmp_path / folder
    given_away(tmp_path / folder, monkeypatch)
    with pytest.raises(StorageError, match=f"{folder} .*4711") as caught:
        lock_of_device(PLACE)
    assert f"sudo install -d -o root -g root -m 1777 {tmp_path / folder}" in str(caught.value)


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o2770])
@pytest.mark.parametrize("own", [True, False], ids=["own", "usual"])
def test_a_folder_in_which_others_remove_locks_is_not_used(
    usual: Path, monkeypatch: pytest.MonkeyPatch, mode: int, own: bool
) -> None:
    if own:
        monkeypatch.setenv(OVERRIDE, str(usual))
    lock_of_device(PLACE)
    usual.chmod(mode)
    with pytest.raises(StorageError, match=f"{usual}.*mode is {mode:o}"):
        lock_of_device(PLACE)
    usual.chmod(mode | stat.S_ISVTX)
    lock_of_device(PLACE)


def test_a_lock_that_is_removed_while_it_is_taken_is_not_held(
    usual: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lock, take = lock_of_device(PLACE), cell_lock._take
    removals = iter([lock.unlink])

    def removed(file: int, what: str) -> None:
        take(file, what)
        next(removals, lambda: None)()

    monkeypatch.setattr(cell_lock, "_take", removed)
    with locked(lock, "rail", "r"), pytest.raises(CellLocked):
        locked(lock, "rail", "other").__enter__()


@pytest.mark.parametrize("plant", ["symlink_to", "hardlink_to"])
def test_what_was_planted_is_neither_followed_nor_changed(
    usual: Path, tmp_path: Path, plant: str
) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    lock = lock_of_device(PLACE)
    getattr(lock, plant)(victim)
    with pytest.raises(StorageError, match=f"{usual}"):
        locked(lock, "rail", "r").__enter__()
    assert victim.read_text() == "precious"


def test_a_fifo_does_not_keep_a_run_waiting(usual: Path) -> None:
    lock = lock_of_device(PLACE)
    os.mkfifo(lock)
    with pytest.raises(StorageError, match="lock"):
        locked(lock, "rail", "r").__enter__()


def test_an_existing_lock_is_taken_as_it_is(usual: Path) -> None:
    """An existing file is opened, never created again, and its holder's words are replaced."""
    lock = lock_of_device(PLACE)
    lock.write_text("run earlier-with-a-long-name (pid 123456)")
    with (
        locked(lock, "rail", "r"),
        pytest.raises(CellLocked, match=f"r .*{os.getpid()}"),
    ):
        locked(lock, "rail", "other").__enter__()
    with locked(lock, "rail", "again"):
        pass


# -- A device is locked by what it says it is, whatever its address --------------------------------


def bed_at(folder: Path, identity: Identity) -> Bed:
    folder.mkdir()
    bed = Bed(folder)
    bed.rail.identity = identity
    return bed


def held(tmp_path: Path, first: Identity, second: Identity) -> tuple[int, Bed]:
    """Return how a second run ends while a first is paused."""
    other = bed_at(tmp_path / "first", first)
    with Live(other, procedure(Points(10**6))) as live:
        live.runner.post("pause")
        live.until("state", "paused")
        bed = bed_at(tmp_path / "second", second)
        code = bed.run(procedure(Points(1)))
        live.runner.stop()
    assert live.code == 4
    return code, bed


def test_one_device_at_two_addresses_is_locked(tmp_path: Path) -> None:
    serial = uuid4().hex
    code, bed = held(
        tmp_path,
        Identity("Rail", "drive", serial, "can0 node 5"),
        Identity("Rail", "drive", serial, "socket://192.0.2.1:3000 node 5"),
    )
    assert code == 6
    fault = bed.log().fault
    assert fault.startswith(f"Rail (drive, serial {serial}) is locked by run r (pid ")
    assert bed.log().life[-1].change.error["code"] == "HC-C04"
    assert bed.robot.moves == 0
    assert bed.run(procedure(Points(1))) == 0  # free again


@pytest.mark.parametrize(
    ("serial", "other", "simulated"),
    [("7-a", "7-b", False), ("0", "0", False), ("", "", False), ("7", "7", True)],
)
def test_devices_that_may_be_two_are_not(
    tmp_path: Path, serial: str, other: str, simulated: bool
) -> None:
    """A serial number of 0 is none; simulated devices share theirs."""
    unique = uuid4().hex
    first = Identity("Rail", unique, serial, "a", simulated=simulated)
    second = Identity("Rail", unique, other, "b", simulated=simulated)
    assert held(tmp_path, first, second)[0] == 0
