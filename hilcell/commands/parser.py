"""From a signature to its parser: short errors that name the nearest command or option."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Any,
    Literal,
    NoReturn,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from hilcell.arguments import MISSING, Argument, Signature, fields_of, is_signature
from hilcell.commands.console import print_message, stdout_checked
from hilcell.errors import EXIT_REFUSED

if TYPE_CHECKING:
    from hilcell.decoding import Json

HELP = ("-h", "--help")  # no word is mistyped for it: each command has it
Taken = TypeVar("Taken", bound=Signature)


class Parser(argparse.ArgumentParser):
    """Reads the words of one command, by the signature ``takes``, or those of its ``commands``."""

    def __init__(self, *, takes: type[Signature] | None = None, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self.takes = takes
        self.commands: argparse._SubParsersAction[Parser] | None = None
        self.groups: Mapping[str, Iterable[str]] = {}  # of commands by title, as the help lists

    def add_commands(self) -> argparse._SubParsersAction[Parser]:
        self.commands = self.add_subparsers(metavar="COMMAND", required=True)
        return self.commands

    def knows(self, option: str) -> bool:
        """Whether an option is one of this parser's own."""
        self.fill()
        return option in self._option_string_actions

    def fill(self) -> Parser:
        """Return it with its arguments, which are added late: a process reads one command."""
        takes, self.takes = self.takes, None
        if takes is not None:
            for each in fields_of(takes):
                self._add_field(each)
        return self

    def _add_field(self, field: Argument) -> None:
        name, kind = field.name, field.kind
        if field.switches:
            group = self.add_mutually_exclusive_group(required=True)
            for word, text in field.switches.items():
                group.add_argument(
                    f"--{word}", dest=name, action="store_const", const=word, help=text
                )
            return
        options: Json = {"help": field.help.replace("%", "%%")}
        if field.default is not MISSING:
            options["default"] = field.default
        if kind is bool:
            options["action"] = "store_true"
        elif get_origin(kind) is Literal:
            options["choices"] = get_args(kind)
        else:
            options |= {"metavar": field.metavar, "type": field.read}
        if get_origin(kind) is tuple:
            options |= {"action": "append", "default": []}
        if field.word:
            self.add_argument(name, nargs=None if field.needed else "?", **options)
        else:
            self.add_argument(*field.names, dest=name, required=field.needed, **options)

    def format_help(self) -> str:
        """Return the help, with the commands in their groups."""
        if self.commands is None or not self.groups:
            return super().format_help()
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        actions = self.commands._choices_actions  # noqa: SLF001 - argparse lists them nowhere else
        listed = {each.dest: each for each in actions}
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
        self.fill()
        self._refuse_unknown(sys.argv[1:] if args is None else args)
        taken, rest = super().parse_known_args(args, namespace)
        if rest:
            kind = "unknown option" if rest[0].startswith("-") else "unexpected argument"
            self.error(f"{kind} {rest[0][:80]}")
        return taken, rest

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
                self.error(f"unknown option {name[:80]}{self._nearest(name, known)}")

    def _refuse_early(self, name: str, words: Sequence[str]) -> None:
        """Refuse an option that stands before the command to which it belongs."""
        choices = self.commands.choices if self.commands is not None else {}
        command = next((word for word in words if word in choices), "")
        if command and choices[command].knows(name):
            self.error(f"{name} belongs after its command: `{self.prog} {command} .. {name}`")

    def _refuse_unknown_command(self, word: str, known: Iterable[str]) -> None:
        if word in known:
            return
        from importlib.metadata import entry_points  # takes a third of the time of `--help`

        if word in entry_points(group="hilcell.procedures").names:
            self.error(f"{word} is a procedure; did you mean `{self.prog} run {word}`?")
        self.error(f"unknown command {word[:80]!r}{self._nearest(word, known)}")

    @staticmethod
    def _nearest(word: str, known: Iterable[str]) -> str:
        """Return the end of a sentence that names the word that was meant; a beginning means it."""
        from hilcell.cell.settings import did_you_mean  # `--help` does without it

        known = list(known)
        begun = [each for each in known if each.startswith(word)]
        return did_you_mean(
            begun[0] if len(begun) == 1 else word,
            [each for each in known if each not in HELP or begun],
        )

    def error(self, message: str) -> NoReturn:
        """Print an error, and where the arguments are listed, and end with exit code 2."""
        # A URL in the place of another word may hold a password.
        words = re.sub(r"(://[^:/@\s]*:)\S*@", r"\1***@", message)
        print_message(f"{self.prog}: {words}\n`{self.prog} --help` lists what there is")
        self.exit(EXIT_REFUSED)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print the help or an error; raises `NotPrinted`, where argparse takes no notice."""
        if file is not sys.stdout:
            super()._print_message(message, file)
            return
        with stdout_checked():
            sys.stdout.write(message)
            sys.stdout.flush()


def made(takes: type[Taken], values: Mapping[str, object]) -> Taken:
    """Return what a command takes, of the values that its parser has read."""
    found: dict[str, object] = {}
    for name, hint in get_type_hints(takes).items():
        value = made(hint, values) if is_signature(hint) else values[name]
        found[name] = tuple(value) if isinstance(value, list) else value
    return takes(**found)
