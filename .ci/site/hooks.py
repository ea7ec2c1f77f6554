"""What the site has beside the pages of docs/: tutorials made of their scripts, drawn diagrams.

Links out of docs/, to files that the site does not have, become the paths of these files.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

from mermaidx import render
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

ROOT = Path(__file__).parents[2]
WORKER = Path(__file__).with_name("worker.js")
SHIM = "https://unpkg.com/iframe-worker/shim"
CONTRIBUTING = "contributing.md"
OUTSIDE = {"../CONTRIBUTING.md": CONTRIBUTING, "../README.md": "README.md"}
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#:]+)(#[^)]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    fence = {"name": "mermaid", "class": "mermaid", "format": _drawn}
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [fence]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add CONTRIBUTING.md, and a page for each script of docs/tutorials."""
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8").replace("](docs/", "](")
    files.append(File.generated(config, CONTRIBUTING, content=text))
    for script in sorted((ROOT / "docs/tutorials").glob("*.py")):
        page = f"tutorials/{script.stem}.md"
        files.append(File.generated(config, page, content=page_of(script)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to scripts to their pages, and state the path of a file that the site lacks."""

    def led(match: re.Match[str]) -> str:
        words, link, anchor = match[1], match[2], match[3] or ""
        here = dirname(page.file.src_uri)
        there = normpath(join(here, link))
        there = OUTSIDE.get(there, there)
        if there.startswith("tutorials/"):
            there = there.removesuffix(".py") + ".md" if there.endswith(".py") else there
        if there in files.src_uris:
            return f"[{words}]({relpath(there, here or '.')}{anchor})"
        path = normpath(join("docs", there))
        if page.file.src_uri == CONTRIBUTING and not (ROOT / path).exists():
            path = there  # its links are relative to the folder above
        if not (ROOT / path).exists():
            return match[0]  # of which mkdocs warns
        return f"{words} (`{path}`)"

    return LINK.sub(led, markdown)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Take the script by which a page opened as a file can be searched from the site itself."""
    return output.replace(SHIM, get_relative_url(f"assets/{WORKER.name}", page.url))


@event_priority(-100)  # the search's index is written by then
def on_post_build(config: MkDocsConfig) -> None:
    """Refuse a page for which a browser would load something from elsewhere."""
    site = Path(config.site_dir)
    (site / "assets" / WORKER.name).write_bytes(WORKER.read_bytes())
    (site / "404.html").unlink()  # of a web server
    loads = re.compile(
        r"""<(?:script|img|iframe|source|video|object|embed)\b[^>]*?(?:src|data)=["']?(?:https?:)?//"""
        r"""|<link\b(?=[^>]*rel=["']?(?:stylesheet|icon|preconnect|preload|dns-prefetch))"""
        r"""[^>]*?href=["']?(?:https?:)?//|(?:@import|url\()\s*["']?(?:https?:)?//"""
    )
    found = [
        f"{path.relative_to(site)}: {match[0][-60:]}"
        for path in sorted(site.rglob("*"))
        if path.suffix in (".html", ".css", ".svg")
        for match in loads.finditer(path.read_text("utf-8"))
    ]
    if found:
        raise PluginError("loaded from elsewhere:\n" + "\n".join(found))


def page_of(script: Path) -> str:
    """Return a script in cells (``# %%``) as a page, with what it prints."""
    text = script.read_text("utf-8")
    docstring = ast.get_docstring(ast.parse(text)) or ""
    title, _, words = docstring.partition("\n")
    parts = [f"# {title.rstrip('.')}", words.strip("\n")]
    for cell in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        kind, _, body = cell.partition("\n")
        if "[markdown]" in kind:
            parts.append(re.sub(r"^# ?", "", body.strip(), flags=re.MULTILINE))
        else:
            parts.append(f"```python\n{body.strip()}\n```")
    done = subprocess.run(  # noqa: S603 - a script of this project
        [sys.executable, script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return "\n\n".join([*parts, "## Output", f"```text\n{done.stdout.rstrip()}\n```"]) + "\n"


def _drawn(source: str, *_: object, **__: object) -> str:
    """Return a diagram as SVG, so that a page needs no script from elsewhere."""
    return f'<div class="diagram">{render(source).svg()}</div>'
