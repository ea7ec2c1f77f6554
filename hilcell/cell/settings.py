"""Strict reading of settings: all problems at once, each with its path and the nearest key.

TOML and msgspec accept NaN and infinity, and msgspec stops at the first problem; so each field is
converted separately and every float must be finite.
"""

from __future__ import annotations

import difflib
import errno
import inspect
import math
import re
import stat
import tomllib
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from hilcell.decoding import Json, typed
from hilcell.errors import HilcellError, indented
from hilcell.sanitize import clean, counted

LONGEST_VALUE = 80
_KINDS = {
    "float": "a number", "int": "a whole number", "int | float": "a number", "str": "a text",
    "bool": "true or false", "array": "a list", "object": "a table",
}  # fmt: skip
_EXPECTED = re.compile(
    rf"Expected `({'|'.join(map(re.escape, _KINDS))})(?: \| null)?`(?!.* - at `)"
)
MOST_BYTES = 16_000_000  # of a file that is read at once

T = TypeVar("T", bound=msgspec.Struct)
S = TypeVar("S")


class Unread(AttributeError):
    """A field that could not be read: only the checks that need it are skipped.

    An unknown name is a defect of the check, and remains an AttributeError.
    """


def is_read(table: S, field: Callable[[S], object]) -> bool:
    try:
        field(table)
    except Unread:
        return False
    return True


class SettingsError(HilcellError):
    """Invalid settings; ``problems`` has all of them, the message a limited number."""

    code = "HC-C11"

    def __init__(self, source: str, problems: list[str]) -> None:
        self.source, self.problems = source, problems
        most = 40  # a cell file has fewer, a list of holes in wrong units a thousand
        lines = indented(problems, most=most)
        super().__init__(f"{source}: {counted(len(problems), 'problem')}\n{lines}")


