"""Parameters of the nodes: declared from one table with description, unit and range."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

Value = bool | int | float | str | list[str]
Config = TypeVar("Config")

# Bounds where a range has only one side.
_GREATEST_FLOAT = 1e308
_GREATEST_INT = 2**62


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node.

    Attributes:
        name: Name, with the unit as suffix where the value has one.
        default: Value that holds when nothing else is given; its type is the parameter's type. An
            empty list of texts is written ``[""]``: ROS can't tell the type of an empty list.
        description: One sentence with the unit in brackets, and what empty means.
        minimum: Least value accepted; None = no bound. Numbers only.
        maximum: Greatest value accepted; None = no bound. Numbers only.
        read_only: Fixed once the node runs.
    """

    name: str
    default: Value
    description: str
    minimum: float | None = None
    maximum: float | None = None
    read_only: bool = True

    def descriptor(self) -> ParameterDescriptor:
        """Returns description, range and read-only flag as ROS declares them."""
        found = ParameterDescriptor(
            name=self.name, description=self.description, read_only=self.read_only
        )
        if self.minimum is None and self.maximum is None:
            return found
        if isinstance(self.default, float):
            low = -_GREATEST_FLOAT if self.minimum is None else float(self.minimum)
            high = _GREATEST_FLOAT if self.maximum is None else float(self.maximum)
            found.floating_point_range = [
                FloatingPointRange(from_value=low, to_value=high, step=0.0)
            ]
        else:
            least = -_GREATEST_INT if self.minimum is None else int(self.minimum)
            most = _GREATEST_INT if self.maximum is None else int(self.maximum)
            found.integer_range = [IntegerRange(from_value=least, to_value=most, step=1)]
        return found


#: Of the nodes that need the cell's figures.
CELL_FILE = Parameter("cell_file", "", "Absolute path of the cell file; empty = the default cell.")
MESHES_KEPT = Parameter("meshes_kept", 4, "Prepared meshes that are kept in memory [1].", 1, 32)


def declare(node: Node, table: Iterable[Parameter]) -> SimpleNamespace:
    """Declares the parameters of a table.

    Args:
        node: The node.
        table: Its parameters.

    Returns:
        The values by name; lists of texts without empty ones.

    Raises:
        rclpy.exceptions.InvalidParameterTypeException: A value has another type than its default.
        rclpy.exceptions.InvalidParameterValueException: A value is out of range.
    """
    for parameter in table:
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())
    return read(node, table)


def read(node: Node, table: Iterable[Parameter]) -> SimpleNamespace:
    """Returns the values of declared parameters by name; lists of texts without empty ones."""
    found = {}
    for parameter in table:
        value: Any = node.get_parameter(parameter.name).value
        found[parameter.name] = (
            [item for item in value if item] if isinstance(parameter.default, list) else value
        )
    return SimpleNamespace(**found)


def load(values: SimpleNamespace, config: type[Config]) -> Config:
    """Makes a configuration of parameters.

    Args:
        values: Parameters by name; those that are no fields of the configuration are left out.
        config: Frozen dataclass whose fields have the parameters' names.
    """
    names = {field.name for field in fields(config)}  # type: ignore[arg-type]
    return config(**{name: value for name, value in vars(values).items() if name in names})
