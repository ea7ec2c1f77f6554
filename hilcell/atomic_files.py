"""Files appear whole or not at all: written beside their place, then renamed.

A rename replaces anything of that name, a device, a pipe or a link as well. So links are followed,
and all but regular files are opened and written to. So is an open file of this process, such as
/dev/stdout: it may be a regular file that others write as well. A name that ends like that of
another form is refused.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from hilcell.errors import EXIT_STORAGE, HilcellError
from hilcell.sanitize import clean

CSV = (".csv", ".txt")
KNOWN = (
    ".csv", ".txt", ".xlsx", ".xls", ".ods", ".json", ".html", ".htm", ".pdf", ".src", ".dat",
    ".urdf", ".toml", ".sqlite", ".zip", ".xml", ".dcc", ".doc", ".docx", ".odt", ".rtf", ".md",
    ".xhtml", ".xlsm", ".xlsb", ".tsv", ".jsonl", ".png", ".jpg", ".jpeg", ".svg", ".db",
    ".script",
)  # fmt: skip
STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # the disk's, not the name's


class NotWritten(HilcellError):
    """A file that cannot, or must not, be written."""

    code = "HC-J07"


class DiskFailed(NotWritten):
    """A file that a full or failing disk did not take."""

    exit_code = EXIT_STORAGE


class NotPrinted(HilcellError):
    """Data that stdout does not take: a full disk, or a pipe that nobody reads any more."""

    code = "HC-J14"
    exit_code = EXIT_STORAGE


def write_whole(path: Path, content: bytes, *, inputs: Iterable[Path] = ()) -> None:
    """Write one file; raises `NotWritten` as `write_together` does."""
    write_together({path: content}, inputs=inputs)


def check_output(
    path: Path, suffixes: tuple[str, ...], what: str, *, inputs: Iterable[Path] = ()
) -> None:
    """Raise `NotWritten` where a file cannot be written, or is named like one of another form.

    ``what`` is what is written, ``suffixes`` its own, the usual one first. Names without a suffix,
    or with one that no form has, are taken as they are.
    """
    _mode(path, list(inputs))
    suffix = path.suffix.lower()
    if suffix in KNOWN and suffix not in suffixes:
        raise NotWritten(
            f"{path} is a {suffix} file by its name, and {what} is written; name it "
            f"{path.with_suffix(suffixes[0]).name}"
        )


def write_together(contents: Mapping[Path, bytes], *, inputs: Iterable[Path] = ()) -> None:
    """Write files that belong together: all are ready beside their places before one is renamed.

    Existing files keep their mode. Raises `NotWritten`, and leaves all files as they were, where
    one is a folder, cannot be written, or is one of ``inputs``, the files that were read.
    """
    read = list(inputs)
    modes = {path: _mode(path, read) for path in contents}
    ready: dict[Path, Path] = {}
    try:
        for path, mode in modes.items():
            if (mode is None or stat.S_ISREG(mode)) and _descriptor(path) is None:
                # A short name of its own: it fits wherever the file's own name does.
                beside = _place(path).with_name(f".{secrets.token_hex(8)}.part")
                with as_not_written(path), beside.open("xb") as file:
                    ready[path] = beside
                    if mode is not None:
                        beside.chmod(stat.S_IMODE(mode))
                    file.write(contents[path])
        for path, content in contents.items():
            with as_not_written(path):
                if path in ready:
                    ready[path].replace(_place(path))
                else:
                    number = _descriptor(path)
                    opened = os.open(path, os.O_WRONLY) if number is None else os.dup(number)
                    with os.fdopen(opened, "wb") as file:
                        file.write(content)
    finally:
        for beside in ready.values():
            beside.unlink(missing_ok=True)


def _mode(path: Path, inputs: list[Path]) -> int | None:
    """Return the mode of the file that is there, or None; raises `NotWritten`."""
    if str(path) == "-":
        raise NotWritten("expected the name of a file, got -: /dev/stdout is that of the output")
    with as_not_written(path):
        try:
            found = path.stat()
        except FileNotFoundError:
            _place(path).parent.stat()
            return None
        if stat.S_ISDIR(found.st_mode):
            raise NotWritten(f"{_name(path)} is a folder; name a file")
        if not os.access(path, os.W_OK):
            raise PermissionError(0, "Permission denied")
    read = (each.stat() for each in inputs if each.exists())
    if stat.S_ISREG(found.st_mode) and any(os.path.samestat(found, each) for each in read):
        raise NotWritten(f"{_name(path)} is read by this command; write elsewhere")
    return found.st_mode


def _place(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _descriptor(path: Path) -> int | None:
    """Return the number of the open file of this process that a name such as /dev/stdout means."""
    own = os.path.realpath("/proc/self/fd")
    link = path.parent / path.readlink() if path.is_symlink() else path
    found = next((each for each in (path, link) if os.path.realpath(each.parent) == own), None)
    return int(found.name) if found is not None and found.name.isdecimal() else None


def is_stream(path: Path) -> bool:
    """Whether what is written goes on elsewhere: a pipe, a device, an open file."""
    with as_not_written(path):
        return path.exists() and (not path.is_file() or _descriptor(path) is not None)


@contextmanager
def as_not_written(path: Path) -> Iterator[None]:
    """Raise `NotWritten` for an error of the system while a file is written.

    A pipe that nobody reads any more is no fault of the name: `NotPrinted`.
    """
    try:
        yield
    except BrokenPipeError as error:
        raise NotPrinted(
            f"{_name(path)}: cannot be written: {error.strerror}; the output is not complete; give "
            "it to a program that reads it to its end"
        ) from error
    except OSError as error:
        failed = DiskFailed if error.errno in STORAGE else NotWritten
        reason = error.strerror or str(error)
        raise failed(f"{_name(path)}: cannot be written: {reason}") from error


def _name(path: Path) -> str:
    return clean(str(path))
