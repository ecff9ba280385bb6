# SPDX-License-Identifier: Apache-2.0
"""What a bag carries beside messages: the machine and the software that made it, and what sets its nodes up again.

Attachments: ``parameters/<node>.yaml`` is a ROS parameter file of the node;
``parameter_files/<node>/<parameter>/<name>`` is a file that one of its parameters named (the file itself, or the YAML
files of a folder).
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath

import yaml

from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.places import MAX_FILE_BYTES, read_below, yaml_files_below
from softgrip_bag.reader import attachments

#: [s] a hanging file system must not keep a recording from starting.
_GIT_TIMEOUT_S = 5.0
YAML_TYPE = "application/yaml"
_FILES = "parameter_files"
#: Parameters whose value is a file or a folder of YAML files that results depend on.
FILE_PARAMETERS = frozenset({"calibration_file", "profiles_directory"})


def parameter_attachment(node: str, values: dict[str, object]) -> Attachment:
    """Return the parameter file of a node (fully qualified name).

    Raises:
        BagError: it is too large to be carried.
    """
    text = yaml.safe_dump({node: {"ros__parameters": values}}, sort_keys=True)
    if len(text) > MAX_FILE_BYTES:
        raise BagError(
            f"expected at most {MAX_FILE_BYTES} bytes of parameters, found {len(text)}; they are not carried"
        )
    return Attachment(_parameter_file(node), YAML_TYPE, text.encode())


def parameter_files(roots: Sequence[Path], node: str, parameter: str, path: Path) -> list[Attachment]:
    """Return the file that a parameter names, or the YAML files of the folder.

    Args:
        roots: only what is below one of these is read.
        node: fully qualified name.
        parameter: its name.
        path: its value.

    Raises:
        BagError: it is outside the roots, is no plain file, or is too large.
        OSError: it is not there or cannot be read.
    """
    files = yaml_files_below(roots, path)
    return [Attachment(f"{_FILES}{node}/{parameter}/{file.name}", YAML_TYPE, read_below(roots, file)) for file in files]


@dataclass(frozen=True)
class NodeSetUp:
    """What sets a node up as it was: ROS arguments, and the parameters that they give it."""

    arguments: tuple[str, ...] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)


def restore(bag: Path, node: str, folder: Path) -> NodeSetUp:
    """Write what a bag carries for a node into a folder; returns what sets the node up with it.

    Args:
        bag: to read.
        node: fully qualified name.
        folder: for the files; the arguments name them.

    Raises:
        BagError: when an attachment's name leads out of the folder, or the parameters are no YAML.
    """
    found = {a.name: a.data for a in attachments(bag)}
    own = found.get(_parameter_file(node))
    if own is None:
        return NodeSetUp()
    try:
        values: Mapping[str, object] = yaml.safe_load(own)[node]["ros__parameters"]
    except (yaml.YAMLError, KeyError, TypeError) as error:
        raise BagError(f"{bag}: expected a parameter file of {node} in the attachment, found {error!r}") from error
    parameters = folder / "parameters.yaml"
    parameters.write_bytes(own)
    arguments = ["--params-file", str(parameters)]
    for parameter in sorted(FILE_PARAMETERS & values.keys()):
        prefix = f"{_FILES}{node}/{parameter}/"
        names = [name.removeprefix(prefix) for name in found if name.startswith(prefix)]
        for name in names:
            if PurePosixPath(name).name != name or name in {"", ".."}:
                raise BagError(f"{bag}: expected a plain file name in attachment {prefix + name!r}")
            target = folder / parameter / name
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(found[prefix + name])
        if names:
            place = folder / parameter
            is_file = names == [Path(str(values[parameter])).name]
            arguments += ["-p", f"{parameter}:={place / names[0] if is_file else place}"]
    return NodeSetUp(tuple(arguments), values)


def _parameter_file(node: str) -> str:
    return f"parameters{node}.yaml"


def machine() -> dict[str, str]:
    """Return what identifies the machine, its Python and its middleware."""
    try:
        writer = version("mcap")
    except PackageNotFoundError:
        writer = "unknown"
    return {
        "system": platform.platform(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "processors": str(os.cpu_count() or 0),
        "middleware": os.environ.get("RMW_IMPLEMENTATION", ""),
        "mcap": writer,
    }


def arithmetic() -> str:
    """Return what decides how a machine rounds: the kind of processor and a digest of what it can do."""
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/cpuinfo").read_text().splitlines() if ":" in line)
    except OSError:
        return platform.machine()
    fields = {name.strip(): value.strip() for name, value in lines.items()}
    abilities = " ".join(sorted(fields.get("flags", fields.get("Features", "")).split()))
    return f"{platform.machine()} {hashlib.sha256(abilities.encode()).hexdigest()[:16]}"


def rounding_tolerance(recorded: str) -> float:
    """Return how far results may be off those recorded where `arithmetic` was ``recorded``: 0 on the like of it."""
    return 0.0 if recorded.strip() == arithmetic() else 1e-6


def software() -> dict[str, str]:
    """Return the git version of the checkout that runs, empty where it is none."""
    return {
        "git": _git("rev-parse", "HEAD"),
        "git_changed_files": _git("status", "--porcelain", "-uno"),
    }


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), *arguments],
            capture_output=True,
            text=True,
            timeout=_GIT_TIMEOUT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
