# SPDX-License-Identifier: Apache-2.0
"""Services that read the cell's database, retire a finger, and take what a person did into the audit table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

from softgrip_cell.cell import Cell
from softgrip_cell.errors import CellError, RefusedError
from softgrip_cell.nodes import convert
from softgrip_cell.storage import CellJournal, Library
from softgrip_interfaces.srv import ListFingers, ListGrasps, ListProducts, RetireFinger, WriteAudit
from softgrip_nodekit import NodeIo, answer
from softgrip_nodekit.errors import SuccessResponseT

Request = TypeVar("Request")

#: So many grasps are listed where nobody says how many, and at most.
LISTED: Final = 100
MAX_LISTED: Final = 1000


class RecordServer:
    """Answers from the database.

    Args:
        node_io: the node's way to others.
        cell: its rules.
        library: products, finger records, audit.
        journal: grasps, checks.
        on_change: called after something was changed.
    """

    def __init__(
        self, node_io: NodeIo, cell: Cell, library: Library, journal: CellJournal, on_change: Callable[[], None]
    ) -> None:
        self._cell = cell
        self._library = library
        self._journal = journal
        self._on_change = on_change
        node_io.create_service(ListProducts, "cell/list_products", _answering(self._list_products))
        node_io.create_service(ListFingers, "cell/list_fingers", _answering(self._list_fingers))
        node_io.create_service(ListGrasps, "cell/list_grasps", _answering(self._list_grasps))
        node_io.create_service(RetireFinger, "cell/retire_finger", _answering(self._retire_finger))
        node_io.create_service(WriteAudit, "cell/write_audit", _answering(self._write_audit))

    def _list_products(self, _request: ListProducts.Request, response: ListProducts.Response) -> str:
        catalogue = self._cell.catalogue()
        estimates = self._cell.estimates(catalogue)
        response.products = [
            convert.product_entry(product, estimates[product.id]) for product in catalogue.products.values()
        ]
        return f"{len(response.products)} products"

    def _list_fingers(self, _request: ListFingers.Request, response: ListFingers.Response) -> str:
        records = self._library.finger_records().values()
        response.fingers = [
            convert.finger_record_entry(record, self._journal.reference(record.serial)) for record in records
        ]
        return f"{len(response.fingers)} fingers"

    def _list_grasps(self, request: ListGrasps.Request, response: ListGrasps.Response) -> str:
        limit = min(int(request.limit) or LISTED, MAX_LISTED)
        response.grasps = [convert.grasp_entry(grasp) for grasp in self._journal.grasps(limit)]
        return f"{len(response.grasps)} grasps"

    def _retire_finger(self, request: RetireFinger.Request, _response: RetireFinger.Response) -> str:
        for name, value in (("who", request.who), ("reason", request.reason)):
            if not value.strip():
                raise RefusedError(f"{name}: expected some words for the audit table, found none")
        self._library.retire_finger(request.serial, request.who.strip(), request.reason.strip())
        self._on_change()
        return f"finger {request.serial} is retired"

    def _write_audit(self, request: WriteAudit.Request, _response: WriteAudit.Response) -> str:
        if not request.who.strip() or not request.action.strip():
            raise RefusedError("who, action: expected some words, found none")
        self._library.write_audit(request.who.strip(), request.action.strip(), request.subject, request.detail)
        return "written"


def _answering(
    act: Callable[[Request, SuccessResponseT], str],
) -> Callable[[Request, SuccessResponseT], SuccessResponseT]:
    """Return a service's callback that says why where it refuses."""
    return lambda request, response: answer(response, lambda: act(request, response), CellError)
