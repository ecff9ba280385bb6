# SPDX-License-Identifier: Apache-2.0
"""The errors of softgrip_cell: each message says what was expected, what was found and what to do."""


class CellError(Exception):
    """Base of everything that softgrip_cell raises on purpose."""


class CatalogueError(CellError):
    """A catalogue, finger record or order list holds something that cannot be used."""


class StorageError(CellError):
    """The database cannot be opened, written or understood."""


class ConflictError(StorageError):
    """Somebody else changed the same entry since it was read; nothing was written."""


class SchemaError(StorageError):
    """The database was written by another release."""


class OccupiedError(StorageError):
    """Another manager already runs this cell."""


class RefusedError(CellError):
    """The cell will not do this now; the message is the reason given to the caller."""
