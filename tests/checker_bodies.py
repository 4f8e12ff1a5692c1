"""For the trajectory checker: the arm by Pinocchio, straight from its URDF, and collisions by coal.

Nothing of the planner's kinematics or collision check is used but data: the model file, the
capsules' sizes, and which pairs of links are left out.
"""

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

import skinplan.robot
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell_check import PEDESTAL_RADIUS_M
from skinplan.robot.collision import FIXTURE_DEPTH_M
from skinplan.transforms import inverse

MODELS = Path(skinplan.robot.__file__).parent / "models"
FLOOR_M = 10.0  # a floor so wide, and so thick
SCANNER_ORDER = 7


class UrdfArm:
    """Forward kinematics and limits as the URDF says them."""

    def __init__(self, cell):
        path = cell.robot if cell.robot.endswith(".urdf") else str(MODELS / f"{cell.robot}.urdf")
        self.model = pin.buildModelFromUrdf(path)
        self._data = self.model.createData()
        self._tool0 = self.model.getFrameId("tool0")
        self._T_tool0_scanner = cell.T_tool0_scanner
        self.lower = self.model.lowerPositionLimit
        self.upper = self.model.upperPositionLimit
        self.velocity = np.minimum(self.model.velocityLimit, cell.velocity_max_rad_s)

    def scanner(self, q):
        """T_arm_base_scanner, shape (n, 4, 4)."""
        found = np.empty((len(q), 4, 4))
        for number, one in enumerate(q):
            pin.framesForwardKinematics(self.model, self._data, one)
            found[number] = self._data.oMf[self._tool0].homogeneous
        return found @ self._T_tool0_scanner

    def joints(self, q):
        """Joint frames in the arm base, shape (n, 7, 4, 4); number 0 is the base."""
        found = np.empty((len(q), 7, 4, 4))
        for number, one in enumerate(q):
            pin.forwardKinematics(self.model, self._data, one)
            for joint in range(7):
                found[number, joint] = self._data.oMi[joint].homogeneous
        return found

    def branch(self, q):
        """Expressions whose signs tell the branches of a UR arm apart, shape (n, 3).

        Shoulder: how far in front of the first axis the wrist is, across the shoulder's lift axis;
        elbow and wrist: the sines of their joints. Each vanishes where two branches meet.
        """
        shoulder = np.empty(len(q))
        for number, one in enumerate(q):
            pin.forwardKinematics(self.model, self._data, one)
            lift, wrist = self._data.oMi[2], self._data.oMi[5]
            ahead = np.cross(lift.rotation[:, 2], [0.0, 0.0, 1.0])
            shoulder[number] = ahead @ (wrist.translation - lift.translation)
        return np.stack([shoulder, np.sin(q[:, 2]), np.sin(q[:, 4])], axis=1)


class Surroundings:
    """Arm and scanner against themselves, base, pedestal, floor, obstacles, part and fixture.

    Everything keeps half the cell's margin (a planner that keeps the whole one at the places that
    it looks at may come a little nearer in between), but for links among each other, whose capsules
    only must not meet.
    """

    def __init__(self, cell, mesh, T_arm_base_workpiece, T_arm_base_map):
        arm = ArmModel.load(cell)
        zero = UrdfArm(cell)
        tool = np.linalg.inv(zero.joints(np.zeros((1, 6)))[0, 6]) @ zero.scanner(np.zeros((1, 6)))
        self.names = [*(body.link for body in arm.bodies), "scanner"]
        self.joint = np.array([*(body.joint for body in arm.bodies), 6])
        order = np.array([*(body.joint for body in arm.bodies), SCANNER_ORDER])
        ends = [*(body.ends for body in arm.bodies), np.tile(tool[0, :3, 3], (2, 1))]
        radii = [*(body.radius for body in arm.bodies), cell.scanner_radius_m]
        self._shapes = [_capsule(e, r) for e, r in zip(ends, radii, strict=True)]
        self._places = np.array([_along(e) for e in ends])
        self._reach = np.array(
            [0.5 * np.linalg.norm(e[1] - e[0]) + r for e, r in zip(ends, radii, strict=True)]
        )
        self.margin = 0.5 * cell.collision_margin_m
        self._pairs = [
            (a, b, self.margin if order[b] == SCANNER_ORDER else 0.0)
            for a in range(len(order))
            for b in range(a + 1, len(order))
            if abs(order[a] - order[b]) > 1
            and frozenset((self.names[a], self.names[b])) not in arm.pairs_left_out
        ]
        self._things = _cell_things(cell, T_arm_base_map, np.flatnonzero(order >= 2))
        self._things += _part_things(mesh, T_arm_base_workpiece, np.arange(len(order)))

    def first_contact(self, joints):
        """Names what meets first in a series of joint frames, (n, 7, 4, 4), and where; or None."""
        places = joints[:, self.joint] @ self._places
        middles = places[:, :, :3, 3]
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        for name, shape, box, bodies in self._things:
            middle = (middles[:, bodies] - box.place[:3, 3]) @ box.place[:3, :3]
            outside = np.maximum(np.abs(middle) - box.half, 0.0)
            near = np.linalg.norm(outside, axis=2) < self._reach[bodies] + self.margin
            request.security_margin = self.margin
            T_thing = _placed(box.shape_place)
            for row, column in np.argwhere(near):
                body = bodies[column]
                result.clear()
                place = _placed(places[row, body])
                if coal.collide(self._shapes[body], place, shape, T_thing, request, result):
                    return f"{self.names[body]} with {name}", int(row)
        return self._self_contact(places, middles)

    def _self_contact(self, places, middles):
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        for a, b, margin in self._pairs:
            gap = np.linalg.norm(middles[:, a] - middles[:, b], axis=1)
            request.security_margin = margin
            for row in np.flatnonzero(gap < self._reach[a] + self._reach[b] + margin):
                result.clear()
                one, other = _placed(places[row, a]), _placed(places[row, b])
                if coal.collide(self._shapes[a], one, self._shapes[b], other, request, result):
                    return f"{self.names[a]} with {self.names[b]}", int(row)
        return None


