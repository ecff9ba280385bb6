# SPDX-License-Identifier: Apache-2.0
"""Throw noise at one end of the wires for a bounded time; coverage-guided when atheris is installed.

`fuzz.py driver` feeds what reads a device's bytes, `fuzz.py emulator` the devices themselves. What counts as a finding
stands with each target (softgrip_testing); the stream is printed as hex.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import importlib.util
import random
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import FunctionType, ModuleType

ENDS = ("driver", "emulator")


def fuzz_at_random(target: ModuleType, seconds: float, seed: int, streams: int = 0) -> int:
    """Mutate what a target knows for a while, or until there were so many streams; returns the number of streams."""
    rng, one, count = random.Random(seed), target.TARGET(), 0
    end = time.monotonic() + seconds
    while count < streams if streams else time.monotonic() < end:
        for _ in range(min(100, streams - count) if streams else 100):
            stream = b"".join(target.mutate(rng.choice(target.SEEDS), rng) for _ in range(rng.randrange(1, 4)))
            one.feed(stream + (rng.choice(target.SEEDS) if rng.random() < 0.1 else b""))
            count += 1
    return count


def fuzz_with_atheris(target: ModuleType, seconds: float, seed: int) -> None:
    """Let atheris look for inputs that reach new code; it ends the process itself."""
    # optional: not everybody has a wheel for it
    atheris = importlib.import_module("atheris")
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and str(function.__module__).startswith(target.READERS):
            atheris.instrument_func(function)
    one = target.TARGET()
    with tempfile.TemporaryDirectory() as corpus:
        for number, stream in enumerate(target.SEEDS):
            Path(corpus, str(number)).write_bytes(stream)
        limits = [f"-max_total_time={int(seconds)}", f"-seed={seed}", "-max_len=200"]
        atheris.Setup([sys.argv[0], *limits, corpus], one.feed)
        atheris.Fuzz()


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("end", choices=ENDS, help="of the wires")
    parser.add_argument("--seconds", type=float, default=30.0, help="how long")
    parser.add_argument("--streams", type=int, default=0, help="how many instead, at random")
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    engines = ("auto", "random", "atheris")
    parser.add_argument("--engine", choices=engines, default="auto", help="auto: atheris when it is there")
    options = parser.parse_args(args)
    target = importlib.import_module(f"softgrip_testing.{options.end}_fuzz")
    has_atheris = importlib.util.find_spec("atheris") is not None
    if options.engine == "atheris" and not has_atheris:
        print("fuzz: expected the package 'atheris', found none: pip install atheris", file=sys.stderr)
        return 1
    if options.engine != "random" and not options.streams and has_atheris:
        fuzz_with_atheris(target, options.seconds, options.seed)
        return 0
    began = time.monotonic()
    count = fuzz_at_random(target, options.seconds, options.seed, options.streams)
    print(f"{options.end}: {count} streams in {time.monotonic() - began:.0f} s, no finding")
    return 0


if __name__ == "__main__":
    sys.exit(main())
