"""Atomic writes of files: to a temporary file in the same folder, which is then renamed.

A rename would also replace a device, a pipe or a link. So links are followed, and everything but
regular files is opened and written to. So is an open file of this process, such as /dev/stdout,
which others may write to as well. A name with the suffix of another format is refused.
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
    ".csv", ".txt", ".xlsx", ".xls", ".ods", ".json", ".html", ".htm", ".pdf", ".dat",
    ".urdf", ".toml", ".sqlite", ".zip", ".xml", ".dcc", ".doc", ".docx", ".odt", ".rtf", ".md",
    ".xhtml", ".xlsm", ".xlsb", ".tsv", ".jsonl", ".png", ".jpg", ".jpeg", ".svg", ".db",
)  # fmt: skip
STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # of the disk, not the name


class NotWritten(HilcellError):
    """A file that cannot, or must not, be written."""

    code = "HC-J07"


class DiskFailed(NotWritten):
    """A file not written because the disk is full or failing."""

    exit_code = EXIT_STORAGE


class NotPrinted(HilcellError):
    """Output that cannot be written: the disk is full, or the pipe has no reader."""

    code = "HC-J14"
    exit_code = EXIT_STORAGE


def write_whole(path: Path, content: bytes, *, inputs: Iterable[Path] = ()) -> None:
    """Write one file; raises `NotWritten` as `write_together` does."""
    write_together({path: content}, inputs=inputs)


def is_known(suffix: str) -> bool:
    """Whether a suffix, in lower case, is that of a usual format, or of an installed program's."""
    from importlib.metadata import entry_points  # loads long, and most names are usual

    return suffix in KNOWN or suffix[1:] in entry_points(group="hilcell.programs").names


def check_output(
    path: Path, suffixes: tuple[str, ...], what: str, *, inputs: Iterable[Path] = ()
) -> None:
    """Raise `NotWritten` if a file cannot be written, or has the suffix of another format.

    ``what`` names the content, ``suffixes`` are its own, the usual one first. Names without a
    suffix, or with an unknown one, are accepted.
    """
    _mode(path, list(inputs))
    suffix = path.suffix.lower()
    if suffix not in suffixes and is_known(suffix):
        raise NotWritten(
            f"{path}: the suffix is {suffix}, but the content is {what}; name it "
            f"{path.with_suffix(suffixes[0]).name}"
        )


def write_together(contents: Mapping[Path, bytes], *, inputs: Iterable[Path] = ()) -> None:
    """Write files that belong together: all temporary files are complete before one is renamed.

    Existing files keep their mode. Raises `NotWritten`, and leaves all files unchanged, if one is
    a folder, cannot be written, or is one of ``inputs``, the files that were read.
    """
    read = list(inputs)
    modes = {path: _mode(path, read) for path in contents}
    ready: dict[Path, Path] = {}
    try:
        for path, mode in modes.items():
            if (mode is None or stat.S_ISREG(mode)) and _descriptor(path) is None:
                # a short name: fits wherever the file's own name does
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
    """Return the mode of the existing file, or None; raises `NotWritten`."""
    if str(path) == "-":
        raise NotWritten("expected a file name, got -; use /dev/stdout for standard output")
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
        raise NotWritten(f"{_name(path)}: output would overwrite an input; name another file")
    return found.st_mode


def _place(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _descriptor(path: Path) -> int | None:
    """Return the file descriptor that a name such as /dev/stdout stands for, or None."""
    own = os.path.realpath("/proc/self/fd")
    link = path.parent / path.readlink() if path.is_symlink() else path
    found = next((each for each in (path, link) if os.path.realpath(each.parent) == own), None)
    return int(found.name) if found is not None and found.name.isdecimal() else None


def is_stream(path: Path) -> bool:
    """Whether output is passed on: to a pipe, a device, an open file."""
    with as_not_written(path):
        return path.exists() and (not path.is_file() or _descriptor(path) is not None)


@contextmanager
def as_not_written(path: Path) -> Iterator[None]:
    """Raise `NotWritten` for a system error while writing, `NotPrinted` for a broken pipe."""
    try:
        yield
    except BrokenPipeError as error:
        raise NotPrinted(
            f"{_name(path)}: cannot be written: {error.strerror}; the output is incomplete; use a "
            "reader that reads to the end"
        ) from error
    except OSError as error:
        failed = DiskFailed if error.errno in STORAGE else NotWritten
        reason = error.strerror or str(error)
        raise failed(f"{_name(path)}: cannot be written: {reason}") from error


def _name(path: Path) -> str:
    return clean(str(path))
