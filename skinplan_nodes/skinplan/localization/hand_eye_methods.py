"""The published closed forms of hand-eye calibration, for a camera beside the arm.

OpenCV 5 no longer exports its functions for them to Python, so they are written out here. With the
flange F = T_b_t, the marker in the camera M = T_c_m, the wanted X = T_b_c and the marker on the
flange Z = T_t_m, every stand says F Z = X M; two stands say A X = X B with A = F_j F_i^-1 and
B = M_j M_i^-1.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from skinplan.transforms import Array, inverse, transform

Solver = Callable[[Array, Array], Array]
# Stands are paired with so many of the following ones.
_PARTNERS = 12


def park(flange: Array, marker: Array) -> Array:
    """Park and Martin 1994: rotation vectors of the motions, aligned by least squares."""
    A, B = _motions(flange, marker)
    alpha, beta = _vectors(A), _vectors(B)
    return _with_place(_nearest_rotation(alpha.T @ beta), A, B)


def tsai(flange: Array, marker: Array) -> Array:
    """Tsai and Lenz 1989: modified Rodrigues vectors 2 sin(angle / 2) axis."""
    A, B = _motions(flange, marker)
    a, b = _half_sines(A), _half_sines(B)
    left = np.concatenate([_skew(row) for row in a + b])
    # [a + b]x p = b - a for the tangent p of the rotation that takes b to a.
    tangent = np.linalg.lstsq(left, (b - a).ravel(), rcond=None)[0]
    return _with_place(Rotation.from_mrp(_half_to_mrp(tangent)).as_matrix(), A, B)


def horaud(flange: Array, marker: Array) -> Array:
    """Horaud and Dornaika 1995: the unit quaternion q with a q = q b, by an eigenvector."""
    A, B = _motions(flange, marker)
    total = np.zeros((4, 4))
    for a, b in zip(_quaternions(A), _quaternions(B), strict=True):
        gap = _left(a) - _right(b)
        total += gap.T @ gap
    w, x, y, z = np.linalg.eigh(total)[1][:, 0]
    return _with_place(Rotation.from_quat([x, y, z, w]).as_matrix(), A, B)


def andreff(flange: Array, marker: Array) -> Array:
    """Andreff, Horaud and Espiau 1999: rotation and translation in one linear system."""
    A, B = _motions(flange, marker)
    count = len(A)
    # Rows first: vec(R_A R R_B^T) = (R_A kron R_B) vec(R), and R t_B + (1 - R_A) t = t_A.
    turns = np.eye(9) - np.einsum("kij,kmn->kimjn", A[:, :3, :3], B[:, :3, :3]).reshape(-1, 9, 9)
    lever = np.einsum("ij,kn->kijn", np.eye(3), B[:, :3, 3]).reshape(count, 3, 9)
    upper = np.concatenate([turns, np.zeros((count, 9, 3))], axis=2)
    lower = np.concatenate([lever, np.eye(3) - A[:, :3, :3]], axis=2)
    left = np.concatenate([upper, lower], axis=1).reshape(-1, 12)
    right = np.concatenate([np.zeros((count, 9)), A[:, :3, 3]], axis=1).ravel()
    wanted = np.linalg.lstsq(left, right, rcond=None)[0][:9].reshape(3, 3)
    # The nine numbers are free of any constraint: the place is solved anew with a true rotation.
    return _with_place(_nearest_rotation(wanted), A, B)


def daniilidis(flange: Array, marker: Array) -> Array:
    """Daniilidis 1999: the unit dual quaternion q with a q = q b, by singular vectors."""
    A, B = _motions(flange, marker)
    a, b = _quaternions(A)[:, 1:], _quaternions(B)[:, 1:]
    dual_a, dual_b = _dual_parts(A)[:, 1:], _dual_parts(B)[:, 1:]
    turn = _vector_equation(a, b)
    upper = np.concatenate([turn, np.zeros_like(turn)], axis=2)
    lower = np.concatenate([_vector_equation(dual_a, dual_b), turn], axis=2)
    v = np.linalg.svd(np.concatenate([upper, lower]).reshape(-1, 8))[2]
    first, second = v[6], v[7]
    real, dual = _unit_dual(first, second)
    w, x, y, z = real
    place = 2.0 * (_right(real * [1.0, -1.0, -1.0, -1.0]) @ dual)[1:]
    return transform(place, Rotation.from_quat([x, y, z, w]).as_matrix())


def shah(flange: Array, marker: Array) -> Array:
    """Shah 2013: the rotation from the first singular vector of a sum of Kronecker products."""
    K = sum(np.kron(M[:3, :3], F[:3, :3]) for F, M in zip(flange, marker, strict=True))
    u = np.linalg.svd(np.asarray(K))[0]
    # Columns first: vec(R_X) = (R_M kron R_F) vec(R_Z).
    wanted = u[:, 0].reshape(3, 3).T
    sign = np.sign(np.linalg.det(wanted)) or 1.0
    wanted = _nearest_rotation(sign * wanted)
    left = np.concatenate([np.hstack([np.eye(3), -F[:3, :3]]) for F in flange])
    right = np.concatenate(
        [F[:3, 3] - wanted @ M[:3, 3] for F, M in zip(flange, marker, strict=True)]
    )
    place = np.linalg.lstsq(left, right, rcond=None)[0][:3]
    return transform(place, wanted)


def refined(flange: Array, marker: Array) -> Array:
    """Least squares over X and Z of all stands at once, from Shah's; a radian weighs as a metre."""
    start = shah(flange, marker)
    on_tool = inverse(flange[0]) @ start @ marker[0]

    def gaps(values: Array) -> Array:
        X = _placed(start, values[:6])
        Z = _placed(on_tool, values[6:])
        delta = inverse(flange @ Z) @ (X @ marker)
        turns = Rotation.from_matrix(delta[:, :3, :3]).as_rotvec()
        return np.concatenate([delta[:, :3, 3].ravel(), turns.ravel()])

    found = least_squares(gaps, np.zeros(12), method="lm")
    return _placed(start, found.x[:6])


