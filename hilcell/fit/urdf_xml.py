"""The joints of a URDF as written, with the places of their tags, so that origins can be replaced.

The file is untrusted: a document type is refused, and with it every entity, and expat does not
recurse. It stays bytes: whatever is not replaced is written back byte for byte, meshes, inertias,
comments and layout.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.parsers import expat

PARTS = ("origin", "parent", "child", "axis", "limit", "mimic")
TAG = re.compile(rb"""<[^"'>]*(?:"[^"]*"[^"'>]*|'[^']*'[^"'>]*)*>""")
SPACE = re.compile(rb"\s*")
LINE = 96  # columns of a comment


class NotUrdf(ValueError):
    """Bytes that are no URDF, or one that is not taken."""


@dataclass(slots=True)
class JointText:
    """A joint: attributes of its parts by name, each once; ``tag_end`` and ``origin`` are bytes."""

    name: str
    kind: str
    tag_end: int
    parts: dict[str, Mapping[str, str]] = field(default_factory=dict)
    origin: tuple[int, int] | None = None


@dataclass(slots=True)
class UrdfText:
    """The bytes of a URDF, the robot's name, where its tag ends, its links and joints."""

    content: bytes
    name: str = ""
    tag_end: int = 0
    links: list[str] = field(default_factory=list)
    joints: list[JointText] = field(default_factory=list)

    def with_origins(
        self, origins: Sequence[tuple[JointText, str]], comment: Sequence[str]
    ) -> bytes:
        """Return the file with other ``<origin>`` tags at joints, and a comment at its head."""
        edits = [(self.tag_end, self.tag_end, _comment(comment))]
        for joint, tag in origins:
            if joint.origin is not None:
                start, end = joint.origin
                closed = self.content[start:end].endswith(b"/>")
                edits.append((start, end, (tag + ("/>" if closed else ">")).encode()))
            else:
                at = joint.tag_end
                indent = _matched(SPACE, self.content, at)
                edits.append((at, at, self.content[at:indent] + f"{tag}/>".encode()))
        content = self.content
        for start, end, text in sorted(edits, reverse=True):
            content = content[:start] + text + content[end:]
        return content


def read_urdf_text(content: bytes) -> UrdfText:
    """Return what a file says; raises `NotUrdf`."""
    if b"\0" in content:
        raise NotUrdf("has NUL bytes: not XML, or saved as UTF-16; save it as UTF-8")
    reader = _Reader(content)
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse_doctype
    parser.StartElementHandler = lambda name, found: reader.start(
        name, found, parser.CurrentByteIndex
    )
    parser.EndElementHandler = reader.end
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise NotUrdf(f"is not XML: {error}") from error
    return reader.found


def _refuse_doctype(name: str, *rest: object) -> None:
    raise NotUrdf(
        f"has a document type, <!DOCTYPE {name}; a URDF needs none, and entities are refused"
    )


class _Reader:
    """Takes elements one by one; joints are those directly in the robot."""

    def __init__(self, content: bytes) -> None:
        self.found = UrdfText(content)
        self._depth = 0
        self._joint: JointText | None = None

    def start(self, name: str, attributes: dict[str, str], at: int) -> None:
        self._depth += 1
        if self._depth == 1:
            self._root(name, attributes, at)
        elif self._depth == 2:
            self._joint = None
            if name == "link":
                self.found.links.append(attributes.get("name", ""))
            elif name == "joint":
                self._joint = JointText(
                    attributes.get("name", ""), attributes.get("type", ""), self._end(at)
                )
                self.found.joints.append(self._joint)
        elif self._depth == 3 and self._joint is not None and name in PARTS:
            self._part(self._joint, name, attributes, at)

    def end(self, name: str) -> None:
        self._depth -= 1

    def _root(self, name: str, attributes: dict[str, str], at: int) -> None:
        if name != "robot":
            raise NotUrdf(f"is no URDF: its root is <{name}>, wanted <robot>")
        self.found.name, self.found.tag_end = attributes.get("name", ""), self._end(at)

    def _part(self, joint: JointText, name: str, attributes: dict[str, str], at: int) -> None:
        if name in joint.parts:
            raise NotUrdf(f"joint {joint.name} has <{name}> twice")
        joint.parts[name] = attributes
        if name == "origin":
            joint.origin = (at, self._end(at))

    def _end(self, at: int) -> int:
        return _matched(TAG, self.found.content, at)


def _matched(pattern: re.Pattern[bytes], content: bytes, at: int) -> int:
    """Return where a pattern ends that matches at a place."""
    match = pattern.match(content, at)
    return match.end() if match else at


def _comment(lines: Sequence[str]) -> bytes:
    """Return an XML comment, in which two hyphens must not follow each other."""
    text = "\n    ".join(re.sub("-(?=-)", "- ", line) for line in lines)
    return f"\n  <!-- {text} -->".encode("ascii", "replace")
