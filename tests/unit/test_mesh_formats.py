import struct

import numpy as np
import pytest

from meshes import grid
from skinplan.errors import (
    MeshEmptyError,
    MeshError,
    MeshNotFiniteError,
    MeshRefusedError,
    MeshUnreadableError,
)
from skinplan.mesh.load import load_mesh, read_mesh

PANEL = grid(1.0, 0.5, 0.1, lambda x, y: 0.1 * x * y)
COLUMNS, ROWS = 10, 5
QUADS = np.concatenate([PANEL.faces[0::2], PANEL.faces[1::2, 2:]], axis=1)


def ply(vertices, polygons, order, extra=False):
    """A PLY file; order "" is text, else the byte order."""
    kind = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["ply", f"format {kind} 1.0", "comment made by a test"]
    lines += [f"element vertex {len(vertices)}", "property uchar quality"] if extra else []
    lines += [] if extra else [f"element vertex {len(vertices)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {len(polygons)}", "property list uchar int vertex_indices"]
    lines += ["property list uint float weights", "property short label"] if extra else []
    head = ("\n".join([*lines, "end_header"]) + "\n").encode()
    rows = []
    for vertex in vertices:
        values = ([("B", 7)] if extra else []) + [("d", value) for value in vertex]
        rows.append(values)
    for number, polygon in enumerate(polygons):
        values = [("B", len(polygon))] + [("i", int(corner)) for corner in polygon]
        if extra:
            values += [("I", number % 3)] + [("f", 0.5)] * (number % 3) + [("h", -1)]
        rows.append(values)
    if not order:
        return head + "\n".join(" ".join(repr(v) for _, v in row) for row in rows).encode() + b"\n"
    return head + b"".join(
        struct.pack(order + "".join(code for code, _ in row), *(value for _, value in row))
        for row in rows
    )


def write(folder, name, data):
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def corners(mesh):
    """The corners of the faces, sorted so that the order of faces does not matter."""
    flat = mesh.corners.round(9).reshape(-1, 9)
    return flat[np.lexsort(flat.T)]


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize("shape", ["triangles", "quads", "mixed"])
def test_every_kind_of_ply(tmp_path, order, extra, shape):
    polygons = {"triangles": list(PANEL.faces), "quads": list(QUADS)}
    polygons["mixed"] = list(QUADS[:20]) + list(PANEL.faces[40:])
    mesh, findings = read_mesh(
        write(tmp_path, "a.ply", ply(PANEL.vertices.tolist(), polygons[shape], order, extra))
    )
    assert mesh.area == pytest.approx(PANEL.area, rel=1e-3)
    assert len(mesh.faces) == len(PANEL.faces)
    split = {"triangles": 0, "quads": 50, "mixed": 20}[shape]
    assert [(f.name, f.count, f.action) for f in findings] == (
        [("polygons", split, "repaired")] if split else []
    )
    if shape == "triangles":
        np.testing.assert_allclose(corners(mesh), corners(PANEL), atol=1e-8)
    assert mesh.face_normals[:, 2].min() > 0


@pytest.mark.parametrize("back", [False, True])
def test_obj_with_all_that_exporters_write(tmp_path, back):
    lines = ["# a panel", "mtllib none.mtl", "o panel", "\tv 9 9 9 1.0"]
    lines += [f"v {x} {y} {z} 0.5 0.5 0.5" for x, y, z in PANEL.vertices.tolist()]
    lines += ["vn 0 0 1", "vt 0 0", "g first", "usemtl none", "s off"]
    count = len(PANEL.vertices) + 1
    for a, b, c, d in QUADS.tolist():
        numbers = [n + 2 - (count + 1 if back else 0) for n in (a, b, c, d)]
        lines.append("f " + " ".join(f"{n}/1/1" if n % 2 else f"{n}//1" for n in numbers))
    lines += ["l 1 2 3", "p 4", "f 2 3 \\", "4 # a face on two lines"]
    mesh, findings = read_mesh(write(tmp_path, "a.obj", "\r\n".join(lines)))
    assert {(f.name, f.count) for f in findings} == {("polygons", 50), ("lines and points", 2)}
    assert len(mesh.faces) == len(PANEL.faces) + 1
    assert mesh.area == pytest.approx(PANEL.area, rel=1e-3)


def test_concave_polygons_are_split_inside(tmp_path):
    """An L of 0.75 m2 and an arrow of 0.125 m2: no triangle may lie outside of them."""
    text = (
        "v 1 0.5 0\nv 0.5 0.5 0\nv 0.5 1 0\nv 0 1 0\nv 0 0 0\nv 1 0 0\n"
        "v 2 0 0\nv 2.25 0.25 0\nv 2.5 0 0\nv 2.25 0.75 0\n"
        "f 1 2 3 4 5 6\nf 7 8 9 10\n"
    )
    mesh = load_mesh(write(tmp_path, "a.obj", text))
    assert mesh.area == pytest.approx(0.75 + 0.5 * 0.5 * 0.5)
    assert mesh.face_normals[:, 2].min() > 0.99


