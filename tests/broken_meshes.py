"""Meshes with known defects for the tests of the mesh doctor."""

import numpy as np

from meshes import bump, grid, groove, half_cylinder, joined, moved, without
from skinplan.mesh.load import merge_vertices
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import transform


def panel():
    """A saddle of 1.0 x 0.6 m without any defect, 480 faces."""
    return grid(1.0, 0.6, 0.05, lambda x, y: 0.1 * np.sin(2 * x) * y)


def merged(mesh):
    return SurfaceMesh(*merge_vertices(mesh.vertices.round(9), mesh.faces))


def with_faces(mesh, *faces):
    return SurfaceMesh(mesh.vertices, np.concatenate([mesh.faces, np.array(faces)]))


def flipped(mesh, which):
    faces = mesh.faces.copy()
    faces[which] = faces[which][:, ::-1]
    return SurfaceMesh(mesh.vertices, faces)


def shuffled(mesh, seed):
    """The same faces in another order, their corners rolled, the vertices renumbered."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(mesh.vertices))
    rank = np.argsort(order)
    faces = rank[mesh.faces[rng.permutation(len(mesh.faces))]]
    rolls = rng.integers(0, 3, len(faces))
    faces = faces[np.arange(len(faces))[:, None], (np.arange(3) + rolls[:, None]) % 3]
    return SurfaceMesh(mesh.vertices[order], faces)


def soup(mesh, noise=0.0, seed=0):
    """Every face with vertices of its own, moved by up to `noise`."""
    rng = np.random.default_rng(seed)
    corners = mesh.corners.reshape(-1, 3)
    corners = corners + rng.uniform(-noise, noise, corners.shape)
    return SurfaceMesh(corners, np.arange(len(corners)).reshape(-1, 3))


def kept(mesh, faces):
    """The faces of a mask with the vertices that they use."""
    used, numbers = np.unique(mesh.faces[faces], return_inverse=True)
    return SurfaceMesh(mesh.vertices[used], numbers.reshape(-1, 3))


def rim(mesh):
    """Directed edges with one face."""
    runs = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = {tuple(run) for run in runs.tolist()}
    return np.array([run for run in runs.tolist() if (run[1], run[0]) not in keys])


def thick(mesh, thickness, closed=True, floor=None):
    """The skin with a back `thickness` below it, and walls along its rim when closed.

    The back runs parallel, or is flat under the vertices of the mesh `floor`.
    """
    count = len(mesh.vertices)
    back = mesh.vertices - thickness * mesh.vertex_normals
    if floor is not None:
        back = floor.vertices * [1, 1, 0] - [0, 0, thickness]
    faces = [mesh.faces, mesh.faces[:, ::-1] + count]
    if closed:
        begin, end = rim(mesh).T
        faces.append(_walls(mesh.vertices, back, begin, end))
    return SurfaceMesh(np.concatenate([mesh.vertices, back]), np.concatenate(faces))


def _walls(top, low, begin, end):
    """Two faces below each edge, cut along the shorter diagonal."""
    count = len(top)
    down = np.linalg.norm(top[end] - low[begin], axis=1)
    up = np.linalg.norm(top[begin] - low[end], axis=1)
    straight = [begin, begin + count, end, end, begin + count, end + count]
    crossed = [begin, begin + count, end + count, begin, end + count, end]
    chosen = np.where(down <= up, np.stack(straight), np.stack(crossed))
    return chosen.T.reshape(-1, 3)


def box(length, width, height):
    """A closed box about the origin, walls and floor of few large faces, outside outward."""
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = [[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)]
    return SurfaceMesh(signs * np.array([length, width, height]) / 2, np.array(faces))


def strip(twists, around=60, across=4, radius=0.4, width=0.2):
    """A ring of a strip with a number of half turns; one half turn is a Moebius strip."""
    angle = np.arange(around) / around * 2 * np.pi
    offset = np.linspace(-width / 2, width / 2, across + 1)
    tilt = twists * angle[:, None] / 2
    ring = radius + offset[None, :] * np.cos(tilt)
    points = np.stack(
        [
            ring * np.cos(angle[:, None]),
            ring * np.sin(angle[:, None]),
            offset[None, :] * np.sin(tilt),
        ],
        axis=2,
    )
    if twists % 2:
        links = np.arange(across, -1, -1)
    else:
        links = np.arange(across + 1)
    numbers = np.arange(around * (across + 1)).reshape(around, -1)
    following = np.concatenate([numbers[1:], numbers[:1, links]])
    a, b = numbers[:, :-1].ravel(), numbers[:, 1:].ravel()
    c, d = following[:, 1:].ravel(), following[:, :-1].ravel()
    faces = np.concatenate([np.stack([a, d, b], 1), np.stack([b, d, c], 1)])
    return SurfaceMesh(points.reshape(-1, 3), faces)


def degenerate():
    flat = grid(1.0, 0.6, 0.05)
    return with_faces(flat, [3, 3, 4], [7, 7, 7], [0, 1, 2])


def repeated():
    mesh = panel()
    first = mesh.faces[10]
    return with_faces(mesh, np.roll(first, 1), first, mesh.faces[200])


def repeated_backward():
    mesh = panel()
    return SurfaceMesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:, ::-1]]))


def some_flipped():
    return flipped(panel(), np.random.default_rng(1).choice(480, 60, replace=False))


def inverted():
    return flipped(panel(), np.arange(480))


def speck(x=0.0, z=0.3):
    return moved(grid(0.02, 0.02, 0.01), transform((x, 0.0, z)))


def with_debris():
    return joined(panel(), speck(), speck(0.2))


def two_parts():
    return joined(panel(), moved(panel(), transform((1.2, 0.0, 0.0))))


def holed():
    holes = (0.2, 0.1), (-0.3, 0.06)
    mesh = panel()
    for middle, radius in holes:
        mesh = without(mesh, lambda x, y, m=middle, r=radius: np.hypot(x - m, y) < r)
    return mesh


def noisy_soup():
    return soup(panel(), 1e-7)


def slit():
    """The mesh cut along 0.3 m of its middle row."""
    mesh = panel()
    on_cut = (np.abs(mesh.vertices[:, 1]) < 1e-9) & (np.abs(mesh.vertices[:, 0]) < 0.16)
    inner = np.flatnonzero(on_cut)
    faces = mesh.faces.copy()
    above = mesh.centroids[:, 1] > 0
    rank = np.full(len(mesh.vertices), -1)
    rank[inner] = len(mesh.vertices) + np.arange(len(inner))
    faces[above] = np.where(rank[faces[above]] >= 0, rank[faces[above]], faces[above])
    # Five micrometres apart: more than rounding noise.
    twins = mesh.vertices[inner] + [0.0, 5e-6, 0.0]
    return SurfaceMesh(np.concatenate([mesh.vertices, twins]), faces)


def t_junctions():
    """Two flat halves whose rows of vertices do not match: 0.05 m against 0.1 m."""
    fine = moved(grid(0.5, 0.6, 0.05), transform((-0.25, 0.0, 0.0)))
    coarse = moved(grid(0.5, 0.6, 0.1), transform((0.25, 0.0, 0.0)))
    return merged(joined(fine, coarse))


def ribbed():
    """A panel with a rib under it along its middle row."""
    upright = transform((0.0, 0.0, -0.1), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    return merged(joined(grid(1.0, 0.6, 0.05), moved(grid(1.0, 0.2, 0.05), upright)))


def flapped():
    mesh = panel()
    ends = mesh.faces[100, :2]
    tip = mesh.vertices[ends].mean(axis=0) + [0.0, 0.0, 0.01]
    vertices = np.vstack([mesh.vertices, tip])
    return with_faces(SurfaceMesh(vertices, mesh.faces), [*ends, len(mesh.vertices)])


def unused_vertices():
    mesh = panel()
    return SurfaceMesh(np.vstack([[[9.0, 9.0, 9.0]], mesh.vertices, [[5, 5, 5.0]]]), mesh.faces + 1)


def moebius():
    return strip(1)


def solid_plate():
    return thick(panel(), 0.02)


def inside_out_solid():
    plate = solid_plate()
    return flipped(plate, np.arange(len(plate.faces)))


def solid_with_gap():
    """A closed plate of which two faces of the back are missing."""
    plate = solid_plate()
    return SurfaceMesh(plate.vertices, np.delete(plate.faces, [600, 601], axis=0))


def offset_shells():
    return thick(panel(), 0.002, closed=False)


def folded_skin():
    """A skin whose rim is folded back by 0.2 m all round, 2 mm below it."""
    plate = thick(grid(1.0, 0.6, 0.05), 0.002)
    x, y, z = np.abs(plate.centroids).T
    return kept(plate, ~((x < 0.3) & (y < 0.15) & (z > 0.0015)))


def hollow_solid():
    inside = moved(box(0.8, 0.4, 0.05), np.eye(4))
    return joined(thick(moved(grid(1.0, 0.6, 0.05), transform((0, 0, 0.05))), 0.1), inside)


def leading_edge():
    """Three quarters of a thick cylinder: a skin bent round, not a double one."""
    return half_cylinder(0.3, 1.0, 0.03, half_angle=0.75 * np.pi)


def upright_panel():
    return moved(grid(1.0, 0.6, 0.05), transform((0, 0, 0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]))


def long_panel():
    return grid(29.0, 4.0, 0.5)


def short_panel():
    return grid(0.06, 0.04, 0.005)


def grooved_skin(undercut=0.0):
    """A skin with a groove along y whose walls are upright, or lean over by `undercut`."""
    skin = grid(0.6, 0.4, 0.01, lambda x, y: groove(x, 0.015, 0.04, 0.01))
    x, y, z = skin.vertices.T
    foot = np.abs(np.abs(x) - 0.01) < 1e-9
    x = np.where(foot, np.sign(x) * (0.02 + undercut), x)
    return SurfaceMesh(np.stack([x, y, z], axis=1), skin.faces)


def grooved_floor():
    """What lies under a grooved skin; a little wider, so that no wall is folded flat."""
    flat = grid(0.6, 0.4, 0.01)
    return SurfaceMesh(flat.vertices * [1.004, 1, 1], flat.faces)


def grooved_block():
    """A closed block whose top has a groove with upright walls that runs out at its sides."""
    return thick(grooved_skin(), 0.05, floor=grooved_floor())


def bumped_skin():
    return grid(0.6, 0.6, 0.02, bump)


def bumped_block():
    return thick(bumped_skin(), 0.1, floor=bumped_skin())


def drilled_plate():
    """A closed plate with a manhole through it."""
    return thick(merged(holed()), 0.02)


#: name: (maker, findings as name: (count, action))
BROKEN = {
    "degenerate": (degenerate, {"degenerate faces": (3, "repaired")}),
    "repeated": (repeated, {"duplicate faces": (3, "repaired")}),
    "repeated backward": (repeated_backward, {"duplicate faces": (480, "repaired")}),
    "some flipped": (some_flipped, {"flipped faces": (60, "repaired")}),
    "inverted": (inverted, {"inverted parts": (1, "repaired")}),
    "debris": (with_debris, {"debris": (2, "repaired")}),
    "two parts": (two_parts, {"separate parts": (2, "noted")}),
    "holes": (holed, {"holes": (2, "noted")}),
    "noisy soup": (noisy_soup, {"cracks": (1440 - 273, "repaired")}),
    "slit": (slit, {"open cracks": (1, "noted")}),
    "T-junctions": (
        t_junctions,
        {"T-junctions": (6, "noted"), "separate parts": (2, "noted")},
    ),
    "rib": (ribbed, {"non-manifold edges": (20, "noted")}),
    "flap": (flapped, {"flaps": (1, "repaired")}),
    "unused vertices": (unused_vertices, {"unreferenced vertices": (2, "repaired")}),
    "moebius": (
        moebius,
        {"one-sided parts": (1, "noted"), "flipped faces": (236, "repaired")},
    ),
    "solid": (solid_plate, {"closed solid": (1, "repaired")}),
    "inside-out solid": (
        inside_out_solid,
        {"closed solid": (1, "repaired"), "inverted parts": (1, "repaired")},
    ),
    "solid with gap": (solid_with_gap, {"closed solid": (1, "repaired")}),
    "offset shells": (offset_shells, {"hidden parts": (1, "repaired")}),
    "folded skin": (folded_skin, {"double skin": (1, "repaired")}),
    "hollow solid": (
        hollow_solid,
        {"hidden parts": (1, "repaired"), "closed solid": (1, "repaired")},
    ),
    "leading edge": (leading_edge, {"surface facing away": (1, "noted")}),
    "upright": (upright_panel, {"upright surface": (1, "noted")}),
    "29 m": (long_panel, {"unit doubtful": (1, "noted")}),
    "60 mm": (short_panel, {"unit doubtful": (1, "noted")}),
    "drilled plate": (
        drilled_plate,
        {"closed solid": (1, "repaired"), "holes": (2, "noted")},
    ),
    "grooved block": (grooved_block, {"closed solid": (1, "repaired")}),
    "bumped block": (bumped_block, {"closed solid": (1, "repaired")}),
}