def read_text(path: Path) -> str:
    """Return a file's text; raises `OSError`, `UnicodeDecodeError`.

    Refuses devices and FIFOs, which may never end, and files that are too large for settings.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    if status.st_size > MOST_BYTES:
        raise OSError(errno.EFBIG, f"it has {status.st_size} bytes, expected at most {MOST_BYTES}")
    return path.read_text("utf-8-sig")  # Windows editors write a byte order mark


def read_bytes(path: Path) -> bytes:
    """Return the content of a file or pipe; raises `OSError` above `MOST_BYTES`."""
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"it has more than {MOST_BYTES} bytes")
    return content


def read_file(path: Path) -> bytes:
    """Return as `read_bytes`; raises `SettingsError`."""
    try:
        return read_bytes(path)
    except OSError as error:
        raise unreadable(str(path), error) from error


def unreadable(source: str, error: Exception, kind: str = "file") -> SettingsError:
    """Return the error for a file that cannot be read; ``kind`` was expected."""
    match error:
        case IsADirectoryError():
            problem = f"is a folder, not a {kind}"
        case UnicodeDecodeError():
            problem = "is not UTF-8 text; save it as UTF-8"
        case OSError():
            problem = f"cannot be read: {error.strerror}"
        case _:
            problem = f"cannot be read: {error}"
    return SettingsError(source, [problem])


def convert(
    values: Mapping[str, object],
    kind: type[T],
    source: str,
    also: Callable[[T], Iterable[str]] = lambda _: (),
) -> T:
    """Build ``kind`` from plain values; raises `SettingsError` with all problems.

    ``also`` yields further problems; fields of its argument that were not read raise `Unread`.
    """
    problems: list[str] = []
    try:
        built = _struct(values, kind, "", problems)
        problems += also(built)
    except RecursionError:
        raise SettingsError(source, ["nested too deeply"]) from None
    if problems:
        raise SettingsError(source, problems)
    return typing.cast("T", built)


def check_values(values: Mapping[str, object], kind: type[msgspec.Struct], source: str) -> None:
    """Check those values whose keys ``kind`` has, whatever is missing; raises `SettingsError`."""
    problems: list[str] = []
    for key, field in _fields(kind).items():
        if key in values:
            _value(values[key], field.type, key, problems)
    if problems:
        raise SettingsError(source, problems)


def refuse(problems: Iterable[str]) -> None:
    """Refuse a table in its ``__post_init__`` for several reasons."""
    if lines := list(problems):
        raise ValueError("\n".join(lines))


def _struct(values: object, kind: type[msgspec.Struct], path: str, problems: list[str]) -> Any:
    place = path.rstrip(".") or "file"
    fields = _fields(kind)
    if not isinstance(values, Mapping):
        problems.append(f"{place}: expected a table, got {_short(values)}")
        return _PartialTable(kind, {field.name: msgspec.NODEFAULT for field in fields.values()})
    for key in [key for key in values if key not in fields]:
        hint = did_you_mean(key, fields) or f"; known here: {', '.join(sorted(fields))}"
        problems.append(f"{clean(f'{path}{key}')}: unknown key{hint}")
    built: dict[str, object] = {}
    before = len(problems)
    for key, field in fields.items():
        if key in values:
            built[field.name] = _value(values[key], field.type, f"{path}{key}", problems)
        elif field.required:
            problems.append(f"{path}{key}: missing")
    refused: list[str] = []
    if len(problems) == before:
        try:
            return kind(**built)
        except ValueError as error:
            refused = str(error).splitlines()
    partial = _PartialTable(kind, built)
    for line in refused or _refused(partial):
        key = re.match(r"(\w+)[\w.\[\]]*:", line)  # of a table's own check
        known = key is not None and key[1] in fields
        problems.append(f"{path}{line}" if known else f"{place}: {line}")
    return partial


class _PartialTable:
    """Replaces an invalid table in the checks of the tables around it.

    It has the properties, methods and constants of its kind; fields that could not be read
    (`msgspec.NODEFAULT`) raise `Unread`.
    """

    def __init__(self, kind: type[msgspec.Struct], built: Mapping[str, object]) -> None:
        self._kind = kind
        for field in _fields(kind).values():
            makes = field.default_factory
            default = field.default if makes is msgspec.NODEFAULT else makes()
            if (value := built.get(field.name, default)) is not msgspec.NODEFAULT:
                setattr(self, field.name, value)

    def __getattr__(self, name: str) -> Any:
        if name in self._kind.__struct_fields__:
            raise Unread(name)
        found = inspect.getattr_static(self._kind, name)
        return found.__get__(self, self._kind) if hasattr(found, "__get__") else found


def _refused(table: _PartialTable) -> list[str]:
    """Return the problems of a table's own checks, without those that need an unread field."""
    own = getattr(table, "__post_init__", None)
    checks = table.checks() if hasattr(table, "checks") else [own] if own else []
    problems: list[str] = []
    for check in checks:
        try:
            problems += check() or ()
        except Unread:
            continue
        except ValueError as error:
            problems += str(error).splitlines()
    return problems


@cache
def _fields(kind: type[msgspec.Struct]) -> Mapping[str, msgspec.structs.FieldInfo]:
    """Return a table's fields by key; cached, for annotations are evaluated."""
    fields = msgspec.structs.fields(kind)
    return {
        field.encode_name: msgspec.structs.replace(field, type=_without_text(field.type))
        for field in fields
    }


def _without_text(kind: Any) -> Any:
    """Return a type without the texts among its annotations, which are for people."""
    if typing.get_origin(kind) is not typing.Annotated:
        return kind
    bare, *more = typing.get_args(kind)
    kept = [each for each in more if not isinstance(each, str)]
    return typing.Annotated[bare, *kept] if kept else bare


