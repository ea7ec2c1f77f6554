"""A real browser without a screen: what the page looks like, on screen and on paper."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import signal
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
LIMIT_S = 60.0


def found() -> str:
    """Return the browser of this machine; empty where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), "")


def browser() -> str:
    """Return the browser; a report that nobody has looked at in one is not tested."""
    return found() or pytest.skip(
        f"no browser found ({', '.join(NAMES)}): install chromium, "
        "on Debian and Ubuntu `apt-get install chromium`"
    )


def browse(page: Path, *words: str) -> str:
    """Open a page, do what ``words`` say, and end with every process that was started.

    Returns what the browser printed.
    """
    profile = page.with_name("profile")
    command = [browser(), *QUIET, f"--user-data-dir={profile}", *words, page.as_uri()]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    try:
        output, _ = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, _ = process.communicate()
        raise AssertionError(f"the browser did not end within {LIMIT_S} s:\n{output}") from None
    assert process.returncode == 0, output
    return output


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
  const words = [...document.querySelectorAll("svg.drawn")].map((each) => ({
    drawing: each.getAttribute("aria-label"), box: box(each),
    words: [...each.querySelectorAll('text:not([fill="none"])')].map(
      (text) => [text.textContent, box(text)])}));
  const sheets = [...document.querySelectorAll(".sheet")].map(
    (each) => [box(each), box(each.querySelector("table"))]);
  const verdicts = [...document.querySelectorAll(".first .sheet td:last-child")].map(box);
  document.documentElement.dataset.seen = JSON.stringify({
    blocked, images, drawings, words, sheets, verdicts, width: document.documentElement.scrollWidth,
    first: document.querySelector(".first")?.offsetHeight ?? 0,
    signatures: document.querySelector(".signatures")?.offsetHeight ?? 0});
});
</script>"""


@dataclass(frozen=True, eq=False)
class Seen:
    """A page as it was shown: what its policy blocked, its images, the boxes of its drawings.

    ``images`` have their ``width`` in pixels, 0 where they were not shown, and their ``box``;
    a box is left, top, width, height. ``sheets`` are those of each table's section and of the table
    in it, ``words`` those of each drawing and of the words in it, ``verdicts`` of the last cells of
    page 1. ``width`` is that of the page, which a printer shrinks to its paper, ``first`` the
    height of its first sheet, ``signatures`` that of the row to sign in. ``pixels`` are (rows,
    columns, 3), of 0 to 255.
    """

    blocked: list[str]
    images: list[dict[str, Any]]
    drawings: list[list[float]]
    words: list[dict[str, Any]]
    sheets: list[tuple[list[float], list[float]]]
    verdicts: list[list[float]]
    width: int
    first: int
    signatures: int
    pixels: NDArray[np.int16]

    def inked(self, box: list[float]) -> float:
        """Return the share of pixels in a box that are not white."""
        left, top, width, height = (round(side) for side in box)
        inside = self.pixels[top : top + height, left : left + width]
        return float(np.mean(np.any(inside < 250, axis=2)))


def looked_at(
    page: Path, folder: Path, size: tuple[int, int] = (900, 3000), pixels: bool = True
) -> Seen:
    """Show a page on a screen of a size, and look at it; without ``pixels`` at its boxes only."""
    probed, picture = folder / "probed.html", folder / "screen.png"
    probed.write_text(page.read_text("utf-8").replace("<head>", f"<head>{_PROBE}", 1), "utf-8")
    window = f"--window-size={size[0]},{size[1]}"
    shot = [f"--screenshot={picture}"] if pixels else []
    dumped = browse(probed, window, "--virtual-time-budget=5000", "--dump-dom", *shot)
    found = re.search(r'data-seen="([^"]*)"', dumped)
    assert found is not None, dumped[-2000:]
    boxes = json.loads(html.unescape(found[1]))
    if not pixels:
        return Seen(**boxes, pixels=np.zeros((0, 0, 3), np.int16))
    with Image.open(picture) as image:
        return Seen(**boxes, pixels=np.asarray(image.convert("RGB")).astype(np.int16))
