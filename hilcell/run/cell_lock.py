"""Locks of a cell: two runs never command the same devices.

Locks are those of the operating system (flock): they end with their process, however it dies.
Device locks are in one folder for all users of this machine; it belongs to root or to this user and
is sticky, so no user removes another's file. Another user may have put files there: no link is
followed, nothing is truncated, and only a regular file with a single name is written.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hilcell.errors import EXIT_LOCKED, HilcellError
from hilcell.journal.journal import StorageError

OVERRIDE = "HILCELL_LOCKS"  # names another folder, which all users of this machine must share
USUAL = Path("/run/lock/hilcell")
BEFORE_SET_UP = Path("/tmp/hilcell-locks")  # noqa: S108 - sticky; see the module docstring
SHARED_MODE = 0o1777  # sticky: every user may add files and remove only their own
HOLDER_BYTES = 256  # written in place: a file that is no lock loses no more than its beginning


class CellLocked(HilcellError):
    """Another run holds the cell."""

    code = "HC-C04"
    exit_code = EXIT_LOCKED


def lock_of_name(runs: Path, cell: str) -> Path:
    return runs / f".{cell}.lock"


def lock_of_device(known_by: str) -> Path:
    """Return the lock, on this machine, of a device known by its place or by its identity.

    Raises `StorageError` where no folder for it can be used.
    """
    return locks_folder()[0] / hashlib.sha256(known_by.encode()).hexdigest()


def locks_folder() -> tuple[Path, str]:
    """Return the folder of the device locks and a warning, "" for none; raises `StorageError`."""
    if override := os.environ.get(OVERRIDE):
        folder = Path(override)
        _make_for_all(folder)
        _check_trusted(folder, of_anybody=True)
        return folder, ""
    try:
        _make_for_all(USUAL)
    except StorageError as error:
        _make_for_all(BEFORE_SET_UP)
        _check_trusted(BEFORE_SET_UP)
        return BEFORE_SET_UP, (
            f"{error}; device locks are in {BEFORE_SET_UP} and do not exclude users of {USUAL}: "
            f"set it up with `{_set_up(USUAL)}`"
        )
    _check_trusted(USUAL)
    return USUAL, ""


def _make_for_all(folder: Path) -> None:
    with _storage_errors(folder, "locks"):
        before = os.umask(0)  # else another user could find it closed for a moment
        try:
            folder.mkdir(SHARED_MODE)
        except FileExistsError:
            found = folder.lstat()
            if not stat.S_ISDIR(found.st_mode):
                raise OSError(errno.ENOTDIR, "it is no folder, or a link") from None
            if not os.access(folder, os.W_OK | os.X_OK):
                raise OSError(errno.EACCES, os.strerror(errno.EACCES)) from None
        finally:
            os.umask(before)


def _check_trusted(folder: Path, *, of_anybody: bool = False) -> None:
    """Raise `StorageError` where another user could remove a lock in use."""
    found = folder.lstat()
    mode, problem = stat.S_IMODE(found.st_mode), ""
    if not of_anybody and found.st_uid not in (0, os.getuid()):
        problem = f"it belongs to user {found.st_uid}"
    elif mode & (stat.S_IWGRP | stat.S_IWOTH) and not mode & stat.S_ISVTX:
        problem = f"its mode is {mode:o}"
    if problem:
        raise StorageError(
            f"locks folder {folder} cannot be used: {problem}, so another user could remove a lock "
            f"in use; set it up with `{_set_up(folder)}`"
        )


def _set_up(folder: Path) -> str:
    return f"sudo install -d -o root -g root -m {SHARED_MODE:o} {folder}"


@contextmanager
def locked(path: Path, what: str, run: str) -> Iterator[None]:
    """Hold the lock at ``path``; raises `CellLocked` with its holder, and `StorageError`."""
    kind = "runs" if path.suffix == ".lock" else "locks"
    advice = "; name another with --runs DIR or HILCELL_RUNS" if kind == "runs" else ""
    with _storage_errors(path.parent, kind, advice):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        file = _held(path, what)
    try:
        with _storage_errors(path.parent, kind):
            words = f"run {run} (pid {os.getpid()})".encode(errors="replace")
            os.pwrite(file, words[:HOLDER_BYTES].ljust(HOLDER_BYTES), 0)
        yield
    finally:
        os.close(file)


def _held(path: Path, what: str) -> int:
    """Open and lock the file at a path; a file that was removed meanwhile is opened again."""
    while True:
        file = _opened(path)
        try:
            _take(file, what)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), path.lstat()):
                    return file
        except BaseException:  # nothing leaves the file open
            os.close(file)
            raise
        os.close(file)


def _take(file: int, what: str) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(file, HOLDER_BYTES, 0).decode(errors="replace").strip()
        raise CellLocked(
            f"{what} is locked by {holder or 'another run'}; wait for its end or `hilcell stop` it"
        ) from None


def _opened(path: Path) -> int:
    """Open a lock file; create it only where there is none (sticky folders); raises `OSError`."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    while True:
        try:
            file = os.open(path, flags)
            break
        except FileNotFoundError:
            try:
                file = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
            except FileExistsError:
                continue  # another run was quicker
            os.fchmod(file, 0o666)  # whatever the umask: others lock it, too
            break
    found = os.fstat(file)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink != 1:
        os.close(file)
        raise OSError(
            errno.EINVAL,
            f"{path.name}: expected a regular file with one hard link",
        )
    return file


@contextmanager
def _storage_errors(folder: Path, kind: str, advice: str = "") -> Iterator[None]:
    """Raise `StorageError` where a folder cannot be used."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"{kind} folder {folder} cannot be used: {error.strerror}{advice}"
        ) from error
