# SPDX-License-Identifier: Apache-2.0
"""Write a small file so that a power cut leaves the old content or the new one, and after the return the new one.

It stands in softgrip_model because every package may import this one. Source: fsync(2), "Calling fsync() does not
necessarily ensure that the entry in the directory containing the file has also reached disk. For that an explicit
fsync() on a file descriptor for the directory is also needed."
"""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


def write_durably(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Replace a file's content; on the disk when this returns.

    Args:
        path: of the file; folders that are missing are made.
        data: the whole content.
        mode: permissions of the file, less the process's umask; 0o600 for what nobody else may read.

    Raises:
        OSError: the disk refused. The file then holds the old content or the new one, whole.
    """
    with replacing_durably(path, mode) as stream:
        stream.write(data)


@contextmanager
def replacing_durably(path: Path, mode: int = 0o666) -> Iterator[IO[bytes]]:
    """Give a stream whose content takes the place of a file when the block has succeeded.

    Args:
        path: of the file; folders that are missing are made.
        mode: permissions of the file, less the process's umask.

    Raises:
        OSError: the disk refused. The file then holds the old content or the new one, whole.
    """
    make_folder_durably(path.parent)
    fresh = path.with_name(f".{path.name}.{secrets.token_hex(4)}.new")
    try:
        descriptor = os.open(fresh, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        with os.fdopen(descriptor, "w+b") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        fresh.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):  # the first error is the one to report
            fresh.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def make_folder_durably(folder: Path) -> None:
    """Make a folder and its missing parents; their names are on the disk when this returns.

    Raises:
        OSError: the disk refused, or a parent is a file.
    """
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for place in reversed(missing):
        sync_folder(place.parent)


def sync_folder(folder: Path) -> None:
    """Put the names in a folder on the disk: what was made, renamed or deleted there.

    Raises:
        OSError: the disk refused.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