#: Solvers by name: flange poses and marker poses, shape (n, 4, 4) each, to T_b_c, shape (4, 4).
SOLVERS: dict[str, Solver] = {
    "TSAI": tsai,
    "PARK": park,
    "HORAUD": horaud,
    "ANDREFF": andreff,
    "DANIILIDIS": daniilidis,
    "SHAH": shah,
    "REFINED": refined,
}


def _motions(flange: Array, marker: Array) -> tuple[Array, Array]:
    """Returns A and B of pairs of stands, shape (k, 4, 4) each."""
    count = len(flange)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, min(i + 1 + _PARTNERS, count))]
    first, second = np.array(pairs).T
    return flange[second] @ inverse(flange[first]), marker[second] @ inverse(marker[first])


def _with_place(rotation: Array, A: Array, B: Array) -> Array:
    """Solves (R_A - 1) t = R t_B - t_A."""
    left = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (B[:, :3, 3] @ rotation.T - A[:, :3, 3]).ravel()
    return transform(np.linalg.lstsq(left, right, rcond=None)[0], rotation)


def _nearest_rotation(matrix: Array) -> Array:
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)


def _vectors(motions: Array) -> Array:
    return np.asarray(Rotation.from_matrix(motions[:, :3, :3]).as_rotvec())


def _half_sines(motions: Array) -> Array:
    """Returns 2 sin(angle / 2) axis of rotations, shape (k, 3)."""
    return 2.0 * _quaternions(motions)[:, 1:]


def _half_to_mrp(tangent: Array) -> Array:
    """Turns tan(angle / 2) axis into tan(angle / 4) axis."""
    return np.asarray(tangent / (1.0 + np.sqrt(1.0 + tangent @ tangent)))


def _quaternions(motions: Array) -> Array:
    """Returns unit quaternions (w, x, y, z) with w >= 0, shape (k, 4)."""
    found = Rotation.from_matrix(motions[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return np.where(found[:, :1] < 0.0, -found, found)


def _dual_parts(motions: Array) -> Array:
    """Returns half of t q, the dual parts of unit dual quaternions, shape (k, 4)."""
    places, turns = motions[:, :3, 3], _quaternions(motions)
    along = np.einsum("ki,ki->k", places, turns[:, 1:])
    vectors = turns[:, :1] * places + np.cross(places, turns[:, 1:])
    return 0.5 * np.concatenate([-along[:, None], vectors], axis=1)


def _vector_equation(a: Array, b: Array) -> Array:
    """Returns (a - b, [a + b]x), what the vector parts of a q = q b say of q, shape (k, 3, 4)."""
    cross = np.cross((a + b)[:, None], np.eye(3)).swapaxes(1, 2)
    return np.concatenate([(a - b)[..., None], cross], axis=2)


def _unit_dual(first: Array, second: Array) -> tuple[Array, Array]:
    """Combines two vectors (q, q') to a unit dual quaternion: q of length 1, at right angles to q'.

    Raises:
        np.linalg.LinAlgError: No combination is one.
    """
    u, v, p, r = first[:4], first[4:], second[:4], second[4:]
    # share^2 u.v + share (u.r + p.v) + p.r = 0
    roots = np.roots([u @ v, u @ r + p @ v, p @ r])
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-6 * (1.0 + abs(root))]
    if not real:
        raise np.linalg.LinAlgError("no combination of the singular vectors is a unit motion")
    share = max(real, key=lambda s: float(np.sum((s * u + p) ** 2)))
    scale = 1.0 / np.linalg.norm(share * u + p)
    return scale * (share * u + p), scale * (share * v + r)


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _left(q: Array) -> Array:
    """Returns L with L p = q p."""
    result = q[0] * np.eye(4)
    result[0, 1:], result[1:, 0] = -q[1:], q[1:]
    result[1:, 1:] += _skew(q[1:])
    return result


def _right(q: Array) -> Array:
    """Returns R with R p = p q."""
    result = q[0] * np.eye(4)
    result[0, 1:], result[1:, 0] = -q[1:], q[1:]
    result[1:, 1:] -= _skew(q[1:])
    return result


def _placed(T: Array, values: Array) -> Array:
    return np.asarray(T @ transform(values[:3], Rotation.from_rotvec(values[3:]).as_matrix()))
