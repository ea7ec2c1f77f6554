"""URDF files: read a serial arm, and write the file with another arm.

URDF has metres and radians, the rest of the program mm, but for values of prismatic joints. A
joint's frame in a `Chain` includes the fixed joints before it, which keep their origins when a
chain is written.

``T = O_1 Rot(axis_1, q_1) ... O_n Rot(axis_n, q_n) tip``, of a prismatic joint a shift in place of
Rot: every chain is exactly an `Arm` between base and tool frame. Row i carries axis i into axis
i + 1 (the last into the tip's z), by standard DH with beta = 0, or by Hayati's form near parallel
axes, where the common normal runs off to infinity.
A chain is not unique: `Chain.beside` puts frames near the nominal ones.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Self
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from hilcell.cell.settings import SettingsError, read_bytes, unreadable
from hilcell.compensation.targets import numbers
from hilcell.fit.robot_file import MOST_JOINTS, Robot, coupled, read_dh
from hilcell.geometry.frames import cross_matrix, inverse, matrix, pose_from_zyx, zyx_from_pose
from hilcell.geometry.kinematics import MM, Arm, Array, link_transforms
from hilcell.geometry.statistics import lengths_mm
from hilcell.sanitize import clean

# The file is untrusted: a document type is refused, and with it every entity, and expat does not
# recurse. It stays bytes: whatever is not replaced is written back byte for byte, meshes,
# inertias, comments and layout.


class NotUrdf(ValueError):
    """Bytes that are no URDF, or one that is not taken."""


@dataclass(slots=True)
class JointText:
    """A joint: attributes of its elements by name, each once; ``tag_end`` and ``origin``
    are bytes.
    """

    name: str
    kind: str
    tag_end: int
    parts: dict[str, Mapping[str, str]] = field(default_factory=dict)
    origin: tuple[int, int] | None = None

    def end(self, part: str) -> str:
        """Link of "parent" or "child"; raises `NotUrdf`."""
        link = self.parts.get(part, {}).get("link", "")
        if not link:
            raise NotUrdf(f"joint {self.name or '(without a name)'} states no {part} link")
        return link

    def numbered(self, problems: list[str]) -> tuple[Array, Array, tuple[float, float]]:
        """Origin (4, 4) in mm, unit axis (3,) and limits in rad or m."""
        least_axis = 1e-6
        most_rotation_rad = (
            2.0 * np.pi + 0.01
        )  # of one roll, pitch or yaw; beyond, angles are degrees
        try:
            origin = self.parts.get("origin", {})
            other = sorted(set(origin) - {"xyz", "rpy"})
            if other:
                raise ValueError(f"origin: expected xyz and rpy only, got {', '.join(other)}")
            xyz_m = _vector(origin, "origin", "xyz", (0.0, 0.0, 0.0))
            rpy_rad = _vector(origin, "origin", "rpy", (0.0, 0.0, 0.0))
            if not np.abs(rpy_rad).max() <= most_rotation_rad:
                raise ValueError(
                    f"origin rpy {origin['rpy']!r} is more than 2 pi: expected radians"
                )
            R = pose_from_zyx(0.0, 0.0, 0.0, *np.degrees(rpy_rad[::-1]))[:3, :3]
            step = matrix(R, xyz_m * MM)
            if self.kind not in MOVING:
                return step, np.zeros(3), (-np.inf, np.inf)
            axis = _vector(self.parts.get("axis", {}), "axis", "xyz", (1.0, 0.0, 0.0))
            if not np.linalg.norm(axis) > least_axis:
                raise ValueError("axis has no direction")
            return step, axis / np.linalg.norm(axis), self._limits()
        except ValueError as error:
            problems.append(f"joint {self.name}: {error}")
            return np.eye(4), np.zeros(3), (-np.inf, np.inf)

    def _limits(self) -> tuple[float, float]:
        found = self.parts.get("limit", {})
        if self.kind == "continuous" or not {"lower", "upper"} <= set(found):
            return -np.inf, np.inf
        lower, upper = numbers(["limit lower", "limit upper"], [found["lower"], found["upper"]])
        if not lower < upper:
            raise ValueError(f"limit lower {lower:g} is not below upper {upper:g}")
        return lower, upper


class UrdfText:
    """The bytes of a URDF, the robot's name, the end of its tag, and its joints; raises
    `NotUrdf`.
    """

    SPACE = re.compile(rb"\s*")
    TAG = re.compile(rb"""<[^"'>]*(?:"[^"]*"[^"'>]*|'[^']*'[^"'>]*)*>""")

    def __init__(self, content: bytes) -> None:
        if b"\0" in content:
            raise NotUrdf("has NUL bytes: not XML, or saved as UTF-16; save it as UTF-8")
        self.content, self.name, self.tag_end = content, "", 0
        self.joints = list[JointText]()
        self._open = list[str]()  # the elements around, the outermost first
        self._parser = expat.ParserCreate()
        self._parser.StartDoctypeDeclHandler = self._refuse_doctype
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = lambda _: self._open.pop()
        try:
            self._parser.Parse(content, True)
        except NotUrdf:
            raise
        except expat.ExpatError as error:
            raise NotUrdf(f"is not XML: {error}") from error
        except (ValueError, LookupError) as error:  # of an encoding that expat does not have
            raise NotUrdf(f"cannot be read: {error}; save it as UTF-8") from error

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._open.append(name)
        at = self._parser.CurrentByteIndex
        tag = at, self._end(self.TAG, at)
        match self._open:
            case ["robot"]:
                self.name, self.tag_end = attributes.get("name", ""), tag[1]
            case [_]:
                raise NotUrdf(f"is no URDF: its root is <{name}>, expected <robot>")
            case [_, "joint"]:
                words = attributes.get("name", ""), attributes.get("type", "")
                self.joints.append(JointText(*words, tag[1]))
            case [_, "joint", "origin" | "parent" | "child" | "axis" | "limit" | "mimic"]:
                joint = self.joints[-1]
                if name in joint.parts:
                    raise NotUrdf(f"joint {joint.name} has <{name}> twice")
                joint.parts[name] = attributes
                joint.origin = tag if name == "origin" else joint.origin

    @staticmethod
    def _refuse_doctype(name: str, *rest: object) -> None:
        raise NotUrdf(f"has a document type, <!DOCTYPE {name}; entities are refused")

    def _end(self, pattern: re.Pattern[bytes], at: int) -> int:
        match = pattern.match(self.content, at)
        return match.end() if match else at

    def with_origins(
        self, origins: Sequence[tuple[JointText, str]], comment: Sequence[str]
    ) -> bytes:
        """The file with other ``<origin>`` tags at joints, and a comment at its head."""
        edits = [(self.tag_end, self.tag_end, _comment(comment))]
        for joint, tag in origins:
            if joint.origin is not None:
                start, end = joint.origin
                closed = self.content[start:end].endswith(b"/>")
                edits.append((start, end, (tag + ("/>" if closed else ">")).encode()))
            else:
                at = joint.tag_end
                indent = self._end(self.SPACE, at)
                edits.append((at, at, self.content[at:indent] + f"{tag}/>".encode()))
        content = self.content
        for start, end, text in sorted(edits, reverse=True):
            content = content[:start] + text + content[end:]
        return content

    def chain_to(self, tip: str, base: str = "") -> list[JointText]:
        """The joints from ``base``, or the root, to ``tip``, or of the only chain of six revolute
        joints, or else of 1 to 9 joints; raises `NotUrdf`.
        """
        parents, links = ({joint.end(end) for joint in self.joints} for end in ("parent", "child"))
        links |= parents
        for link in filter(None, (tip, base)):
            if link not in links:
                raise NotUrdf(f"no joint leads to link {link}; links: {_list(sorted(links))}")
        tips = [tip] if tip else sorted(set(self._above) - parents)
        if not tips:
            loop = "its links form a loop: no link is a tip"
            raise NotUrdf(loop if self.joints else "has no joint")
        chains = {tip: self._joints_to(tip) for tip in tips}
        if base:
            chains = {tip: _behind(joints, base) for tip, joints in chains.items()}
            chains = {tip: joints for tip, joints in chains.items() if joints}
            if not chains:
                raise NotUrdf(f"no joint leads from link {base} to {tip or 'a tip'}")
        good = [tip for tip in chains if not self._unfit(chains[tip])]
        six = [tip for tip in good if self._six_revolute(chains[tip])]
        for only in (six, good):
            if len(only) == 1:
                return chains[only[0]]
        if good:
            several = f"several chains of {MOST_JOINTS} joints or fewer end in {_list(good)}"
            raise NotUrdf(f"{several}: say which, --tip LINK")
        longest = max(chains, key=lambda tip: len(chains[tip]))
        others = f"; tips: {_list(tips)}; where an earlier link ends the arm, --tip LINK names it"
        unfit = self._unfit(chains[longest])
        raise NotUrdf(f"the chain to {longest} {unfit}{'' if tip else others}")

    def _joints_to(self, tip: str) -> list[JointText]:
        joints, link, above = list[JointText](), tip, self._above
        while link in above:
            if len(joints) > len(above):
                raise NotUrdf(f"its links form a loop through {link}")
            joints.append(above[link])
            link = above[link].end("parent")
        return joints[::-1]

    @staticmethod
    def _six_revolute(joints: list[JointText]) -> bool:
        kinds = [joint.kind for joint in joints if joint.kind != "fixed"]
        return len(kinds) == 6 and PRISMATIC not in kinds

    @staticmethod
    def _unfit(joints: list[JointText]) -> str:
        """Why joints are no serial arm, or ""."""
        moving = [joint for joint in joints if joint.kind != "fixed"]
        strange = [f"{joint.name} ({joint.kind})" for joint in moving if joint.kind not in MOVING]
        mimics = [joint.name for joint in moving if "mimic" in joint.parts]
        if strange:
            return f"has joints not revolute, prismatic or fixed: {_list(strange)}"
        if mimics:
            return f"has joints that follow others (mimic): {_list(mimics)}"
        if not 1 <= len(moving) <= MOST_JOINTS:
            names = _list([joint.name for joint in moving]) or "none"
            return f"has {len(moving)} moving joints, expected 1 to {MOST_JOINTS}: {names}"
        return ""

    @cached_property
    def _above(self) -> dict[str, JointText]:
        most_joints = 1000  # of one file
        if len(self.joints) > most_joints:
            raise NotUrdf(f"has {len(self.joints)} joints, expected at most {most_joints}")
        above: dict[str, JointText] = {}
        for joint in self.joints:
            child = joint.end("child")
            if child in above:
                raise NotUrdf(
                    f"link {child} has two parents: joints {above[child].name}, {joint.name}"
                )
            above[child] = joint
        return above


def _behind(joints: list[JointText], base: str) -> list[JointText]:
    """Return the joints behind a link, none where it is not among their parents."""
    first = next((n for n, each in enumerate(joints) if each.end("parent") == base), len(joints))
    return joints[first:]


def _comment(lines: Sequence[str]) -> bytes:
    """XML comment; two hyphens must not follow each other."""
    text = "\n    ".join(re.sub("-(?=-)", "- ", line) for line in lines)
    return f"\n  <!-- {text} -->".encode("ascii", "replace")


URDF = ".urdf"
UNLIMITED = np.array([[-np.inf], [np.inf], [np.inf]])
WIDEST = '<limit lower="-100" upper="100" effort="0" velocity="0"/>'
LEAST_REACH_M, MOST_REACH_M = 0.05, 50.0  # of all links in a row; beyond, lengths are not metres
REVOLUTE = ("revolute", "continuous")
PRISMATIC = "prismatic"
MOVING = (*REVOLUTE, PRISMATIC)


@dataclass(frozen=True, eq=False, kw_only=True)
class Urdf(Robot):
    """A robot in a URDF: the chain from ``root`` to ``tip``, the link of the targets."""

    root: str
    tip: str
    chain: Chain
    text: UrdfText = field(repr=False)
    joints: Sequence[JointText] = field(repr=False)  # from root to tip, fixed ones too
    steps: Array = field(repr=False)  # their origins (J, 4, 4), mm

    def left_at_tip(self, chain: Chain) -> Array:
        """Frame (4, 4) of a chain's tip in the tip link of the file that receives it. The identity,
        unless the tip is the last joint's own link: no joint is left to carry a tip.
        """
        return np.eye(4) if self._fixed_at_tip else chain.tip

    def with_chain(self, chain: Chain, comment: Sequence[str]) -> bytes:
        """The file with the origins of a chain of its axes, see `Chain.beside`."""
        origins, done = [], np.eye(4)
        origin = iter(chain.origins)
        for joint, step in zip(self.joints, self.steps, strict=True):
            if joint.kind in MOVING:
                origins.append((joint, _origin_tag(inverse(done) @ next(origin))))
                done = np.eye(4)
            else:
                done = done @ step
        if self._fixed_at_tip:
            first = self.steps[-self._fixed_at_tip]
            rest = inverse(first) @ done
            origins.append(
                (self.joints[-self._fixed_at_tip], _origin_tag(chain.tip @ inverse(rest)))
            )
        return self.text.with_origins(origins, comment)

    @property
    def _fixed_at_tip(self) -> int:
        last = max(n for n, joint in enumerate(self.joints) if joint.kind in MOVING)
        return len(self.joints) - 1 - last


def read_robot(path: Path | str, tip: str = "", base: str = "", coupling: float = 0.0) -> Robot:
    """Read a robot's nominal kinematics from a URDF or a ``robot.toml``, by the file's suffix.

    ``tip`` names the link that ends the arm, where a URDF has several, ``base`` the one that the
    arm stands on, where that is not the root; ``coupling`` as in `Robot.from_dh`, which a
    ``robot.toml`` has itself. Raises `SettingsError` with all problems of the file.

    Examples:
        >>> robot = read_robot("irb120.toml")
        >>> robot.name, robot.arm.a_mm.tolist()
        ('IRB 120', [0.0, 270.0, 70.0, 0.0, 0.0, 0.0])
    """
    file = Path(path)
    if file.suffix.lower() == URDF:
        robot = read_urdf(file, tip, base)
        try:
            return replace(robot, arm=coupled(robot.arm, coupling))
        except ValueError as error:
            raise SettingsError(str(file), [str(error)]) from error
    for word, value in (("tip", tip), ("base", base), ("coupling", coupling)):
        if value:
            problem = f"--{word} {value} is of a URDF; expected a {URDF} file"
            raise SettingsError(str(file), [problem])
    return read_dh(file)


def read_urdf(path: Path, tip: str = "", base: str = "") -> Urdf:
    """Read a chain, see `UrdfText.chain_to`; raises `SettingsError`."""
    try:
        text = UrdfText(read_bytes(path))
        joints = text.chain_to(tip, base)
    except OSError as error:
        raise unreadable(str(path), error) from error
    except NotUrdf as error:
        raise SettingsError(str(path), [str(error)]) from error
    problems: list[str] = []
    numbered = [joint.numbered(problems) for joint in joints]
    if problems:
        raise SettingsError(str(path), problems)
    steps = np.array([step for step, _, _ in numbered])
    moving = [n for n, joint in enumerate(joints) if joint.kind in MOVING]
    shifting = tuple(row for row, n in enumerate(moving) if joints[n].kind == PRISMATIC)
    axes = np.array([numbered[n][1] for n in moving])
    chain = Chain.of_joints(steps, moving, axes, shifting)
    reach_m = float(lengths_mm(np.vstack([chain.origins[1:, :3, 3], chain.tip[:3, 3]])).sum()) / MM
    least_m = LEAST_REACH_M if len(moving) > 2 and not shifting else 0.0
    if not least_m <= reach_m <= MOST_REACH_M:
        problem = (
            f"the links behind joint 1 are {reach_m:.4g} m long together, expected "
            f"{least_m:g} to {MOST_REACH_M:g} m: lengths in a URDF are metres"
        )
        raise SettingsError(str(path), [problem])
    root, arm = chain.arm()
    return Urdf(
        clean(text.name),
        replace(arm, tool=np.eye(4)),
        root,
        arm.tool,
        np.array([numbered[n][2] for n in moving]).T,
        root=joints[0].end("parent"),
        tip=joints[-1].end("child"),
        chain=chain,
        text=text,
        joints=joints,
        steps=steps,
    )


def _list(names: Sequence[str]) -> str:
    most_named = 8  # links that one message names
    more = f" and {len(names) - most_named} more" if len(names) > most_named else ""
    return ", ".join(names[:most_named]) + more


def _vector(
    found: Mapping[str, str], part: str, name: str, default: tuple[float, float, float]
) -> Array:
    if name not in found:
        return np.array(default)
    if "${" in found[name]:
        raise ValueError(f"{part} {name} has macros of xacro: expand the file first")
    cells = found[name].split()
    if len(cells) != 3:
        raise ValueError(f"{part} {name} has {len(cells)} numbers, expected three")
    return np.array(numbers([f"{part} {name}"] * 3, cells))


def _origin_tag(step: Array) -> str:
    """``<origin xyz="..." rpy="..."`` of a frame (4, 4) in mm, without its end."""
    angles_rad = np.radians(zyx_from_pose(step)[:2:-1])
    return f'<origin xyz="{_row(step[:3, 3] / MM)}" rpy="{_row(angles_rad)}"'


def _row(values: Array) -> str:
    return " ".join(f"{value:z.12f}".rstrip("0").rstrip(".") for value in values)


def urdf_of(name: str, chain: Chain, comment: Sequence[str], limits: Array = UNLIMITED) -> bytes:
    """URDF of a chain: links base_link, link_1 .. link_n, tool0; no shapes.

    ``limits`` (3, n) or (3, 1) are lower, upper, both rad, and speed, rad/s. A joint that turns and
    lacks one is continuous; one that shifts has the widest, since it must have some. The efforts,
    which URDF requires beside them, are not known: 0.
    """
    count = len(chain.axes)
    links = ["base_link", *(f"link_{n}" for n in range(1, count + 1)), "tool0"]
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(clean(name))}>"]
    lines += [f'  <link name="{link}"/>' for link in links]
    steps, most = [*chain.origins, chain.tip], np.broadcast_to(limits, (3, count))
    for number, step in enumerate(steps):
        moves, shifts = number < count, number in chain.prismatic
        kind = PRISMATIC if shifts else "continuous" if moves else "fixed"
        limit = [f"    {WIDEST}"] if shifts else []
        if moves and not shifts and np.isfinite(most[:, number]).all():
            lower, upper, speed = (f"{value:.9g}" for value in most[:, number])
            kind = "revolute"
            limit = [f'    <limit lower="{lower}" upper="{upper}" effort="0" velocity="{speed}"/>']
        joint = f"joint_{number + 1}" if moves else "tool0_joint"
        lines += [
            f'  <joint name="{joint}" type="{kind}">',
            f"    {_origin_tag(step)}/>",
            f'    <parent link="{links[number]}"/>',
            f'    <child link="{links[number + 1]}"/>',
            *([f'    <axis xyz="{_row(chain.axes[number])}"/>'] if moves else []),
            *limit,
            "  </joint>",
        ]
    content = "\n".join([*lines, "</robot>", ""]).encode()
    return UrdfText(content).with_origins([], comment)


NEARLY_PARALLEL = 0.1  # sine of the angle between axes: below it Hayati's form is used
Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Chain:
    """Origins (n, 4, 4) in mm, unit axes (n, 3), the tip's frame (4, 4) in the last link, and which
    joints, from 0, are prismatic.
    """

    origins: Array
    axes: Array
    tip: Array
    prismatic: tuple[int, ...] = ()

    @property
    def frames(self) -> Array:
        """Frames of joints and tip in the root link at q = 0, (n + 1, 4, 4)."""
        frames = [self.origins[0]]
        for step in (*self.origins[1:], self.tip):
            frames.append(frames[-1] @ step)
        return np.array(frames)

    @classmethod
    def of_joints(
        cls, steps: Array, moving: list[int], axes: Array, prismatic: tuple[int, ...]
    ) -> Self:
        """Chain of the origins (J, 4, 4) of all joints, the ``moving`` ones not fixed."""
        frames, done = [], np.eye(4)
        for number, step in enumerate(steps):
            done = done @ step
            if number in moving:
                frames.append(done)
                done = np.eye(4)
        return cls(np.array(frames), axes, done, prismatic)

    @classmethod
    def of(cls, base: Array, arm: Arm) -> Self:
        """Chain that moves as ``base @ forward(arm, q)``; its axes are z or -z."""
        links = link_transforms(arm, np.zeros(len(arm)))
        axes = np.zeros((len(arm), 3))
        axes[:, 2] = arm.sign
        origins = np.concatenate([base[None], links[:-1]])
        return cls(origins, axes, links[-1] @ arm.tool, arm.prismatic)

    def arm(self) -> tuple[Array, Arm]:
        """Base (4, 4) and arm: ``base @ forward(arm, q)`` is the chain's tip in its root."""
        frames = self.frames
        along = np.vstack([self.axes, Z])
        base = frame = frames[0] @ matrix(_turn(Z, self.axes[0]), np.zeros(3))
        rows = np.zeros((len(self.axes), 5))
        for row in range(len(rows)):
            seen = inverse(frame) @ frames[row + 1]
            rows[row] = _dh_row(seen[:3, 3], seen[:3, :3] @ along[row + 1])
            links = link_transforms(_arm(rows, np.eye(4), ()), np.zeros(len(rows)))
            frame = frame @ links[row]
        return base, _arm(rows, inverse(frame) @ frames[-1], self.prismatic)

    def beside(self, nominal: Chain) -> Chain:
        """Chain of the same motion with axes and frames near those of ``nominal``.

        Each frame is the nominal one, rotated by the least angle that makes the axes parallel, and
        shifted by the least distance that puts its origin onto the axis; a prismatic joint shifts
        alike from any origin.
        """
        found, near = self.frames, nominal.frames
        frames = found.copy()
        for joint in range(len(self.axes)):
            axis = found[joint, :3, :3] @ self.axes[joint]
            R = near[joint, :3, :3]
            on_axis, origin = found[joint, :3, 3], near[joint, :3, 3]
            if joint not in self.prismatic:
                origin = on_axis + np.dot(origin - on_axis, axis) * axis
            frames[joint] = matrix(_turn(R @ nominal.axes[joint], axis) @ R, origin)
        steps = inverse(frames[:-1]) @ frames[1:]
        origins = np.concatenate([frames[:1], steps[:-1]])
        return Chain(origins, nominal.axes, steps[-1], nominal.prismatic)


def _arm(rows: Array, tool: Array, prismatic: tuple[int, ...]) -> Arm:
    offset, d, a, alpha, beta = rows.T
    return Arm(a, alpha, d, offset, np.ones(len(rows)), tool, beta, prismatic=prismatic)


def _dh_row(point_mm: Array, along: Array) -> tuple[float, float, float, float, float]:
    """Theta, d, a, alpha, beta of the row that carries the z axis into a line. The line: a point
    (3,) and a unit direction (3,), in the row's frame.
    """
    no_length_mm = 1e-10  # rounding, whose direction means nothing
    if not np.hypot(along[0], along[1]) > NEARLY_PARALLEL:
        a = float(np.hypot(point_mm[0], point_mm[1]))
        a = a if a > no_length_mm else 0.0
        theta = float(np.arctan2(point_mm[1], point_mm[0])) if a else 0.0
        x, y, z = _seen_along(theta, along)
        beta = float(np.arctan2(x, np.hypot(y, z)))
        return theta, float(point_mm[2]), a, float(np.arctan2(-y, z)), beta
    normal = np.array([-along[1], along[0], 0.0]) / np.hypot(along[0], along[1])
    a = float(normal @ point_mm)
    a = a if abs(a) > no_length_mm else 0.0
    # No row has a negative length, nor, without length, an angle over 90 deg.
    aback = normal[0] < -no_length_mm or (normal[0] < no_length_mm and normal[1] < 0.0)
    if a < 0.0 or (a == 0.0 and aback):
        normal, a = -normal, abs(a)
    theta = float(np.arctan2(normal[1], normal[0]))
    _, y, z = _seen_along(theta, along)
    _, aside, height = _seen_along(theta, point_mm)
    return theta, height - aside / y * z, a, float(np.arctan2(-y, z)), 0.0


def _seen_along(theta: float, vector: Array) -> tuple[float, float, float]:
    """A vector (3,) in a frame rotated about z by ``theta``."""
    c, s = np.cos(theta), np.sin(theta)
    x, y, z = vector
    return float(c * x + s * y), float(c * y - s * x), float(z)


def _turn(start: Array, end: Array) -> Array:
    """The smallest rotation (3, 3) from one unit vector (3,) to another, up to 90 deg."""
    cosine = float(start @ end)
    if cosine < 0.0:
        aside = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        aside /= np.linalg.norm(aside)
        return _turn(-start, end) @ (2.0 * np.outer(aside, aside) - np.eye(3))
    K = cross_matrix(np.cross(start, end))
    return np.eye(3) + K + K @ K / (1.0 + cosine)
