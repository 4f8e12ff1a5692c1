"""A robot's description for those that draw it: what is seen is what collisions are checked with.

The model's URDF has collision bodies and no visual ones; viewers draw visual ones.
"""

import copy
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from skinplan.errors import RobotModelError
from skinplan.robot.cell_model import CellConfig
from skinplan.transforms import Array

_MODELS = Path(__file__).parent / "models"
_ARM_COLOUR = "0.75 0.78 0.82 1"
_SCANNER_COLOUR = "0.95 0.55 0.15 1"


class DrawnRobot:
    """The arm of a cell with the scanner on its flange.

    Args:
        cell: The cell.

    Attributes:
        text: URDF with visual bodies.
        root: Name of its root link.

    Raises:
        RobotModelError: The cell's model can't be read.
    """

    def __init__(self, cell: CellConfig) -> None:
        name = cell.robot
        path = Path(name) if name.endswith(".urdf") else _MODELS / f"{name}.urdf"
        try:
            robot = ElementTree.parse(path).getroot()
        except (OSError, ElementTree.ParseError) as error:
            raise RobotModelError(f"{path} can't be read as URDF: {error}") from error
        self._joints = [_Joint(element) for element in robot.iter("joint")]
        children = {joint.child for joint in self._joints}
        (self.root,) = {joint.parent for joint in self._joints} - children
        for link in robot.iter("link"):
            _add_visuals(link)
        _add_scanner(robot, cell)
        self.text = ElementTree.tostring(robot, encoding="unicode")

    def links(self, positions: dict[str, float]) -> list[tuple[str, str, Array]]:
        """Returns parent, child and ``T_parent_child``, shape (4, 4) [m], of every joint.

        Args:
            positions: Joint -> position [rad]; joints that are left out are at zero.
        """
        return [
            (joint.parent, joint.child, joint.transform(positions.get(joint.name, 0.0)))
            for joint in self._joints
        ]


class _Joint:
    def __init__(self, element: ElementTree.Element) -> None:
        self.name = element.get("name", "")
        self.parent = _required(element, "parent").get("link", "")
        self.child = _required(element, "child").get("link", "")
        self._turns = element.get("type") in ("revolute", "continuous")
        origin, axis = element.find("origin"), element.find("axis")
        self._origin = np.eye(4)
        if origin is not None:
            self._origin[:3, :3] = _from_rpy(*_numbers(origin, "rpy"))
            self._origin[:3, 3] = _numbers(origin, "xyz")
        found = np.array([1.0, 0.0, 0.0] if axis is None else _numbers(axis, "xyz"))
        self._axis = found / max(float(np.linalg.norm(found)), 1e-12)

    def transform(self, position: float) -> Array:
        turned = np.eye(4)
        if self._turns:
            x, y, z = self._axis
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            turned[:3, :3] += np.sin(position) * cross + (1.0 - np.cos(position)) * cross @ cross
        return np.asarray(self._origin @ turned)


def _required(element: ElementTree.Element, name: str) -> ElementTree.Element:
    found = element.find(name)
    if found is None:
        raise RobotModelError(f"a joint {element.get('name')!r} without {name} was found")
    return found


def _numbers(element: ElementTree.Element, name: str) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in element.get(name, "0 0 0").split())
    return x, y, z


def _from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation of URDF: about the fixed x, then y, then z."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _add_visuals(link: ElementTree.Element) -> None:
    if link.find("visual") is not None:
        return
    for body in link.findall("collision"):
        visual = copy.deepcopy(body)
        visual.tag = "visual"
        visual.append(_material("arm", _ARM_COLOUR))
        link.append(visual)


def _add_scanner(robot: ElementTree.Element, cell: CellConfig) -> None:
    """Adds the scanner's body; its frame is that of ``tf``."""
    link = ElementTree.SubElement(robot, "link", name="scanner")
    visual = ElementTree.SubElement(link, "visual")
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, "sphere", radius=f"{cell.scanner_radius_m:g}")
    visual.append(_material("scanner", _SCANNER_COLOUR))
    joint = ElementTree.SubElement(robot, "joint", name="scanner_joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link="tool0")
    ElementTree.SubElement(joint, "child", link="scanner")
    T = cell.T_tool0_scanner
    rpy = (
        np.arctan2(T[2, 1], T[2, 2]),
        np.arctan2(-T[2, 0], np.hypot(T[2, 1], T[2, 2])),
        np.arctan2(T[1, 0], T[0, 0]),
    )
    text = (" ".join(f"{value:.9g}" for value in T[:3, 3]), " ".join(f"{v:.9g}" for v in rpy))
    ElementTree.SubElement(joint, "origin", xyz=text[0], rpy=text[1])


def _material(name: str, rgba: str) -> ElementTree.Element:
    material = ElementTree.Element("material", name=name)
    ElementTree.SubElement(material, "color", rgba=rgba)
    return material
