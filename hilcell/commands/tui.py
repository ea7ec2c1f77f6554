"""``tui``: the technician's screen."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from hilcell.errors import HilcellError
from hilcell.telling import tell
from hilcell.tui.glyphs import ASCII, UNICODE
from hilcell.tui.keys import load_keys

COLOURS = {"auto": "auto", "none": "auto", "16": "standard", "256": "256", "truecolor": "truecolor"}


SWITCH_S = 0.0005  # the thread that reads Esc waits this long, at most, for one that draws


def tui(args: argparse.Namespace) -> int:
    """Show the technician's screen until it is left; raises what keeps it from opening."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise HilcellError(
            "tui: stdin and stdout must be a terminal; `hilcell watch` follows a run in a pipe"
        )
    keymap = load_keys(Path(args.keys) if args.keys else None)
    # Textual reads these when it is imported.
    os.environ["TEXTUAL_COLOR_SYSTEM"] = COLOURS[args.colors]
    os.environ["TEXTUAL_ANIMATIONS"] = "none"
    if args.colors == "none":
        os.environ["NO_COLOR"] = "1"
    from hilcell.tui.app import HilcellApp
    from hilcell.tui.desk import Options

    options = Options(
        runs=args.runs,
        keymap=keymap,
        glyphs=ASCII if args.ascii or not _utf8() else UNICODE,
        run=args.run,
        cell=args.cell,
        settings=tuple(f"{key}={value}" for key, value in args.set),
        theme=args.theme,
        slow=args.slow,
    )
    sys.setswitchinterval(SWITCH_S)
    app = HilcellApp(options)
    app.run()
    if app.refused is not None:
        raise app.refused
    if app.return_code:
        from hilcell.exits import EXIT_INTERNAL

        tell(
            "hilcell: the screen ended by a defect of its own; please report it. A live run is"
            " not stopped by that: `hilcell tui last` shows it again"
        )
        return EXIT_INTERNAL
    runs = "" if args.runs == Path("runs") else f" --runs {args.runs}"
    for detached in app.detached:
        again = f"hilcell tui {detached}{runs}"
        tell(f"hilcell: detached; the run goes on: `{again}` shows it again")
    return 0


def _utf8() -> bool:
    return (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
