"""Generates wrong command lines: each of them is refused, by its words alone, with exit code 2."""

from __future__ import annotations

import argparse
import random
from collections.abc import Iterator

from hilcell.commands.cli import whole_parser

STRANGE = ["", " ", "-", "é", "\x1b[31m", "\udcff", "\N{GRINNING FACE}", "x" * 300, "%s{}", "\n"]
BAD_VALUES = {
    "--seed": ["-1", "1.5", "x", "9" * 30, "٣"],
    "--machine-seed": ["-1", "nan"],
    "--speed": ["0", "nan", "-5", "fast"],
    "--set": ["x", "=1", "rail.speed_mm_s=nan", "nosuch.key=1", "a=1\nb=2", "rail=1"],
    "--cell": ["nope", "/dev/null", "/", "é.toml"],
    "--ports": ["rail=0", "rail=1,robot=1", "x"],
    "--theme": ["dark", "é"],
    "--colors": ["17"],
    "--temperature": ["nan", "warm"],
    "--max-age": ["-1", "inf", "1e300"],
    "--name": ["last", "../x", "é/", "_x", ""],
}
REFUSED_NAMES = ["compare", "show", "resume", "pause", "stop", "watch", "revoke", "explain"]
MUST_HAVE = ["show", "report", "export", "compensate", "prepare", "plan", "fit", "check", "compare"]


def wrong_lines(count: int, seed: int) -> list[list[str]]:
    """Return different lines, the same ones for a seed."""
    chance = random.Random(seed)
    lines: dict[tuple[str, ...], None] = {}
    makers = [_misspelt_command, _unknown_option, _bad_value, _no_value, _too_many, _missing,
              _strange, _no_such_run]  # fmt: skip
    commands = _commands()
    while len(lines) < count:
        maker = chance.choice(makers)
        for line in maker(chance, commands):
            lines[tuple(line)] = None
    return [list(line) for line in lines][:count]


def _commands() -> dict[str, argparse.ArgumentParser]:
    commands = whole_parser().commands
    assert commands is not None
    return dict(commands.choices)


def _spoilt(chance: random.Random, word: str) -> str:
    place = chance.randrange(len(word))
    return word[:place] + chance.choice("qzé_7") + word[place + chance.randrange(2) :]


def _misspelt_command(
    chance: random.Random, commands: dict[str, argparse.ArgumentParser]
) -> Iterator[list[str]]:
    word = _spoilt(chance, chance.choice(list(commands)))
    yield [word, *chance.sample(["paper", "--json", "last"], chance.randrange(3))]


def _unknown_option(
    chance: random.Random, commands: dict[str, argparse.ArgumentParser]
) -> Iterator[list[str]]:
    command = chance.choice(list(commands))
    option = f"--z{_spoilt(chance, chance.choice(list(BAD_VALUES))[2:])}"
    yield [command, option, "x"]
    yield [command, f"{option}=1"]


def _bad_value(
    chance: random.Random, commands: dict[str, argparse.ArgumentParser]
) -> Iterator[list[str]]:
    option = chance.choice(list(BAD_VALUES))
    value = chance.choice(BAD_VALUES[option])
    for command in ("run", "sim", "check", "plan"):
        if any(option in action.option_strings for action in commands[command]._actions):
            more = {"check": ["paper"], "plan": ["holes.csv"]}.get(command, [])
            yield [command, *more, f"{option}={value}"]


def _no_value(
    chance: random.Random, commands: dict[str, argparse.ArgumentParser]
) -> Iterator[list[str]]:
    command = chance.choice(list(commands))
    options = [
        action.option_strings[-1]
        for action in commands[command]._actions
        if action.option_strings and action.nargs is None
    ]
    if options:
        yield [command, chance.choice(options)]


def _too_many(
    chance: random.Random, commands: dict[str, argparse.ArgumentParser]
) -> Iterator[list[str]]:
    yield [chance.choice(list(commands)), *(chance.choice(STRANGE[3:]) for _ in range(4))]


def _missing(chance: random.Random, _: object) -> Iterator[list[str]]:
    yield [chance.choice(MUST_HAVE)]
    yield [chance.choice(MUST_HAVE), "--json"]


def _strange(chance: random.Random, _: object) -> Iterator[list[str]]:
    yield [chance.choice(STRANGE)]
    yield ["run", chance.choice(STRANGE)]
    yield ["check", chance.choice(STRANGE)]
    yield ["explain", chance.choice(STRANGE)]


def _no_such_run(chance: random.Random, _: object) -> Iterator[list[str]]:
    command = chance.choice(REFUSED_NAMES)
    more = {"compare": ["nosuch"], "revoke": ["--reason=x"]}.get(command, [])
    yield [command, chance.choice([*STRANGE[1:], "nosuch", "last"]), *more]
