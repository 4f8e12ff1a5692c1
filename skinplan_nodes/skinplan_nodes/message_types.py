"""Types by name: their classes and their definitions, from the installed interface packages."""

import functools
import importlib
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

# How rclpy keeps the messages that an action derives: suffix of the type -> attributes.
_ACTION_TYPES = {"_FeedbackMessage": ("Impl", "FeedbackMessage")}
_SUFFIXES = {"msg": ".msg", "srv": ".srv", "action": ".action"}


@functools.cache
def message_class(type_name: str) -> Any:
    """Returns the class of a message type.

    Args:
        type_name: E.g. ``std_msgs/msg/Header`` or
            ``nav2_msgs/action/NavigateToPose_FeedbackMessage``.

    Raises:
        LookupError: The package is not installed, or has no such message.
    """
    parts = type_name.split("/")
    if len(parts) != 3:
        raise LookupError(f"a type as package/msg/Name is accepted, found {type_name!r}")
    package, kind, name = parts
    attributes: tuple[str, ...] = (name,)
    for suffix, inner in _ACTION_TYPES.items():
        if kind == "action" and name.endswith(suffix):
            attributes = (name.removesuffix(suffix), *inner)
    try:
        found: Any = importlib.import_module(f"{package}.{kind}")
        for attribute in attributes:
            found = getattr(found, attribute)
    except (ImportError, AttributeError) as error:
        raise LookupError(f"type {type_name} is not installed ({error})") from error
    return found


def definition_text(type_name: str) -> str:
    """Returns the text of a definition, e.g. of ``std_msgs/msg/Header``.

    Raises:
        LookupError: The package is not installed.
        OSError: It has no such file.
    """
    package, kind, name = type_name.split("/")
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError) as error:
        raise LookupError(f"package {package} is not installed") from error
    return (share / kind / f"{name}{_SUFFIXES[kind]}").read_text(encoding="utf-8")
