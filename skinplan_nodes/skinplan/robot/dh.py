"""Arms by their table of modified Denavit-Hartenberg figures (C 2.1, Table 1).

Frame i of the modified convention stands on the axis of joint i: ``T_(i-1)_i = Rx(alpha) Tx(a)
Rz(theta) Tz(d)`` with ``a`` and ``alpha`` of the row before the joint. A slide along z and a turn
about z commute, so a row is a fixed URDF origin ``(a, -d sin alpha, d cos alpha)``, roll ``alpha``,
followed by a turn about z by theta: the joint positions of the URDF are the table's theta, and its
limits are the table's ranges. The theta that a table lists per row is the posture of its drawing.
"""

from dataclasses import dataclass
from math import cos, pi, radians, sin
from xml.etree import ElementTree

import numpy as np

from skinplan.errors import JointsInvalidError, RobotModelError
from skinplan.transforms import Array


@dataclass(frozen=True)
class DhRow:
    """One row of the table.

    Attributes:
        a_m: a_(i-1), length of the link before the joint [m].
        alpha_rad: alpha_(i-1), twist of that link [rad].
        d_m: d_i, offset along the joint's axis [m].
        drawn_rad: theta_i in the posture that the table is drawn in [rad].
        lower_rad: Lower end of the range of theta_i [rad].
        upper_rad: Upper end [rad].
    """

    a_m: float
    alpha_rad: float
    d_m: float
    drawn_rad: float
    lower_rad: float
    upper_rad: float


@dataclass(frozen=True)
class Capsule:
    """A capsule that stands for a part of a link.

    Attributes:
        start_m: One end of its axis in the link's frame, (x, y, z) [m].
        end_m: The other end [m]; the axis is parallel to x, y or z.
        radius_m: Radius [m].
    """

    start_m: tuple[float, float, float]
    end_m: tuple[float, float, float]
    radius_m: float


@dataclass(frozen=True)
class DhTable:
    """An arm of revolute joints; its flange is the frame of the last row.

    Attributes:
        name: Name of the arm.
        rows: One per joint, from the base.
    """

    name: str
    rows: tuple[DhRow, ...]

    def forward(self, theta: Array) -> Array:
        """Returns all frames in the base, shape (n, j + 1, 4, 4) [m]; number 0 is the base.

        Args:
            theta: Joint angles of the table, shape (n, j) [rad].

        Raises:
            JointsInvalidError: Shape, or a value that is not finite.
        """
        angles = np.asarray(theta, dtype=float)
        count = len(self.rows)
        if angles.ndim != 2 or angles.shape[1] != count or not np.all(np.isfinite(angles)):
            raise JointsInvalidError(
                f"finite joint angles of shape (n, {count}) are accepted, found {angles.shape}"
            )
        frames = np.empty((len(angles), count + 1, 4, 4))
        frames[:, 0] = np.eye(4)
        for number, row in enumerate(self.rows):
            frames[:, number + 1] = frames[:, number] @ _links(row, angles[:, number])
        return frames

    @property
    def drawn(self) -> Array:
        """Joint angles of the drawing, shape (j,) [rad]."""
        return np.array([row.drawn_rad for row in self.rows])


def _links(row: DhRow, theta: Array) -> Array:
    """``T_(i-1)_i`` of the modified convention, shape (n, 4, 4) [m]."""
    c, s = np.cos(theta), np.sin(theta)
    ca, sa = cos(row.alpha_rad), sin(row.alpha_rad)
    result = np.zeros((len(theta), 4, 4))
    result[:, 0, 0], result[:, 0, 1], result[:, 0, 3] = c, -s, row.a_m
    result[:, 1, 0], result[:, 1, 1], result[:, 1, 2] = s * ca, c * ca, -sa
    result[:, 2, 0], result[:, 2, 1], result[:, 2, 2] = s * sa, c * sa, ca
    result[:, 1, 3], result[:, 2, 3] = -sa * row.d_m, ca * row.d_m
    result[:, 3, 3] = 1.0
    return result


