"""A real browser without a screen, with the fonts that matplotlib brings on any machine."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--hide-scrollbars", "--no-pdf-header-footer",
)  # fmt: skip
FONTS = """<?xml version="1.0"?><!DOCTYPE fontconfig SYSTEM "fonts.dtd">
<fontconfig><dir>{fonts}</dir><cachedir>{cache}</cachedir></fontconfig>"""


def found() -> str:
    """Return the browser of this machine; empty where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), "")


def use_fonts(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let browsers use these fonts alone; skip where there is no browser."""
    if not found():
        pytest.skip(f"no browser found ({', '.join(NAMES)}): install chromium")
    import matplotlib as mpl  # heavy, and every test session knows this module

    file, fonts = folder / "fonts.conf", Path(mpl.get_data_path()) / "fonts" / "ttf"
    file.write_text(FONTS.format(fonts=fonts, cache=folder / "fonts"))
    monkeypatch.setenv("FONTCONFIG_FILE", str(file))


# Runs before the page's policy is read, and so is not blocked by it. An image of an SVG has no
# `naturalWidth`: one of the page's own with the same address has, under the same policy.
_PROBE = """<script>
const blocked = [];
addEventListener("securitypolicyviolation",
                 (event) => blocked.push(`${event.effectiveDirective}: ${event.blockedURI}`));
addEventListener("load", async () => {
  const box = (each) => {
    const {left, top, width, height} = each.getBoundingClientRect();
    return [left, top, width, height];
  };
  const images = await Promise.all([...document.querySelectorAll("img, image")].map(
    async (each) => {
      const image = new Image();
      image.src = each.getAttribute("src") || each.getAttribute("href");
      await image.decode().catch(() => null);
      return {width: image.naturalWidth, box: box(each)};
    }));
  const drawings = [...document.querySelectorAll("figure svg")].map(box);
  const sheets = [...document.querySelectorAll(".sheet")].map(
    (each) => [box(each), box(each.querySelector("table"))]);
  const verdicts = [...document.querySelectorAll(".first .sheet td:last-child")].map(box);
  parent.postMessage({
    name: window.name, blocked, images, drawings, sheets, verdicts,
    width: document.documentElement.scrollWidth,
    first: document.querySelector(".first")?.offsetHeight ?? 0,
    signatures: document.querySelector(".signatures")?.offsetHeight ?? 0}, "*");
});
</script>"""
# The pages beside one another, each as on a screen of its own.
_SCREENS = """<!DOCTYPE html><html><head><style>body {{margin: 0; width: {across}px; display: flex}}
iframe {{border: 0; flex: none; height: {height}px}}</style><script>
const seen = [];
addEventListener("message", (event) => {{
  seen.push(event.data);
  document.documentElement.dataset.seen = JSON.stringify(seen);
}});
</script></head><body>{frames}</body></html>"""
_SCREEN = '<iframe name="{name}" src="{page}" style="width: {width}px"></iframe>'
HEIGHT_PX = 9000


@dataclass(frozen=True, eq=False)
class Seen:
    """A page as it was shown: what its policy blocked, its images, the boxes of its drawings.

    ``images`` have their ``width`` in pixels, 0 where they were not shown, and their ``box``;
    a box is left, top, width, height. ``sheets`` are those of each table's section and of the table
    in it, ``verdicts`` of the last cells of page 1. ``width`` is that of the page, which a printer
    shrinks to its paper, ``first`` the height of its first sheet, ``signatures`` that of the row to
    sign in. ``pixels`` are (rows, columns, 3), of 0 to 255, ``colours`` how many there are of each.
    """

    blocked: list[str]
    images: list[dict[str, Any]]
    drawings: list[list[float]]
    sheets: list[tuple[list[float], list[float]]]
    verdicts: list[list[float]]
    width: int
    first: int
    signatures: int
    pixels: NDArray[np.uint8]
    colours: dict[tuple[int, ...], int]

    def share(self, colour: tuple[int, ...]) -> float:
        """Return the share of pixels that have exactly a colour."""
        return self.colours.get(colour, 0) / sum(self.colours.values())

    def near(self, colour: tuple[int, ...], within: int) -> int:
        """Return how many pixels differ from a colour by less than that, in each part of it."""
        found, counts = np.array(list(self.colours)), np.array(list(self.colours.values()))
        return int(counts[np.all(np.abs(found - colour) < within, axis=1)].sum())

    def inked(self, box: list[float]) -> float:
        """Return the share of pixels in a box that are not white."""
        left, top, width, height = (round(side) for side in box)
        inside = self.pixels[top : top + height, left : left + width]
        return float(np.mean(np.any(inside < 250, axis=2)))


def looked_at(folder: Path, *pages: tuple[str, int]) -> list[Seen]:
    """Show pages on screens so wide; look at their boxes, and at the pixels of the first."""
    frames = list[str]()
    for number, (page, width) in enumerate(pages):
        probed = folder / f"probed-{number}.html"
        probed.write_text(page.replace("<head>", f"<head>{_PROBE}", 1), "utf-8")
        frames.append(_SCREEN.format(name=number, page=probed.as_uri(), width=width))
    screens, picture = folder / "screens.html", folder / "screen.png"
    across = sum(width for _, width in pages)
    screens.write_text(
        _SCREENS.format(across=across, height=HEIGHT_PX, frames="".join(frames)), "utf-8"
    )
    words = [
        f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=5000", "--dump-dom",
        f"--window-size={pages[0][1]},{HEIGHT_PX}", f"--screenshot={picture}",
    ]  # fmt: skip
    done = subprocess.run(
        [found(), *QUIET, *words, screens.as_uri()], capture_output=True, text=True, check=True
    )
    seen = re.search(r'data-seen="([^"]*)"', done.stdout)
    assert seen is not None, done.stdout[-2000:]
    boxes = {int(each.pop("name")): each for each in json.loads(html.unescape(seen[1]))}
    with Image.open(picture) as image:
        shown = image.convert("RGB")
    counted = shown.getcolors(shown.width * shown.height) or []
    colours = {colour: count for count, colour in counted if isinstance(colour, tuple)}
    none = np.zeros((0, 0, 3), np.uint8)
    first = Seen(**boxes[0], pixels=np.asarray(shown), colours=colours)
    others = (Seen(**boxes[n], pixels=none, colours={}) for n in range(1, len(pages)))
    return [first, *others]
