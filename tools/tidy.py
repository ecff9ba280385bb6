# SPDX-License-Identifier: Apache-2.0
"""Run clang-tidy on the C++ cores and their tests: `make tidy`.

A source that passed is not looked at again before it, a header of its package or .clang-tidy changes, so that only the
first run takes minutes. Any finding is an error.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "ros2_ws" / "src"
CORES = ("softgrip_model", "softgrip_emulator", "softgrip_vision")
#: of this Python environment
TIDY = Path(sys.executable).with_name("clang-tidy")


def files(package: Path, suffix: str) -> list[Path]:
    """Return the C++ files of a package, what was built left out."""
    return sorted(path for path in package.rglob(f"*{suffix}") if "build" not in path.relative_to(package).parts)


def digest(paths: Iterable[Path], more: str) -> str:
    """Return the SHA-256 of files and of a text."""
    found = hashlib.sha256(more.encode())
    for path in paths:
        found.update(path.read_bytes())
    return found.hexdigest()


def changed(package: Path, passed: dict[str, str], version: str) -> dict[Path, str]:
    """Return source -> digest of what has not passed as it is.

    Args:
        package: its folder.
        passed: source -> digest of what did.
        version: of clang-tidy.
    """
    common = digest([ROOT / ".clang-tidy", *files(package, ".hpp")], version)
    digests = {source: digest([source], common) for source in files(package, ".cpp")}
    return {source: value for source, value in digests.items() if passed.get(str(source.relative_to(ROOT))) != value}


def configure(package: Path, folder: Path) -> set[Path]:
    """Have CMake write how each source is compiled; return the sources that it knows."""
    options = (
        "-DSOFTGRIP_TESTS_ONLY=ON",
        "-DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON",
        "-DCMAKE_DISABLE_FIND_PACKAGE_OpenMP=ON",  # its header is the compiler's own, and clang-tidy comes alone
    )
    command = ["cmake", "-S", str(package), "-B", str(folder), "-G", "Ninja", *options]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return {Path(entry["file"]) for entry in json.loads((folder / "compile_commands.json").read_text(encoding="utf-8"))}


def findings(source: Path, folder: Path) -> str:
    """Return what clang-tidy finds in a source and in the headers that it includes; empty for nothing."""
    command = [str(TIDY), "--quiet", "--warnings-as-errors=*", "-p", str(folder), str(source)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    return "" if done.returncode == 0 else done.stdout + done.stderr


def tidy(jobs: int, out: Path, cores: Sequence[str]) -> int:
    """Look at what changed, remember what passed; return how many sources did not."""
    record = out / "passed.json"
    passed: dict[str, str] = json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {}
    version = subprocess.run([str(TIDY), "--version"], check=True, capture_output=True, text=True).stdout
    bad = 0
    for core in cores:
        package = SOURCES / core
        todo = changed(package, passed, version)
        if not todo:
            continue
        known = configure(package, out / core)
        with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
            running = {pool.submit(findings, source, out / core): source for source in todo if source in known}
            for future in concurrent.futures.as_completed(running):
                source = running[future]
                if text := future.result():
                    print(text)
                    bad += 1
                else:
                    passed[str(source.relative_to(ROOT))] = todo[source]
                    record.write_text(json.dumps(passed, indent=1), encoding="utf-8")
    return bad


def main() -> int:
    """Run the command; exit code 1 where anything was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many at a time")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "tidy", help="what passed, and how things compile")
    parser.add_argument("cores", nargs="*", default=CORES, metavar="PACKAGE", help="with a core (default: all)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return int(tidy(options.jobs, options.out, options.cores) > 0)


if __name__ == "__main__":
    sys.exit(main())
