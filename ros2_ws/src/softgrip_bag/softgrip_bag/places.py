# SPDX-License-Identifier: Apache-2.0
"""Where the recorder may write and read: below configured folders, plain files of a bounded size, no link out of them.

What is asked for comes over the network from anybody. Source: openat(2), O_NOFOLLOW.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from pathlib import Path

from softgrip_bag.errors import BagError

#: [byte] of a file that a bag carries.
MAX_FILE_BYTES = 1_000_000
#: Files of one folder that a bag carries.
MAX_FILES = 100
_PATH_BYTES = 1024


def bag_folder(root: Path, path: str) -> Path:
    """Return the folder for a bag that somebody asked for.

    Args:
        root: all bags are below it.
        path: relative to the root, or absolute and below it.

    Raises:
        BagError: it leads out of the root, or is no path.
    """
    asked = f"expected a folder below {root} (the recorder's root) or an empty path, found {path!r:.200}"
    if "\0" in path or len(os.fsencode(path)) > _PATH_BYTES:
        raise BagError(f"{asked}; name a shorter one without zero bytes")
    found = Path(os.path.realpath(root / path))
    top = Path(os.path.realpath(root))
    if top not in found.parents:
        raise BagError(f"{asked}; name one below it, or start the recorder with another root")
    return found


def read_below(roots: Sequence[Path], path: Path) -> bytes:
    """Return the content of a plain file.

    Args:
        roots: folders that it may be below, or files that it may be.
        path: of the file.

    Raises:
        BagError: it is outside, is no plain file, or is too large.
        OSError: it is not there or cannot be read.
    """
    place = _place_below(roots, path)
    descriptor = _open_without_links(place)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise BagError(f"expected a plain file, found that {path} is a {_kind(mode)}; name the file itself")
    with os.fdopen(descriptor, "rb") as stream:
        data = stream.read(MAX_FILE_BYTES + 1)
    if len(data) > MAX_FILE_BYTES:
        raise BagError(
            f"expected a file of at most {MAX_FILE_BYTES} bytes, found that {path} is larger; it is not carried"
        )
    return data


def yaml_files_below(roots: Sequence[Path], path: Path) -> list[Path]:
    """Return the YAML files of a folder, or the path itself when it is no folder.

    Raises:
        BagError: it is outside the roots, or there are too many.
        OSError: it is not there.
    """
    place = _place_below(roots, path)
    if not stat.S_ISDIR(place.stat().st_mode):
        return [path]
    names = sorted(entry.name for entry in os.scandir(place) if entry.name.endswith(".yaml"))
    if len(names) > MAX_FILES:
        raise BagError(f"expected at most {MAX_FILES} YAML files in {path}, found {len(names)}; they are not carried")
    return [path / name for name in names]


def _place_below(roots: Sequence[Path], path: Path) -> Path:
    if "\0" in str(path):
        raise BagError(f"expected a path, found one with a zero byte: {str(path)!r:.200}")
    place = Path(os.path.realpath(path))
    tops = [Path(os.path.realpath(root)) for root in roots]
    if not any(top == place or top in place.parents for top in tops):
        raise BagError(
            f"expected a file below {os.pathsep.join(map(str, roots)) or 'nothing'} (attachment_roots), found {path}; "
            "add its folder there"
        )
    return place


def _open_without_links(place: Path) -> int:
    """Open a path without links in it; one that has become a link since, or a pipe, stops nobody."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    folder = os.open(place.anchor, flags | os.O_DIRECTORY)
    try:
        for name in place.parts[1:-1]:
            inner = os.open(name, flags | os.O_DIRECTORY, dir_fd=folder)
            os.close(folder)
            folder = inner
        return os.open(place.name, flags | os.O_NONBLOCK, dir_fd=folder)
    finally:
        os.close(folder)


def _kind(mode: int) -> str:
    kinds = {stat.S_ISDIR: "folder", stat.S_ISFIFO: "pipe", stat.S_ISCHR: "device", stat.S_ISBLK: "device"}
    return next((name for is_kind, name in kinds.items() if is_kind(mode)), "socket")
