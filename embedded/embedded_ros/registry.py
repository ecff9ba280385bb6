# SPDX-License-Identifier: Apache-2.0
"""Finds interface definitions by name and keeps the classes made from them."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from embedded_ros import workspace
from embedded_ros.errors import UnknownInterfaceError
from embedded_ros.interface_text import Field, FieldType, MessageText
from embedded_ros.messages import KINDS, Definition, Message, make_message, parse_file

if TYPE_CHECKING:
    from pathlib import Path

_UUID = FieldType("unique_identifier_msgs/msg/UUID")
_TIME = FieldType("builtin_interfaces/msg/Time")
_EVENT_INFO = FieldType("service_msgs/msg/ServiceEventInfo")


class Registry:
    """All interfaces of the shipped set and the workspace, made on demand."""

    def __init__(self) -> None:
        self._messages: dict[str, type[Message]] = {}
        self._interfaces: dict[str, type] = {}

    def packages(self) -> dict[str, Path]:
        """Return the folder of each package that defines interfaces."""
        return workspace.interface_folders()

    def names(self, package: str, kind: str) -> list[str]:
        """Return the sorted names a package defines of a kind (msg, srv, action)."""
        folder = self._folder(package) / kind
        return sorted(path.stem for path in folder.glob(f"*.{kind}"))

    def path(self, full_name: str) -> Path:
        """Return the file that defines ``pkg/kind/Name``."""
        package, kind, name = split_name(full_name)
        path = self._folder(package) / kind / f"{name}.{kind}"
        if not path.is_file():
            known = ", ".join(self.names(package, kind)) or "none"
            raise UnknownInterfaceError(f"{full_name} is not defined; {package}/{kind} has: {known}")
        return path

    def _folder(self, package: str) -> Path:
        folders = self.packages()
        if package not in folders:
            raise UnknownInterfaceError(
                f"no package '{package}' with interfaces; known are {', '.join(sorted(folders))}. "
                "A workspace package is found when EMBEDDED_WORKSPACE names the folder above it"
            )
        return folders[package]

    def message(self, full_name: str) -> type[Message]:
        """Return the class of ``pkg/msg/Name`` or of a part such as ``pkg/srv/Name_Request``."""
        if full_name not in self._messages:
            package, kind, name = split_name(full_name)
            if kind == "msg":
                (text,) = parse_file(self.path(full_name), package, kind)
                self._add(text)
            elif kind == "srv":
                self.service(f"{package}/srv/{name.rsplit('_', 1)[0]}")
            else:
                self.action(f"{package}/action/{name.split('_', 1)[0]}")
            if full_name not in self._messages:
                raise UnknownInterfaceError(f"{full_name} is not defined")
        return self._messages[full_name]

    def _add(self, text: MessageText) -> type[Message]:
        made = make_message(text, self.message)
        self._messages[text.name] = made
        return made

    def service(self, full_name: str) -> Any:
        """Return the class of ``pkg/srv/Name`` with its Request, Response and Event."""
        if full_name not in self._interfaces:
            package, kind, _ = split_name(full_name)
            request, response = parse_file(self.path(full_name), package, kind)
            self._interfaces[full_name] = self._make_service(full_name, request, response)
        return self._interfaces[full_name]

    def _make_service(self, full_name: str, request: MessageText, response: MessageText) -> Any:
        event = MessageText(
            f"{full_name}_Event",
            (
                Field("info", _EVENT_INFO),
                Field("request", FieldType(request.name, array="bounded", size=1)),
                Field("response", FieldType(response.name, array="bounded", size=1)),
            ),
        )
        whole = MessageText(
            full_name,
            (
                Field("request_message", FieldType(request.name)),
                Field("response_message", FieldType(response.name)),
                Field("event_message", FieldType(event.name)),
            ),
        )
        parts = {"Request": self._add(request), "Response": self._add(response), "Event": self._add(event)}
        return self._make_interface(whole, parts)

    def _make_interface(self, whole: MessageText, parts: dict[str, Any]) -> type:
        package, kind, name = split_name(whole.name)

        body = {
            "__module__": f"{package}.{kind}",
            "__doc__": f"{whole.name}.",
            "__new__": _refuse_instance,
            "DEFINITION": Definition(whole, self.message),
            **parts,
        }
        return type(name, (), body)

    def action(self, full_name: str) -> Any:
        """Return the class of ``pkg/action/Name`` with Goal, Result, Feedback and Impl."""
        if full_name not in self._interfaces:
            package, kind, _ = split_name(full_name)
            goal, result, feedback = parse_file(self.path(full_name), package, kind)
            self._interfaces[full_name] = self._make_action(full_name, goal, result, feedback)
        return self._interfaces[full_name]

    def _make_action(self, name: str, goal: MessageText, result: MessageText, feedback: MessageText) -> Any:
        parts = {"Goal": self._add(goal), "Result": self._add(result), "Feedback": self._add(feedback)}
        send_goal = self._make_service(
            f"{name}_SendGoal",
            MessageText(f"{name}_SendGoal_Request", (Field("goal_id", _UUID), Field("goal", FieldType(goal.name)))),
            MessageText(f"{name}_SendGoal_Response", (Field("accepted", FieldType("bool")), Field("stamp", _TIME))),
        )
        get_result = self._make_service(
            f"{name}_GetResult",
            MessageText(f"{name}_GetResult_Request", (Field("goal_id", _UUID),)),
            MessageText(
                f"{name}_GetResult_Response",
                (Field("status", FieldType("int8")), Field("result", FieldType(result.name))),
            ),
        )
        message = self._add(
            MessageText(
                f"{name}_FeedbackMessage", (Field("goal_id", _UUID), Field("feedback", FieldType(feedback.name)))
            )
        )
        self._messages[send_goal.DEFINITION.text.name] = send_goal
        self._messages[get_result.DEFINITION.text.name] = get_result
        whole = MessageText(
            name,
            tuple(
                Field(field, FieldType(f"{name}{suffix}"))
                for field, suffix in (
                    ("goal", "_Goal"), ("result", "_Result"), ("feedback", "_Feedback"),
                    ("send_goal_service", "_SendGoal"), ("get_result_service", "_GetResult"),
                    ("feedback_message", "_FeedbackMessage"),
                )
            ),
        )  # fmt: skip
        made: Any = self._make_interface(whole, parts)
        package, _, short = split_name(name)
        made.Impl = type(
            "Impl",
            (),
            {
                "__module__": f"{package}.action",
                "__qualname__": f"{short}.Impl",
                "SendGoalService": send_goal,
                "GetResultService": get_result,
                "FeedbackMessage": message,
                "CancelGoalService": self.service("action_msgs/srv/CancelGoal"),
                "GoalStatusMessage": self.message("action_msgs/msg/GoalStatusArray"),
            },
        )
        return made

    def interface(self, full_name: str) -> Any:
        """Return the class of any ``pkg/kind/Name``; ``pkg/Name`` is looked for as msg, srv, action in this order."""
        package, kind, name = split_name(full_name, self)
        requested = f"{package}/{kind}/{name}"
        return {"msg": self.message, "srv": self.service, "action": self.action}[kind](requested)


def _refuse_instance(cls: type, *_: object, **__: object) -> Any:
    raise NotImplementedError(f"{cls.__name__} can not be instantiated; use its parts, such as {cls.__name__}.Request")


def split_name(full_name: str, known: Registry | None = None) -> tuple[str, str, str]:
    """Split ``pkg/kind/Name``; with a registry also ``pkg/Name``, whose kind is then looked up."""
    parts = full_name.split("/")
    if len(parts) == 3 and parts[1] in KINDS and all(parts):
        return parts[0], parts[1], parts[2]
    if len(parts) == 2 and all(parts) and known is not None:
        for kind in KINDS:
            if parts[1] in known.names(parts[0], kind):
                return parts[0], kind, parts[1]
        raise UnknownInterfaceError(f"{full_name} is not defined; give pkg/msg/Name, pkg/srv/Name or pkg/action/Name")
    raise UnknownInterfaceError(f"expected an interface name such as std_msgs/msg/String, found {full_name!r}")


@functools.cache
def registry() -> Registry:
    """Return the registry of this process."""
    return Registry()
