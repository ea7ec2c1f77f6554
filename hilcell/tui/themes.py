"""Themes: the colours of the design by their role, dark and light, each also of high contrast.

Passed is green-blue and fault is orange-red, apart in lightness for colour-blind eyes. A role has
an ink, read on ground and panel, and a fill with the letters on it: ``$ask``, ``$ask-fill``,
``$on-ask``. Where a terminal has 16 colours, one theme is made of those alone. A test holds every
pair to its contrast.
"""

from __future__ import annotations

from dataclasses import dataclass

from textual.theme import Theme

ROLES = ("live", "passed", "ask", "fault", "label", "sim")
SIXTEEN = "sixteen"


@dataclass(frozen=True, slots=True)
class Palette:
    """One theme's colours by role; a fill that is not named is the ink, with ground on it.

    ``badge`` is the ground of badges and keys, ``track`` that of a bar where it is still empty.
    """

    name: str
    dark: bool
    ground: str
    panel: str
    badge: str
    track: str
    cursor: str
    text: str
    label: str
    stale: str
    live: str
    passed: str
    ask: str
    fault: str
    sim: str
    sim_fill: str
    on_sim: str
    ask_fill: str = ""
    on_ask: str = ""

    def ink(self, role: str) -> str:
        colour: str = getattr(self, role)
        return colour

    def fill(self, role: str) -> str:
        return getattr(self, f"{role}_fill", "") or self.ink(role)

    def on(self, role: str) -> str:
        return getattr(self, f"on_{role}", "") or self.ground

    def theme(self) -> Theme:
        variables = {role: self.ink(role) for role in ROLES}
        variables |= {f"{role}-fill": self.fill(role) for role in ROLES}
        variables |= {f"on-{role}": self.on(role) for role in ROLES}
        variables |= {
            "stale": self.stale,
            "sim-edge": self.sim_fill if self.dark else self.sim,
            "badge": self.badge,
            "track": self.track,
            "cursor-row": self.cursor,
            "footer-background": self.panel,
            "input-selection-background": self.cursor,
            "block-cursor-blurred-background": self.label,  # the chosen line of the palette
            "block-cursor-blurred-foreground": self.ground,
        }
        return Theme(
            name=self.name, dark=self.dark, primary=self.live, secondary=self.label,
            warning=self.ask, error=self.fault, success=self.passed, accent=self.live,
            foreground=self.text, background=self.ground, surface=self.ground,
            panel=self.panel, variables=variables,
        )  # fmt: skip


PALETTES = (
    Palette(
        name="calm", dark=True, ground="#0e1419", panel="#18222b", badge="#2c3a46",
        track="#2a3640", cursor="#22384a", text="#e8ecef", label="#a3b0bb", stale="#82909c",
        live="#56b4e9", passed="#5ce0b4", ask="#f2c500", fault="#ff8652",
        sim="#e78fd6", sim_fill="#b8328f", on_sim="#ffffff",
    ),
    Palette(
        name="daylight", dark=False, ground="#fafaf7", panel="#eef1f3", badge="#dfe4e8",
        track="#d3d9de", cursor="#d3e4f1", text="#12181d", label="#4a5660", stale="#5e6973",
        live="#0068a8", passed="#004f38", ask="#755900", fault="#b03a00",
        sim="#8b2a7b", sim_fill="#f07fd3", on_sim="#12181d", ask_fill="#f2c500", on_ask="#12181d",
    ),
    Palette(
        name="contrast", dark=True, ground="#000000", panel="#16191d", badge="#2b3035",
        track="#3a4046", cursor="#003a70", text="#ffffff", label="#d6dbe0", stale="#a7aeb5",
        live="#6cc4ff", passed="#7cffd4", ask="#ffe000", fault="#ffa274",
        sim="#ff9eef", sim_fill="#c2309a", on_sim="#ffffff",
    ),
    Palette(
        name="contrast-light", dark=False, ground="#ffffff", panel="#eceff2", badge="#e3e6e9",
        track="#c9cfd4", cursor="#fff3b0", text="#000000", label="#262b30", stale="#4a4f54",
        live="#004a8f", passed="#00432e", ask="#5a4300", fault="#8a2300",
        sim="#6e1463", sim_fill="#ff8fe0", on_sim="#000000", ask_fill="#ffcc00", on_ask="#000000",
    ),
)  # fmt: skip
NAMES = tuple(palette.name for palette in PALETTES)
# The colours as Rich has them, so that it finds each by itself: bright black is grey.
SIXTEEN_COLOURS = Palette(
    name=SIXTEEN, dark=True, ground="#000000", panel="#000000", badge="#0000aa", track="#555555",
    cursor="#0000aa", text="#ffffff", label="#aaaaaa", stale="#aaaaaa", live="#55ffff",
    passed="#55ff55", ask="#ffff55", fault="#ff5555", sim="#ff55ff", sim_fill="#ff55ff",
    on_sim="#000000",
)  # fmt: skip
