"""The words and symbols of a report: only those that it uses are explained."""

from __future__ import annotations

import re

WORDS = (
    ("3-D error", r"\b3-?D\b", "length from the place commanded to the place measured"),
    ("95 % bound", r"95 % bound",
     "length that the 3-D error of a corrected target keeps with 95 % probability"),
    ("u", r"\bu\b", "standard uncertainty, k = 1; of one coordinate, where nothing else is said"),
    ("U, k", r"\bU\b", "expanded uncertainty U = k u, about 95 %; k: coverage factor"),
    ("AP, RP", r"\bAP_p\b",
     "ISO 9283: mean position less the commanded one; radius that repeated arrivals keep"),
    ("AD, RD", r"\bAD_x\b", "accuracy and repeatability of a distance (ISO 9283)"),
    ("{W}", r"\{W\}", "world frame, of the floor nests"),
    ("{B}", r"\{B\}", "base frame of the robot"),
    ("A, B, C", r"\bA °", "angles about z, y and x, turned in this order"),
    ("Station", r"\bS\d+\b|\b[Ss]tations\b", "place of the robot on the rail, held by the strip"),
    ("Touch pose", r"[Tt]ouch pose", "pose measured to find where the slide came to rest"),
    ("SMR", r"\bSMR\b", "spherically mounted retroreflector, seen by the tracker"),
    ("RMS, rms", r"\b(rms|RMS)\b", "root mean square"),
    ("p95", r"\bp95\b", "95 % of the figures are below it"),
    ("IDW", r"\b(IDW|idw)\b", "error as the mean of the vertices' errors by inverse distance"),
)  # fmt: skip
WITHOUT_RAIL = {"Station": "place of the robot, on the floor"}


def words_of(html: str, has_rail: bool = True) -> list[tuple[str, str]]:
    """Return the words that stand in a page, with their meaning in such a cell."""
    text = re.sub(r"<[^>]*>", " ", html)
    own = {} if has_rail else WITHOUT_RAIL
    return [
        (name, own.get(name, meaning))
        for name, pattern, meaning in WORDS
        if re.search(pattern, text)
    ]