def test_text_stl_in_capitals_and_without_an_end(tmp_path):
    facet = "FACET NORMAL 0 0 1\n OUTER LOOP\n{} ENDLOOP\nENDFACET\n"
    faces = [
        facet.format("".join(f"  VERTEX {x:E} {y:E} {z:E}\n" for x, y, z in face))
        for face in PANEL.corners.tolist()
    ]
    whole = "SOLID panel\n" + "".join(faces) + "ENDSOLID panel\n"
    mesh, findings = read_mesh(write(tmp_path, "a.stl", whole))
    np.testing.assert_allclose(corners(mesh), corners(PANEL), atol=1e-6)
    assert findings == ()
    cut, findings = read_mesh(write(tmp_path, "a.stl", whole[: whole.index("ENDSOLID")]))
    assert len(cut.faces) == len(PANEL.faces)
    assert [(f.name, f.count, f.action) for f in findings] == [("incomplete file", 1, "noted")]


def test_binary_stl_may_begin_like_text(tmp_path):
    face = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    data = b"solid of a careless exporter".ljust(80) + struct.pack("<I", 1) + face
    assert load_mesh(write(tmp_path, "a.stl", data)).area == pytest.approx(0.5)


def test_vertices_that_are_not_finite_go_when_no_face_uses_them(tmp_path):
    text = "v nan 0 0\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 inf 0\nf 2 3 4\n"
    mesh, findings = read_mesh(write(tmp_path, "a.obj", text))
    np.testing.assert_array_equal(mesh.corners, [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert [(f.name, f.count, f.action) for f in findings] == [
        ("vertices not finite", 2, "repaired")
    ]
    with pytest.raises(MeshNotFiniteError) as caught:
        read_mesh(write(tmp_path, "b.obj", text + "f 1 2 3\n"))
    assert caught.value.findings[-1].action == "refused"


V = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
TAIL = "element face {}\nproperty list {} int vertex_indices\nend_header\n"
Z = "property float z\n"
POINTS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
HUGE = 4_000_000_000


def binary(vertices, faces, kind="uchar", body=b""):
    head = HEAD.format("binary_little_endian", vertices) + Z + TAIL.format(faces, kind)
    return head.encode() + body


@pytest.mark.parametrize(
    ("name", "data", "error", "words"),
    [
        ("a.obj", V, MeshEmptyError, "3 vertices and 0 faces"),
        ("a.obj", V + "l 1 2\np 3\n", MeshEmptyError, "0 faces"),
        ("a.obj", V + "f 1 2\n", MeshEmptyError, "0 faces"),
        ("a.obj", V + "f 0 1 2\n", MeshUnreadableError, "line 4.*vertex 0"),
        ("a.obj", V + "f 1 2 -4\n", MeshUnreadableError, "line 4.*counts back"),
        ("a.obj", V + "f 1 2 4\n", MeshUnreadableError, "1 faces that name vertices"),
        ("a.obj", V + "f 1 2 99999999999999999999\n", MeshUnreadableError, "line 4"),
        ("a.obj", V + "f 1 2 " + "9" * 5000 + "\n", MeshUnreadableError, "line 4"),
        ("a.obj", V + "f a b c\n", MeshUnreadableError, "line 4"),
        ("a.obj", "v 1 2\nf 1 1 1\n", MeshUnreadableError, "line 1"),
        ("a.obj", "v 1 2 x\nf 1 1 1\n", MeshUnreadableError, "number"),
        ("a.obj", V + "f 1 2 3 9\n", MeshUnreadableError, "none of the 3"),
        ("a.obj", b"\0\1\2" * 50, MeshUnreadableError, "no text"),
        ("a.ply", "ply\nformat ascii 1.0\nend_header\n", MeshEmptyError, "0 vertices"),
        ("a.ply", "ply\nend_header\n", MeshUnreadableError, "no format"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 1\n", MeshUnreadableError, "end_header"),
        ("a.ply", "ply\nformat ebcdic 1.0\nend_header\n", MeshUnreadableError, "ebcdic"),
        ("a.ply", binary(3, 0, body=POINTS), MeshEmptyError, "3 vertices and 0 faces"),
        ("a.ply", binary(HUGE, 1, body=POINTS), MeshUnreadableError, "4000000000.*too short"),
        ("a.ply", binary(3, HUGE, body=POINTS), MeshUnreadableError, "4000000000.*too short"),
        ("a.ply", binary(10**30, 1, body=POINTS), MeshUnreadableError, "too short"),
        (
            "a.ply",
            binary(3, 1, "uint", POINTS + struct.pack("<I", HUGE) + bytes(99)),
            MeshUnreadableError,
            "a list of",
        ),
        (
            "a.ply",
            binary(3, 1, "char", POINTS + b"\xff" + bytes(99)),
            MeshUnreadableError,
            "a list of -1",
        ),
        (
            "a.ply",
            binary(3, 1, body=POINTS + struct.pack("<B3i", 3, 0, 1, 3)),
            MeshUnreadableError,
            "name vertices it does not have",
        ),
        (
            "a.ply",
            HEAD.format("ascii", 1) + TAIL.format(1, "uchar") + "0 0\n3 0 0 0\n",
            MeshUnreadableError,
            "no x, y and z",
        ),
        (
            "a.ply",
            HEAD.format("ascii", 1) + Z + TAIL.format(1, "uchar") + "0 0 0\n3 0 0 0.5\n",
            MeshUnreadableError,
            "whole number",
        ),
        (
            "a.ply",
            HEAD.format("ascii", 1) + Z + TAIL.format(1, "uchar") + "0 0 0\n3 0 0 nan\n",
            MeshUnreadableError,
            "whole number",
        ),
        (
            "a.ply",
            HEAD.format("ascii", 1) + Z + TAIL.format(1, "uchar") + "0 0 0\nnan 0 0 0\n",
            MeshUnreadableError,
            "a list of nan",
        ),
        (
            "a.ply",
            HEAD.format("ascii", 1) + Z + "property float x\n" + TAIL.format(1, "uchar"),
            MeshUnreadableError,
            "two properties 'x'",
        ),
        (
            "a.stl",
            "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\n",
            MeshUnreadableError,
            "1 loops with 2 vertices",
        ),
        (
            "a.stl",
            "solid a\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex a b c\nendloop\n",
            MeshUnreadableError,
            "number",
        ),
        (
            "a.stl",
            bytes(80) + struct.pack("<I", HUGE) + bytes(50),
            MeshUnreadableError,
            "4000000000 faces",
        ),
        ("a.xyz", "1 2 3\n", MeshUnreadableError, "extension .xyz"),
    ],
)
def test_each_bad_file_is_named_with_its_reason(tmp_path, name, data, error, words):
    with pytest.raises(error, match=words) as caught:
        load_mesh(write(tmp_path, name, data))
    assert name in str(caught.value)


def test_huge_files_are_refused_before_they_are_read(tmp_path):
    path = tmp_path / "huge.stl"
    with path.open("wb") as stream:
        stream.truncate(3 * 1024**3)
    with pytest.raises(MeshRefusedError, match=r"3\.0 GiB; up to 2 GiB") as caught:
        load_mesh(path)
    assert caught.value.findings[0].name == "huge file"


@pytest.mark.parametrize("kind", ["stl", "text.stl", "ply", "text.ply", "obj"])
def test_files_with_too_many_faces_are_refused(tmp_path, monkeypatch, kind):
    from skinplan.mesh.formats import raw

    monkeypatch.setattr(raw, "MOST_FACES", 1)
    two = [[0, 1, 2], [0, 2, 1]]
    points = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]
    facet = "facet normal 0 0 1\nouter loop\n" + "vertex 0 0 0\n" * 3 + "endloop\nendfacet\n"
    data = {
        "stl": bytes(80) + struct.pack("<I", 2) + bytes(100),
        "text.stl": "solid a\n" + 2 * facet + "endsolid a\n",
        "ply": ply(points, two, "<"),
        "text.ply": ply(points, two, ""),
        "obj": V + "f 1 2 3\nf 1 3 2\n",
    }
    with pytest.raises(MeshRefusedError, match="2 faces") as caught:
        load_mesh(write(tmp_path, f"a.{kind}", data[kind]))
    assert caught.value.findings[0].name == "huge mesh"


def test_an_unusual_unit_is_answered_with_the_likely_one(tmp_path):
    """A wing of 2.9 km and one of 2.9 mm, with the finding beside the error."""
    for scale, unit, hint in ((2900.0, "m", "mm"), (2.9, "mm", "m")):
        text = V.replace("1", str(scale)) + "f 1 2 3\n"
        with pytest.raises(MeshError, match=f"did you mean unit {hint} or") as caught:
            load_mesh(write(tmp_path, "wing.obj", text), unit)
        (finding,) = caught.value.findings
        assert (finding.name, finding.action) == ("unit implausible", "refused")
