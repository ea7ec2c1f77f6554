"""The words of a benchmark's command: ``--help`` prints what it does, and starts nothing."""

from __future__ import annotations

import argparse


def parser(text: str | None) -> argparse.ArgumentParser:
    """Return a parser that takes no words yet; ``text`` is the benchmark's docstring."""
    form = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(description=text, formatter_class=form, allow_abbrev=False)
