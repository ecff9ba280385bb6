# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a bag."""


class BagError(Exception):
    """A bag cannot be written or read; the message says what was expected, what was found and what to do."""


def error_text(error: BaseException | None) -> str:
    """Return an error in words: the system's own for its errors, with its class where it is unexpected."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error) if error is None or isinstance(error, BagError) else repr(error)


class DiskError(BagError):
    """The disk is full, read-only or broken: a bag cannot be begun or goes no further."""


class RecordRefusedError(BagError):
    """One topic or message cannot be taken; the rest of the recording goes on."""
