# SPDX-License-Identifier: Apache-2.0
"""Lets ``from std_msgs.msg import String`` work: an import hook that makes message packages from their text.

It steps aside when a real message package (built by rosidl) can be imported. Started by a .pth file, so it is kept
small: everything else is imported when a message package is first asked for (importlib.abc would cost 10 ms).
"""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

_KINDS = ("msg", "srv", "action")
_SUFFIXES = (
    "_msgs",
    "_srvs",
    "_interfaces",
    "_actions",
)  # how ROS 2 asks such packages to be named; spares other imports


class InterfaceFinder:
    """Finds ``<pkg>`` and ``<pkg>.msg|srv|action`` of packages that define interfaces."""

    def find_spec(
        self,
        name: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,  # noqa: ARG002  the protocol's signature
    ) -> ModuleSpec | None:
        """Return the spec of a package of interfaces, else None so that the next finder is asked."""
        package, _, kind = name.partition(".")
        if (kind and kind not in _KINDS) or (not kind and path is not None):
            return None
        if not package.endswith(_SUFFIXES):
            return None
        from embedded_ros import workspace  # noqa: PLC0415  most processes start without needing it

        if package not in workspace.interface_folders():
            return None
        real = PathFinder.find_spec(package)
        if real is not None and real.loader is not None and real.origin is not None:
            return None
        return ModuleSpec(name, _InterfaceLoader(), is_package=True)  # type: ignore[arg-type]  # a loader by its methods


class _InterfaceLoader:
    """Makes the modules; their classes come from the registry on first use."""

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave the making of the module object to Python."""

    def exec_module(self, module: ModuleType) -> None:
        """Fill the module: a lazy attribute for each class."""
        package, _, kind = module.__name__.partition(".")
        if not kind:
            return
        from embedded_ros.registry import registry  # noqa: PLC0415  see the module's docstring

        known = registry()
        folders = known.packages()
        if not (folders[package] / kind).is_dir():
            raise ModuleNotFoundError(f"No module named '{module.__name__}'", name=module.__name__)
        names = known.names(package, kind)

        def attribute(name: str) -> Any:
            if name not in names:  # such as Move_Result: rosidl has it as Move.Result alone
                raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}; it has {', '.join(names)}")
            found = known.interface(f"{package}/{kind}/{name}")
            setattr(module, name, found)
            return found

        module.__dict__.update(__getattr__=attribute, __all__=names, __dir__=lambda: names)


def install() -> None:
    """Put the finder in front, once."""
    if not any(isinstance(finder, InterfaceFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, InterfaceFinder())
