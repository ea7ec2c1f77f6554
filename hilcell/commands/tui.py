"""``tui``: open the screen."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from hilcell.commands.console import print_message
from hilcell.commands.signatures import Tui
from hilcell.errors import EXIT_INTERNAL, HilcellError
from hilcell.journal.runs_folder import command_on
from hilcell.language import of_environment, speaking
from hilcell.tui.keys import load_keys
from hilcell.tui.terminal import ASCII, UNICODE, has_colours, has_unicode, is_coerced


def tui(args: Tui) -> int:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise HilcellError(
            "tui: stdin and stdout must be a terminal; `hilcell watch` follows a run in a pipe"
        )
    keymap = load_keys(Path(args.keys) if args.keys else None)
    utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
    unicode = utf8 and has_unicode(os.environ, coerced=is_coerced()) and not args.ascii
    variables = textual_environment(args.colors, os.environ)
    os.environ.pop("NO_COLOR", None)
    os.environ.update(variables)
    from hilcell.tui.app import HilcellApp
    from hilcell.tui.screens.base import Options
    from hilcell.tui.themes import SIXTEEN

    options = Options(
        runs=args.runs,
        keymap=keymap,
        glyphs=UNICODE if unicode else ASCII,
        run=args.run,
        cell=args.cell,
        settings=tuple(f"{key}={value}" for key, value in args.settings),
        theme=args.theme,
        slow=args.slow,
    )
    sys.setswitchinterval(0.0005)  # longest wait of the thread that reads Esc for one that draws
    language = of_environment(os.environ)
    with speaking(language if unicode else language.in_ascii()):
        app = HilcellApp(options)
        if app.console.color_system == "standard":
            app.theme = SIXTEEN
        app.run()
    if app.refused is not None:
        raise app.refused
    if app.return_code:
        print_message(
            "hilcell: the screen failed by a defect of its own; please report it. A live run "
            "continues: `hilcell tui last` shows it"
        )
        return EXIT_INTERNAL
    for detached in app.detached:
        command = command_on(args.runs / detached, "tui")
        print_message(f"hilcell: detached; the run continues: `{command}` shows it")
    return 0


def textual_environment(colours: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that Textual reads when it is imported.

    NO_COLOR of ``environment`` must be removed: Textual obeys even an empty one.
    """
    if colours == "auto" and not has_colours(environment):
        colours = "none"
    system = {"16": "standard", "none": "truecolor"}.get(colours, colours)  # Textual's names
    variables = {"TEXTUAL_COLOR_SYSTEM": system, "TEXTUAL_ANIMATIONS": "none"}
    return variables | ({"NO_COLOR": "1"} if colours == "none" else {})