def _short(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits
        text = "a huge number"
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def near_misses(word: str, known: Iterable[str], most: int = 1) -> list[str]:
    """Return the known words that resemble this one, the most similar first."""
    one_slip = 0.75  # share of common characters in words of five
    plain = {each.lstrip("-"): each for each in known}  # all options begin with dashes
    matcher = difflib.SequenceMatcher(b=word[:LONGEST_VALUE].lstrip("-"))
    alike = {}
    for each in sorted(plain):
        matcher.set_seq1(each)
        alike[plain[each]] = matcher.ratio(), matcher.find_longest_match().size
    likely = sorted(alike, key=alike.__getitem__, reverse=True)
    return [each for each in likely if alike[each][0] >= one_slip][:most]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message that suggests the nearest known word, or ""."""
    near = near_misses(word, known)
    return f'; did you mean "{near[0]}"?' if near else ""


def _value(value: object, kind: object, path: str, problems: list[str]) -> object:
    inner = _inner_struct(kind)
    if inner is not None and value is not None:
        table = _struct(value, inner, f"{path}.", problems)
        return table if isinstance(value, Mapping) else msgspec.NODEFAULT
    is_list = typing.get_origin(kind) is list
    item = _inner_struct(typing.get_args(kind)[0]) if is_list else None
    if item is not None and isinstance(value, list):
        return [_struct(each, item, f"{path}[{n}].", problems) for n, each in enumerate(value)]
    if bad := list(_not_finite(value, path)):
        problems += bad
        return msgspec.NODEFAULT
    try:
        return typed(value, kind)
    except msgspec.ValidationError as error:
        member = re.search(r" - at `\$\[(\d+)\]`$", str(error))
        if member and isinstance(value, list) and typing.get_origin(_without_none(kind)) is list:
            n, (inner,) = int(member[1]), typing.get_args(_without_none(kind))
            return _value(value[n], inner, f"{path}[{n}]", problems)
        allowed = range_text(kind)
        hint = f"; allowed: {allowed}" if allowed else ""
        metas = getattr(kind, "__metadata__", ())
        words = next((meta.description for meta in metas if meta.description), "")
        if isinstance(value, str) and words:
            problem, hint = f"expected {words}", ""
        elif expected := _EXPECTED.match(str(error)):
            problem = f"expected {_KINDS[expected[1]]}"
        elif str(error).startswith("Invalid enum value"):  # msgspec repeats the value
            problem = "expected a known word"
        else:
            problem = str(error)
        problems.append(f"{path}: {problem}, got {_short(value)}{hint}")
        return msgspec.NODEFAULT


def range_text(kind: object) -> str:
    """Return the bounds of a number or of a tuple's members, or the allowed words, or ""."""
    kind = _without_none(kind)
    if typing.get_origin(kind) is typing.Literal:
        return ", ".join(f'"{word}"' for word in typing.get_args(kind))
    if typing.get_origin(kind) is tuple:
        kind = typing.get_args(kind)[0]
    bounds: list[str] = []
    for meta in getattr(kind, "__metadata__", ()):
        limits = ((">", meta.gt), (">=", meta.ge), ("<", meta.lt), ("<=", meta.le))
        bounds += [f"{sign} {limit:g}" for sign, limit in limits if limit is not None]
    return ", ".join(bounds)


def _without_none(kind: object) -> object:
    """Return the type of an optional value without None."""
    options = [each for each in typing.get_args(kind) if each is not types.NoneType]
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return options[0] if union and len(options) == 1 else kind


def _inner_struct(kind: object) -> type[msgspec.Struct] | None:
    kind = _without_none(kind)
    return kind if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else None


def _not_finite(value: object, path: str) -> Iterator[str]:
    """Yield the members of a value that are not finite, with their paths."""
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{path}: {value} is not a finite number"
    elif isinstance(value, list):
        for n, each in enumerate(value):
            yield from _not_finite(each, f"{path}[{n}]")
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _not_finite(each, f"{path}.{key}")


def override_all(values: Json, changed: Mapping[str, str]) -> None:
    """Set each ``a.b.c`` to a TOML value, or to the bare text if it is not one.

    Options of a replaced driver are removed.
    """
    for name in exchanged_drivers(values, changed):
        values[name].pop("options")
    for key in sorted(changed, key=lambda key: not key.endswith(".driver")):
        text = changed[key]
        if "\n" in text:  # it could set other keys
            raise SettingsError("--set", [f"{key}: expected a value on one line, got {text!r}"])
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except RecursionError:
            raise SettingsError("--set", [f"{key}: nested too deeply"]) from None
        except ValueError:
            value = text
        *path, last = key.split(".")
        table: Json = values
        for part in path:
            table = table.setdefault(part, {})
            if not isinstance(table, dict):
                raise SettingsError("--set", [f"{key}: {part} is not a table"])
        table[last] = value


def exchanged_drivers(values: Json, changed: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the old and the new driver of each table whose driver is replaced."""
    drivers = {}
    for key in changed:
        name, _, last = key.rpartition(".")
        table = values.get(name)
        if last == "driver" and isinstance(table, dict) and "options" in table:
            then, now = str(table.get("driver")), changed[key].strip("\"' ")
            if then != now:
                drivers[name] = then, now
    return drivers
