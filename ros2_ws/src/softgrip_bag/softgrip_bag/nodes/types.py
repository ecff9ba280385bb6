# SPDX-License-Identifier: Apache-2.0
"""From type names in the graph or a bag to message classes and interface text."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from softgrip_bag.errors import BagError


def message_class(type_name: str) -> Any:
    """Return the class of e.g. "std_msgs/msg/String" or "pkg/action/Move_FeedbackMessage".

    Raises:
        BagError: when the package is not installed or does not have the type.
    """
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        if kind == "action" and name.endswith("_FeedbackMessage"):
            return getattr(module, name.removesuffix("_FeedbackMessage")).Impl.FeedbackMessage
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        raise BagError(
            f"expected an installed type {type_name}, found none ({error}); install package {package}"
        ) from error


def interface_text(package: str, kind: str, name: str) -> str:
    """Return the definition of an interface from its package's share folder."""
    try:
        path = Path(get_package_share_directory(package)) / kind / f"{name}.{kind}"
        return path.read_text()
    except (PackageNotFoundError, OSError) as error:
        raise BagError(f"expected the definition of {package}/{kind}/{name}, found none ({error})") from error
