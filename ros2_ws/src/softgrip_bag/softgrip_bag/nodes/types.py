# SPDX-License-Identifier: Apache-2.0
"""From type names in the graph or a bag to message classes and interface text."""

from __future__ import annotations

import functools
import importlib
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from softgrip_bag.errors import BagError
from softgrip_bag.reader import TopicSummary
from softgrip_bag.schema_text import same_definition, schema_text


@functools.cache
def message_class(type_name: str) -> Any:
    """Return the class of e.g. "std_msgs/msg/String" "pkg/action/Move_FeedbackMessage" or "pkg/srv/Set_Event".

    Raises:
        BagError: when the package is not installed or does not have the type.
    """
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        if kind == "action" and name.endswith("_FeedbackMessage"):
            return getattr(module, name.removesuffix("_FeedbackMessage")).Impl.FeedbackMessage
        if kind == "srv" and name.endswith("_Event"):
            return getattr(module, name.removesuffix("_Event")).Event
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


def check_definition(topic: TopicSummary) -> None:
    """Make sure that a topic was recorded with the definition that is installed here.

    Raises:
        BagError: when the type is not installed, or is another one of that name.
    """
    message_class(topic.type_name)
    if topic.schema and not same_definition(topic.schema, schema_text(topic.type_name, interface_text)):
        raise BagError(
            f"{topic.name}: expected {topic.type_name} as it is installed here, found one with other fields: the bag "
            "is of another ROS distribution or version; read it there, or by its schemas (rosbags, mcap-ros2-support)"
        )
