# SPDX-License-Identifier: Apache-2.0
"""An order list as a person types, pastes or uploads it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: A longer text is no order list.
MAX_BYTES: Final = 64 * 1024
MAX_LINES: Final = 1000
MAX_QUANTITY: Final = 10_000

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}")
_HEADERS: Final = frozenset({"product", "name", "item"})


@dataclass(frozen=True)
class OrderLine:
    """So many of one product."""

    product: str
    quantity: int


def read_orders(text: str) -> list[OrderLine]:
    """Return the orders of a text: a line each, `egg`, `egg 2`, `egg=2`, `egg,2` or `egg;2`; a CSV header is skipped.

    Raises:
        PanelError: with the number of the line that cannot be read.
    """
    if len(text.encode("utf-8", "replace")) > MAX_BYTES:
        raise PanelError(say("error.orders_large", limit=MAX_BYTES // 1024))
    lines = text.splitlines()
    if len(lines) > MAX_LINES:
        raise PanelError(say("error.orders_long", limit=MAX_LINES, found=len(lines)))
    orders = [_order(number, line) for number, line in enumerate(lines, 1) if line.strip() and not _is_header(line)]
    if not orders:
        raise PanelError(say("error.orders_none"))
    return orders


def _is_header(line: str) -> bool:
    return re.split(r"[,;\t]", line)[0].strip().strip('"').lower() in _HEADERS


def _order(number: int, line: str) -> OrderLine:
    words = [word.strip('"') for word in re.split(r"[\s,;=]+", line.strip()) if word.strip('"')]
    if not 1 <= len(words) <= 2 or not _NAME.fullmatch(words[0]):
        raise PanelError(say("error.order", number=number, found=line[:60]))
    if len(words) == 1:
        return OrderLine(words[0], 1)
    if not words[1].isascii() or not words[1].isdigit() or not 1 <= int(words[1]) <= MAX_QUANTITY:
        raise PanelError(say("error.order_number", number=number, limit=MAX_QUANTITY, found=words[1][:20]))
    return OrderLine(words[0], int(words[1]))
