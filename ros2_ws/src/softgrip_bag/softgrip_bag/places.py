# SPDX-License-Identifier: Apache-2.0
"""Where the recorder may write and read: below configured folders, plain files of a bounded size.

What is asked for comes over the network from anybody. A link out of the folders, as `colcon build --symlink-install`
makes them, is followed when only this process' user and root can have made it: as openssh's StrictModes, every folder
and link on the way belongs to one of the two and can be written by nobody else. Sources: openat(2), O_NOFOLLOW;
auth_secure_path in openssh's misc.c; unlink(2) about folders with the sticky bit.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from softgrip_bag.errors import BagError

#: [byte] of a file that a bag carries.
MAX_FILE_BYTES = 1_000_000
#: Files of one folder that a bag carries.
MAX_FILES = 100
_PATH_BYTES = 1024
#: Links on the way to a file that are followed, as the kernel does (path_resolution(7)).
_MAX_LINKS = 40


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
    """Return the path without links."""
    if "\0" in str(path):
        raise BagError(f"expected a path, found one with a zero byte: {str(path)!r:.200}")
    place = Path(os.path.realpath(path))
    if _is_below(roots, place):
        return place
    link = Path(os.path.realpath(path.parent)) / path.name
    if not _is_below(roots, link):
        raise BagError(
            f"expected a file below {os.pathsep.join(map(str, roots)) or 'nothing'} (attachment_roots), found {path}; "
            "add its folder there"
        )
    return _follow_own_links(link)


def _is_below(roots: Sequence[Path], place: Path) -> bool:
    tops = [Path(os.path.realpath(root)) for root in roots]
    return any(top == place or top in place.parents for top in tops)


def _follow_own_links(path: Path) -> Path:
    """Return where an absolute path leads; raises BagError when somebody else may have laid the way."""
    place, ahead, links = Path(path.anchor), deque(path.parts[1:]), 0
    while ahead:
        name = ahead.popleft()
        if name == "..":
            place = place.parent
            continue
        folder, entry = place.stat(), (place / name).lstat()
        if not _is_ours(entry) or (_is_open_to_others(folder) and not folder.st_mode & stat.S_ISVTX):
            raise BagError(
                f"expected a link out of attachment_roots that only this user or root can have made, found that others "
                f"may change {place / name}, on the way from {path}; add the folder of the file itself there"
            )
        if not stat.S_ISLNK(entry.st_mode):
            place /= name
            continue
        links += 1
        if links > _MAX_LINKS:
            raise BagError(
                f"expected at most {_MAX_LINKS} links on the way from {path}, found more; name the file itself"
            )
        target = (place / name).readlink()
        place = Path(target.anchor) if target.anchor else place
        ahead.extendleft(reversed(target.parts[1:] if target.anchor else target.parts))
    return place


def _is_ours(entry: os.stat_result) -> bool:
    return entry.st_uid in {0, os.geteuid()}


def _is_open_to_others(folder: os.stat_result) -> bool:
    """Whether others can write it; the group that a user has alone, as Debian and Ubuntu give one, is no other."""
    if folder.st_mode & stat.S_IWGRP and folder.st_gid != 0:
        try:
            user, group = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(folder.st_gid)
        except KeyError:
            return True
        if group.gr_name != user or set(group.gr_mem) - {user}:
            return True
    return bool(folder.st_mode & stat.S_IWOTH)


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
