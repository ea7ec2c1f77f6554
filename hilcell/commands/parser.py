"""The parser of a signature: short errors that name the nearest command or option."""

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

from hilcell.arguments import MISSING, Argument, Signature, arguments_of, is_signature
from hilcell.commands.console import print_message, stdout_checked
from hilcell.errors import EXIT_REFUSED

if TYPE_CHECKING:
    from hilcell.decoding import Json

HELP = ("-h", "--help")  # never suggested: every command has it
S = TypeVar("S", bound=Signature)


class Parser(argparse.ArgumentParser):
    """Parses one command by its signature, or its subcommands."""

    def __init__(self, *, signature: type[Signature] | None = None, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self._signature = signature
        self.commands: argparse._SubParsersAction[Parser] | None = None
        self.groups: Mapping[str, Iterable[str]] = {}  # names of commands by title, for the help

    def fill(self) -> Parser:
        """Return the parser with its arguments, added lazily: a process parses one command."""
        signature, self._signature = self._signature, None
        if signature is not None:
            for each in arguments_of(signature):
                self._add_field(each)
        return self

    def knows(self, option: str) -> bool:
        self.fill()
        return option in self._option_string_actions

    def _add_field(self, field: Argument) -> None:
        name, kind = field.name, field.kind
        if field.switches:
            group = self.add_mutually_exclusive_group(required=True)
            for value, text in field.switches.items():
                group.add_argument(
                    f"--{value}", dest=name, action="store_const", const=value, help=text
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
            options |= {"metavar": field.metavar, "type": field.parse}
        if get_origin(kind) is tuple:
            options |= {"action": "append", "default": []}
        if field.positional:
            self.add_argument(name, nargs=None if field.must_be_given else "?", **options)
        else:
            self.add_argument(*field.names, dest=name, required=field.must_be_given, **options)

    def format_help(self) -> str:
        if self.commands is None or not self.groups:
            return super().format_help()
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        actions = self.commands._choices_actions  # noqa: SLF001 - argparse has no public list
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
        """Refuse unknown words first: argparse would report missing arguments instead."""
        self.fill()
        self._refuse_unknown(sys.argv[1:] if args is None else args)
        parsed, rest = super().parse_known_args(args, namespace)
        if rest:
            kind = "unknown option" if rest[0].startswith("-") else "unexpected argument"
            self.error(f"{kind} {rest[0][:80]}")
        return parsed, rest

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
        """Refuse an option of a command before that command."""
        choices = self.commands.choices if self.commands is not None else {}
        command = next((word for word in words if word in choices), "")
        if command and choices[command].knows(name):
            self.error(f"{name} belongs after its command: `{self.prog} {command} .. {name}`")

    def _refuse_unknown_command(self, word: str, known: Iterable[str]) -> None:
        if word in known:
            return
        from importlib.metadata import entry_points  # a third of the time of `--help`

        if word in entry_points(group="hilcell.procedures").names:
            self.error(f"{word} is a procedure; did you mean `{self.prog} run {word}`?")
        self.error(f"unknown command {word[:80]!r}{self._nearest(word, known)}")

    @staticmethod
    def _nearest(word: str, known: Iterable[str]) -> str:
        """Return a suggestion, or "": a unique beginning counts as the whole word."""
        from hilcell.cell.settings import did_you_mean  # not for `--help`

        known = list(known)
        begun = [each for each in known if each.startswith(word)]
        return did_you_mean(
            begun[0] if len(begun) == 1 else word,
            [each for each in known if each not in HELP or begun],
        )

    def error(self, message: str) -> NoReturn:
        """Print an error and exit with code 2."""
        text = re.sub(r"(://[^:/@\s]*:)\S*@", r"\1***@", message)  # passwords in URLs
        print_message(f"{self.prog}: {text}\n`{self.prog} --help` lists all arguments")
        self.exit(EXIT_REFUSED)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print the help or an error; raises `NotPrinted`, unlike argparse."""
        if file is not sys.stdout:
            super()._print_message(message, file)
            return
        with stdout_checked():
            sys.stdout.write(message)
            sys.stdout.flush()


def build(signature: type[S], values: Mapping[str, object]) -> S:
    fields: dict[str, object] = {}
    for name, hint in get_type_hints(signature).items():
        value = build(hint, values) if is_signature(hint) else values[name]
        fields[name] = tuple(value) if isinstance(value, list) else value
    return signature(**fields)
