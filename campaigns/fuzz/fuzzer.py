"""``python -m campaigns.fuzz.fuzzer BY NAME INPUTS SECONDS SEED``: fuzz one parser.

``BY`` is ``atheris`` or ``mutation``. The last line states the inputs and the seconds.
"""

from __future__ import annotations

import random
import signal
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

HANG_S = 20
LONGEST = 20_000  # bytes of an input


def main(by: str, name: str, inputs: int, seconds: int, seed: int) -> int:
    if by == "mutation":
        return mutate(import_module("campaigns.fuzz.parsers").PARSERS[name], inputs, seconds, seed)
    return guided(name, inputs, seconds, seed)


def guided(name: str, inputs: int, seconds: int, seed: int) -> int:
    """Fuzz by coverage; does not return where something is found."""
    import atheris

    with atheris.instrument_imports(include=["drivers", "hilcell"]):
        parsers = import_module("campaigns.fuzz.parsers")
    parser = parsers.PARSERS[name]
    corpus = Path(parsers.folder().name, "corpus")
    corpus.mkdir()
    for number, sample in enumerate(parser.samples()):
        (corpus / str(number)).write_bytes(sample)
    settings = (
        f"-runs={inputs}", f"-max_total_time={seconds}", f"-seed={seed}", f"-timeout={HANG_S}",
        "-rss_limit_mb=2048", f"-max_len={LONGEST}", f"-artifact_prefix={corpus}/", "-verbosity=1",
    )  # fmt: skip
    atheris.Setup([sys.argv[0], *settings, str(corpus)], parser.take)
    atheris.Fuzz()
    return 0


def mutate(parser: Any, inputs: int, seconds: int, seed: int) -> int:
    """Hand over random mutations of the samples; return 1 where one is not taken as it should."""
    rng, samples = random.Random(seed), list(parser.samples())
    began_s, number = time.monotonic(), 0
    signal.signal(signal.SIGALRM, _hung)
    while number < inputs and time.monotonic() - began_s < seconds:
        data, number = mutated(rng, samples), number + 1
        signal.alarm(HANG_S)
        try:
            parser.take(data)
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is the finding
            print(f"FOUND {type(error).__name__}: {error} on input {number}: {data!r}")
            return 1
        finally:
            signal.alarm(0)
    print(f"Done {number} runs in {time.monotonic() - began_s:.0f} second(s)")
    return 0


def mutated(rng: random.Random, samples: Sequence[bytes]) -> bytes:
    """Return a sample with a few bytes changed, cut out, doubled, or spliced with another's."""
    data = bytearray(rng.choice(samples))
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        at, size = rng.randint(0, len(data)), rng.choice((1, 1, 2, 4, 16, 64))
        match rng.randrange(5):
            case 0:
                data[at : at + size] = rng.randbytes(size)
            case 1:
                del data[at : at + size]
            case 2:
                data[at:at] = data[at : at + size] * rng.choice((1, 1, 2, 50))
            case 3:
                other = rng.choice(samples)
                data[at:at] = other[rng.randint(0, len(other)) :][:size]
            case _:
                data[at : at + 1] = bytes([rng.choice(b'\0\xff\x80-.,;"{}[]=\n\r 0919eEnN')])
    return bytes(data[:LONGEST])


def _hung(signum: int, frame: object) -> None:
    raise TimeoutError(f"it hangs for more than {HANG_S} s")


if __name__ == "__main__":
    by, name, *numbers = sys.argv[1:]
    sys.exit(main(by, name, *map(int, numbers)))