class _Bounds:
    """A box about a thing, in the arm base, and where the thing's shape itself is placed."""

    def __init__(self, place, half, shape_place=None):
        self.place, self.half = place, np.asarray(half)
        self.shape_place = place if shape_place is None else shape_place


def _cell_things(cell, T_arm_base_map, bodies):
    T_arm_base = inverse(cell.T_base_link_arm_base)
    size = np.array(cell.base_size_m)

    def boxed(name, T_arm_box, extents):
        return name, coal.Box(*extents), _Bounds(T_arm_box, 0.5 * np.array(extents)), bodies

    def at(x, y, z):
        place = np.eye(4)
        place[:3, 3] = x, y, z
        return T_arm_base @ place

    arm = cell.T_base_link_arm_base[:3, 3]
    foot, top = size[2], max(arm[2] - PEDESTAL_RADIUS_M, size[2])
    pedestal = np.array([[*arm[:2], foot], [*arm[:2], top]])
    half = [PEDESTAL_RADIUS_M, PEDESTAL_RADIUS_M, 0.5 * (top - foot) + PEDESTAL_RADIUS_M]
    post = _Bounds(T_arm_base @ _along(pedestal), half)
    things = [
        boxed("the floor", at(0.0, 0.0, -0.5 * FLOOR_M), (FLOOR_M, FLOOR_M, FLOOR_M)),
        boxed("the base", at(0.0, 0.0, 0.5 * size[2]), size),
        ("the pedestal", _capsule(pedestal, PEDESTAL_RADIUS_M), post, bodies),
    ]
    if T_arm_base_map is not None:
        things += [boxed(o.name, T_arm_base_map @ o.T_map_box, o.size_m) for o in cell.obstacles]
    return things


def _part_things(mesh, T_arm_base_workpiece, bodies):
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(np.ascontiguousarray(mesh.vertices, dtype=float))
    model.addTriangles(np.ascontiguousarray(mesh.faces, dtype=np.int64))
    model.endModel()
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)

    def around(lower, upper):
        place = np.eye(4)
        place[:3, 3] = 0.5 * (lower + upper)
        return T_arm_base_workpiece @ place, 0.5 * (upper - lower)

    # The fixture: the outline of the part's bounding box, from its lowest point down along -z.
    behind = around(low - [0.0, 0.0, FIXTURE_DEPTH_M], np.append(high[:2], low[2]))
    return [
        ("the fixture", coal.Box(*(2.0 * behind[1])), _Bounds(*behind), bodies),
        ("the part", model, _Bounds(*around(low, high), T_arm_base_workpiece), bodies),
    ]


def _capsule(ends, radius):
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return coal.Sphere(radius) if length < 1e-9 else coal.Capsule(radius, length)


def _along(ends):
    """The frame whose z axis runs along an axis, its origin in the middle, shape (4, 4)."""
    place = np.eye(4)
    place[:3, 3] = 0.5 * (ends[0] + ends[1])
    way = ends[1] - ends[0]
    length = np.linalg.norm(way)
    if length > 1e-9:
        z = way / length
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        place[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return place


def _placed(T):
    return coal.Transform3s(T[:3, :3], T[:3, 3])