def write_urdf(
    table: DhTable,
    joints: tuple[str, ...],
    links: tuple[str, ...],
    bodies: dict[str, tuple[Capsule, ...]],
    velocity_rad_s: float,
    remark: str = "",
) -> str:
    """Writes an arm as URDF that `skinplan.robot.arm.ArmModel` reads.

    Args:
        table: The arm.
        joints: Names of the joints.
        links: Names of the links, one more than joints; number 0 is the base.
        bodies: Capsules by link, written as cylinders of the same axis and radius.
        velocity_rad_s: Velocity limit of all joints [rad/s].
        remark: A comment at the head of the file.

    Returns:
        The text of the file.

    Raises:
        RobotModelError: Names that do not fit the table, or bodies of a link that is not there.
    """
    if len(joints) != len(table.rows) or len(links) != len(joints) + 1 or set(bodies) - set(links):
        raise RobotModelError(
            f"{len(table.rows)} joints, one link more and bodies of these links are accepted for "
            f"{table.name!r}, found {len(joints)} joints, {len(links)} links, bodies of "
            f"{sorted(bodies)}"
        )
    robot = ElementTree.Element("robot", name=table.name)
    _add_link(robot, links[0], bodies.get(links[0], ()))
    for number, (row, joint) in enumerate(zip(table.rows, joints, strict=True)):
        _add_joint(robot, joint, links[number], links[number + 1], row, velocity_rad_s)
        _add_link(robot, links[number + 1], bodies.get(links[number + 1], ()))
    flange = ElementTree.SubElement(robot, "joint", name="flange_joint", type="fixed")
    ElementTree.SubElement(flange, "parent", link=links[-1])
    ElementTree.SubElement(flange, "child", link="tool0")
    ElementTree.SubElement(robot, "link", name="tool0")
    ElementTree.indent(robot)
    head = '<?xml version="1.0"?>\n' + (f"<!-- {remark} -->\n" if remark else "")
    return head + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_joint(
    robot: ElementTree.Element, name: str, parent: str, child: str, row: DhRow, velocity: float
) -> None:
    joint = ElementTree.SubElement(robot, "joint", name=name, type="revolute")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    place = (row.a_m, -sin(row.alpha_rad) * row.d_m, cos(row.alpha_rad) * row.d_m)
    ElementTree.SubElement(joint, "origin", xyz=_text(*place), rpy=_text(row.alpha_rad, 0.0, 0.0))
    ElementTree.SubElement(joint, "axis", xyz="0 0 1")
    ElementTree.SubElement(
        joint,
        "limit",
        lower=_text(row.lower_rad),
        upper=_text(row.upper_rad),
        velocity=_text(velocity),
        effort="100",
    )


def _add_link(robot: ElementTree.Element, name: str, bodies: tuple[Capsule, ...]) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    turns = {0: (0.0, 0.5 * pi, 0.0), 1: (0.5 * pi, 0.0, 0.0), 2: (0.0, 0.0, 0.0)}
    for body in bodies:
        start, end = np.array(body.start_m), np.array(body.end_m)
        along = int(np.argmax(np.abs(end - start)))
        if np.count_nonzero(np.abs(end - start) > 1e-12) > 1:
            raise RobotModelError(
                f"a capsule of {name!r}: axes parallel to x, y or z are accepted, found "
                f"{body.start_m} to {body.end_m}"
            )
        collision = ElementTree.SubElement(link, "collision")
        middle = 0.5 * (start + end)
        ElementTree.SubElement(collision, "origin", xyz=_text(*middle), rpy=_text(*turns[along]))
        geometry = ElementTree.SubElement(collision, "geometry")
        length = _text(float(np.linalg.norm(end - start)))
        ElementTree.SubElement(geometry, "cylinder", length=length, radius=_text(body.radius_m))


def _text(*values: float) -> str:
    # Sixteen digits keep a half turn to the last bit; sums such as 0.1 + 0.2 need no more.
    return " ".join(f"{float(value) + 0.0:.16g}" for value in values)


def _row(a: float, alpha: float, d: float, drawn: float, lower: float, upper: float) -> DhRow:
    turns = (radians(drawn), radians(lower), radians(upper))
    return DhRow(a / 1000.0, radians(alpha), d / 1000.0, *turns)


#: SIASUN GCR14-1400, Table 1 of C (there in mm and degrees).
GCR14_1400 = DhTable(
    "gcr14_1400",
    (
        _row(0.0, 0.0, 160.5, 0.0, -180.0, 180.0),
        _row(0.0, -90.0, 0.0, -90.0, -270.0, 90.0),
        _row(650.0, 0.0, 0.0, 0.0, -160.0, 160.0),
        _row(612.5, 0.0, 146.5, 90.0, -90.0, 270.0),
        _row(0.0, 90.0, 137.5, 0.0, -180.0, 180.0),
        _row(0.0, -90.0, 116.7, 0.0, -180.0, 180.0),
    ),
)
