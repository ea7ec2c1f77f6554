"""Themes: a colour-blind safe default, a light one, and one of the highest contrast.

Good is blue and bad is orange-red (Okabe and Ito's palette), never green against red. Each tone
has the colour that is read on it; a test holds every pair to a contrast of 4.5 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from textual.theme import Theme

TONES = ("good", "warn", "bad", "info", "quiet", "sim")


@dataclass(frozen=True, slots=True)
class Palette:
    """One theme's colours. A tone is read on the background; ``on`` is read on every tone."""

    name: str
    dark: bool
    background: str
    text: str
    dim: str
    cursor: str
    on: str
    good: str
    warn: str
    bad: str
    info: str
    quiet: str
    sim: str

    def theme(self) -> Theme:
        """Return the palette as Textual's theme, with ``$good`` and ``$on-good`` for each tone."""
        variables = {tone: getattr(self, tone) for tone in TONES}
        variables |= {f"on-{tone}": self.on for tone in TONES}
        variables |= {
            "dim": self.dim,
            "cursor-row": self.cursor,
            "footer-background": self.background,
            "input-selection-background": self.cursor,
            "block-cursor-blurred-background": self.quiet,  # the chosen line of the palette
            "block-cursor-blurred-foreground": self.on,
        }
        return Theme(
            name=self.name, dark=self.dark, primary=self.info, secondary=self.quiet,
            warning=self.warn, error=self.bad, success=self.good, accent=self.info,
            foreground=self.text, background=self.background, surface=self.background,
            panel=self.cursor, variables=variables,
        )  # fmt: skip


PALETTES = (
    Palette(
        name="calm", dark=True, background="#10161c", text="#e6e6e6", dim="#9aa7b2",
        cursor="#26394a", on="#0b0f13", good="#56b4e9", warn="#f0c000", bad="#ff8a4c",
        info="#9fc5e8", quiet="#b0b8c0", sim="#e28fd0",
    ),
    Palette(
        name="daylight", dark=False, background="#fafafa", text="#1a1a1a", dim="#555f69",
        cursor="#d6e4f0", on="#ffffff", good="#005a8f", warn="#7c6400", bad="#7a0000",
        info="#2d5f8a", quiet="#4a5560", sim="#8a2a78",
    ),
    Palette(
        name="contrast", dark=True, background="#000000", text="#ffffff", dim="#d0d0d0",
        cursor="#003a70", on="#000000", good="#7fd4ff", warn="#ffe600", bad="#ff9e66",
        info="#ffffff", quiet="#d0d0d0", sim="#ff9cf0",
    ),
)  # fmt: skip
NAMES = tuple(palette.name for palette in PALETTES)
