"""Schema text of a ROS type with its dependencies, encoding ``ros2msg``.

It is composed from the definitions of the interfaces. Actions and services have types that no file
describes (a feedback message, a service event): their text is composed too.
"""

import re
from collections.abc import Callable

from skinplan.errors import BagNotWritableError

# Gets "std_msgs/msg/Header", "nav2_msgs/action/NavigateToPose" or "std_srvs/srv/Trigger"; returns
# the definition's text.
Loader = Callable[[str], str]

SEPARATOR = "=" * 80
_NUMBERS = {f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)}
_PRIMITIVES = _NUMBERS | {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
_FIELD = re.compile(r"^(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")
_GOAL_ID = "unique_identifier_msgs/UUID goal_id\n"
_EVENT = (
    "service_msgs/ServiceEventInfo info\n{package}/{name}_Request[<=1] "
    "request\n{package}/{name}_Response[<=1] response\n"
)
# Types that an action derives: suffix -> text.
_ACTION_TYPES = {
    "_FeedbackMessage": _GOAL_ID + "{package}/{name}_Feedback feedback\n",
    "_SendGoal_Request": _GOAL_ID + "{package}/{name}_Goal goal\n",
    "_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    "_SendGoal_Event": _EVENT.replace("{name}", "{name}_SendGoal"),
    "_GetResult_Request": _GOAL_ID,
    "_GetResult_Response": "int8 status\n{package}/{name}_Result result\n",
    "_GetResult_Event": _EVENT.replace("{name}", "{name}_GetResult"),
}
# Types that are a section of an action's or service's file: suffix -> number of the section.
_ACTION_SECTIONS = {"_Goal": 0, "_Result": 1, "_Feedback": 2}
_SERVICE_SECTIONS = {"_Request": 0, "_Response": 1}


def schema_with_dependencies(type_name: str, load: Loader) -> str:
    """Composes the schema of a type as rosbag2 keeps it.

    Args:
        type_name: ROS type, e.g. ``std_msgs/msg/Header`` or
            ``nav2_msgs/action/NavigateToPose_FeedbackMessage``.
        load: Returns the text of a definition; may raise `LookupError` or `OSError`.

    Returns:
        The type's own text, then for each dependency a line of 80 ``=``, ``MSG: package/Type`` and
        its text; dependencies
        in the order in which they are first used.

    Raises:
        BagNotWritableError: A definition is missing or the name is none of a ROS type.
    """
    text = definition(type_name, load)
    found: dict[str, str] = {}
    waiting = _dependencies(type_name, text)
    while waiting:
        name = waiting.pop(0)
        if name not in found and name != type_name:
            found[name] = definition(name, load)
            waiting.extend(_dependencies(name, found[name]))
    parts = [text.rstrip("\n") + "\n"]
    for name, dependency in found.items():
        package, _, short = name.split("/")
        parts.append(f"{SEPARATOR}\nMSG: {package}/{short}\n{dependency.rstrip()}\n")
    return "".join(parts)


def definition(type_name: str, load: Loader) -> str:
    """Returns the text of one type without its dependencies; see `schema_with_dependencies`."""
    parts = type_name.split("/")
    if len(parts) != 3 or not all(parts):
        raise BagNotWritableError(
            f"the definition of {type_name!r} was asked for; a type as package/msg/Name is accepted"
        )
    package, kind, name = parts
    if kind == "action":
        return _derived(package, kind, name, _ACTION_TYPES, _ACTION_SECTIONS, load)
    if kind == "srv":
        return _derived(package, kind, name, {"_Event": _EVENT}, _SERVICE_SECTIONS, load)
    return _loaded(type_name, load)


def _derived(
    package: str,
    kind: str,
    name: str,
    composed: dict[str, str],
    sections: dict[str, int],
    load: Loader,
) -> str:
    for suffix, template in composed.items():
        if name.endswith(suffix):
            return template.format(package=package, name=name[: -len(suffix)])
    for suffix, number in sections.items():
        if name.endswith(suffix):
            text = _loaded(f"{package}/{kind}/{name[: -len(suffix)]}", load)
            pieces = re.split(r"^---[^\S\n]*$\n?", text, flags=re.MULTILINE)
            if len(pieces) == len(sections):
                return pieces[number]
            raise BagNotWritableError(
                f"{package}/{kind}/{name}: {len(sections)} sections separated by --- are "
                f"accepted, found {len(pieces)}"
            )
    raise BagNotWritableError(
        f"{package}/{kind}/{name} is no type that can be recorded; one that ends in "
        f"{', '.join([*composed, *sections])} is accepted"
    )


def _loaded(type_name: str, load: Loader) -> str:
    try:
        return load(type_name).replace("\r\n", "\n")
    except (LookupError, OSError, UnicodeError) as error:
        raise BagNotWritableError(
            f"the definition of {type_name} was asked for, but is not installed ({error})"
        ) from error


def _dependencies(type_name: str, text: str) -> list[str]:
    package, kind, _ = type_name.split("/")
    names = []
    for line in text.splitlines():
        match = _FIELD.match(line.strip())
        if match and match["type"] not in _PRIMITIVES:
            names.append(_full_name(match["type"], package, kind))
    return list(dict.fromkeys(names))


def _full_name(used: str, package: str, kind: str) -> str:
    parts = used.split("/")
    if len(parts) == 3:
        return used
    if len(parts) == 1:
        return f"{package}/msg/{used}"
    # A field of an action's or service's derived type that names a sibling, e.g. a feedback: no
    # message of that name.
    derived = kind != "msg" and parts[0] == package
    suffixes = (
        {**_ACTION_TYPES, **_ACTION_SECTIONS}
        if kind == "action"
        else {**_SERVICE_SECTIONS, "_Event": ""}
    )
    if derived and parts[1].endswith(tuple(suffixes)):
        return f"{package}/{kind}/{parts[1]}"
    return f"{parts[0]}/msg/{parts[1]}"
