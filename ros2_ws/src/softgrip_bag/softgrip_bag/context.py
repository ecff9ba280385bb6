# SPDX-License-Identifier: Apache-2.0
"""What a bag carries so that a node can be set up again from the bag alone: parameters, and the files they name.

Attachments: ``parameters/<node>.yaml`` is a ROS parameter file of the node;
``parameter_files/<node>/<parameter>/<name>`` is a file that one of its parameters named (the file itself, or the YAML
files of a folder).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.places import MAX_FILE_BYTES, read_below, yaml_files_below
from softgrip_bag.reader import attachments

YAML_TYPE = "application/yaml"
_FILES = "parameter_files"
#: Parameters whose value is a file or a folder of YAML files that results depend on.
FILE_PARAMETERS = frozenset({"calibration_file", "profiles_directory"})


def parameter_attachment(node: str, values: dict[str, Any]) -> Attachment:
    """Return the parameter file of a node (fully qualified name).

    Raises:
        BagError: it is too large to be carried.
    """
    text = yaml.safe_dump({node: {"ros__parameters": values}}, sort_keys=True)
    if len(text) > MAX_FILE_BYTES:
        raise BagError(
            f"expected at most {MAX_FILE_BYTES} bytes of parameters, found {len(text)}; they are not carried"
        )
    return Attachment(f"parameters{node}.yaml", YAML_TYPE, text.encode())


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


def restore(bag: Path, node: str, folder: Path) -> list[str]:
    """Write what a bag carries for a node into a folder; returns ROS arguments that set the node up with it.

    Args:
        bag: to read.
        node: fully qualified name.
        folder: for the files; the arguments name them.

    Returns:
        none, when the bag carries nothing for the node.

    Raises:
        BagError: when an attachment's name leads out of the folder, or the parameters are no YAML.
    """
    found = {a.name: a.data for a in attachments(bag)}
    own = found.get(f"parameters{node}.yaml")
    if own is None:
        return []
    parameters = folder / "parameters.yaml"
    parameters.write_bytes(own)
    try:
        values = yaml.safe_load(own)[node]["ros__parameters"]
    except (yaml.YAMLError, KeyError, TypeError) as error:
        raise BagError(f"{bag}: expected a parameter file of {node} in the attachment, found {error!r}") from error
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
    return arguments
