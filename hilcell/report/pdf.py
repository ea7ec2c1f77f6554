"""A page printed as PDF by a browser of this machine, which has no part of its own in hilcell."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from hilcell.atomic_files import NotWritten


def find_browser() -> str:
    """Return the browser that prints; raises `NotWritten` where there is none."""
    browsers = (
        "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge",
    )  # fmt: skip
    browser = next((path for path in map(shutil.which, browsers) if path), "")
    if not browser:
        raise NotWritten(
            "report: no browser to print a PDF with, expected one of "
            f"{', '.join(browsers)}; install chromium, or write FILE.html, open it in any browser "
            "and print it to a file"
        )
    return browser


def pdf_of(html: str, browser: str) -> bytes:
    """Return a page as PDF; raises `NotWritten` where the browser does not print it in time."""
    with TemporaryDirectory(prefix="hilcell-", ignore_cleanup_errors=True) as folder:
        page, paper = Path(folder, "report.html"), Path(folder, "report.pdf")
        page.write_text(html, "utf-8")
        output = _print(browser, page, paper, Path(folder, "profile"))
        content = paper.read_bytes() if paper.exists() else b""
    if not content.startswith(b"%PDF-"):
        raise NotWritten(
            f"report: {browser} printed no PDF: {output.strip()[-300:] or 'it said nothing'}; "
            "write FILE.html and print it in a browser"
        )
    return content


def _print(browser: str, page: Path, paper: Path, profile: Path) -> str:
    """Run the browser and end every process of it; return what it said."""
    sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()  # it refuses root without
    quiet = (
        "--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking",
        "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
        "--no-pdf-header-footer",
    )  # fmt: skip
    command = [
        browser, *quiet, *sandbox, f"--user-data-dir={profile}", f"--print-to-pdf={paper}",
        page.as_uri(),
    ]  # fmt: skip
    process = subprocess.Popen(  # noqa: S603 - a browser found by its name, no words of others
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )
    limit_s = 60.0
    try:
        output, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return f"not within {limit_s:g} s"
    return output.decode(errors="replace")


def pages_of(pdf: bytes, names: Iterable[str]) -> dict[str, int]:
    """Return on which page, from 1, each element begins that has one of these ids and is linked to.

    The browser writes pages in their order, each as an object, and a table of linked ids.
    """
    page = re.compile(rb"(\d+) 0 obj\s*<<\s*/Type\s*/Page\b")
    pages = page.findall(pdf)
    linked = rb"/%s\s*\[\s*(\d+) 0 R"
    targets = {name: re.search(linked % re.escape(name.encode()), pdf) for name in names}
    return {
        name: pages.index(target[1]) + 1
        for name, target in targets.items()
        if target is not None and target[1] in pages
    }
