"""The parser of the command line: short errors that name the nearest command or option."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import entry_points
from typing import Any, NoReturn

from hilcell.commands.output import print_message, stdout_checked

HELP = ("-h", "--help")  # no word is mistyped for it: each command has it
PASSWORD = re.compile(r"(://[^:/@\s]*:)\S*@")  # of a URL that stands where none is wanted
REFUSED = 2  # of `hilcell.run.exits`, which is heavy to import


class Parser(argparse.ArgumentParser):
    """Reads the words of one command; ``commands`` are those that may follow, if any may."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self.commands: argparse._SubParsersAction[Parser] | None = None
        self.groups: dict[str, tuple[str, ...]] = {}  # of commands by title, as the help lists them

    def add_commands(self, dest: str = "command") -> argparse._SubParsersAction[Parser]:
        """Return where commands are added; ``dest`` is the argument that takes the one chosen."""
        self.commands = self.add_subparsers(dest=dest, metavar="COMMAND", required=True)
        return self.commands

    def format_help(self) -> str:
        """Return the help, with the commands in their groups."""
        if self.commands is None or not self.groups:
            return super().format_help()
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        # argparse says nowhere else what it would list.
        listed = {each.dest: each for each in self.commands._choices_actions}  # noqa: SLF001
        for title, names in self.groups.items():
            formatter.start_section(title)
            formatter.add_arguments([listed[name] for name in names])
            formatter.end_section()
        formatter.start_section("options")
        formatter.add_arguments(each for each in self._actions if each is not self.commands)
        formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse unknown words first: argparse would name missing arguments in their place."""
        self._refuse_unknown(sys.argv[1:] if args is None else args)
        return super().parse_known_args(args, namespace)

    def _refuse_unknown(self, words: Sequence[str]) -> None:
        for word in words:
            name = word.partition("=")[0]
            if word == "--":
                return
            if self.commands is not None and not word.startswith("-"):
                self._refuse_unknown_command(word, self.commands.choices)
                return
            known = self._option_string_actions
            if name.startswith("--") and " " not in word and name not in known:
                self._refuse_early(name, words)
                self.error(f"{name[:80]} is no option{_nearest(name, known)}")

    def knows(self, option: str) -> bool:
        """Whether an option is one of this parser's own."""
        return option in self._option_string_actions

    def _refuse_early(self, name: str, words: Sequence[str]) -> None:
        """Refuse an option that stands before the command to which it belongs."""
        choices = self.commands.choices if self.commands is not None else {}
        command = next((word for word in words if word in choices), "")
        if command and choices[command].knows(name):
            self.error(f"{name} belongs after its command: `{self.prog} {command} .. {name}`")

    def _refuse_unknown_command(self, word: str, known: Iterable[str]) -> None:
        if word in known:
            return
        if word in entry_points(group="hilcell.procedures").names:
            self.error(f"{word} is a procedure; did you mean `{self.prog} run {word}`?")
        self.error(f"{word[:80]!r} is no command{_nearest(word, known)}")

    def error(self, message: str) -> NoReturn:
        """Print an error, and where the arguments are listed, and end with exit code 2."""
        words = PASSWORD.sub(r"\1***@", message)
        print_message(f"{self.prog}: {words}\n`{self.prog} --help` lists what there is")
        self.exit(REFUSED)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print the help, or an error; argparse takes no notice of a stdout that fails.

        Raises `NotPrinted`.
        """
        if file is not sys.stdout:
            super()._print_message(message, file)
            return
        with stdout_checked():
            sys.stdout.write(message)
            sys.stdout.flush()


def _nearest(word: str, known: Iterable[str]) -> str:
    """Return the end of a sentence that names the word that was meant; a beginning means it."""
    from hilcell.cell.settings import did_you_mean  # `--help` does without it

    known = list(known)
    begun = [each for each in known if each.startswith(word)]
    return did_you_mean(
        begun[0] if len(begun) == 1 else word, [each for each in known if each not in HELP or begun]
    )
