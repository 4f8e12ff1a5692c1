"""Mutated mesh files: reading and examining them ends in a mesh or in a named error, never else."""

import resource
import struct
import warnings
from collections import Counter

import numpy as np
import pytest

import broken_meshes as broken
from meshes import grid, joined
from skinplan.errors import MeshError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import read_mesh
from unit.test_mesh_formats import ply

MOST_GROWTH_KIB = 600 * 1024
_NUMBERS = [
    b"0",
    b"-1",
    b"4294967295",
    b"1e308",
    b"-1e-320",
    b"nan",
    b"inf",
    b"3.5",
    b"99999999999",
]
_WORDS = [
    b"vertex ",
    b"f ",
    b"endloop",
    b"end_header\n",
    b"element face 7\n",
    b"\0",
    b"/",
    b"\n",
    b"ply\n",
]


def binary_stl(mesh):
    faces = mesh.corners.astype("<f4").reshape(len(mesh.faces), 9)
    records = b"".join(bytes(12) + face.tobytes() + b"\0\0" for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + records


def text_stl(mesh):
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in face)
        + "endloop\nendfacet\n"
        for face in mesh.corners.tolist()
    )
    return f"solid seed\n{facets}endsolid seed\n".encode()


def obj(mesh):
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    lines += [f"f {a}//1 {b}//1 {c}//1" for a, b, c in (mesh.faces[:9] - 60).tolist()]
    return ("\n".join(lines) + "\n").encode()


def seeds():
    """Whole files of every format, of a good mesh and of one with several defects."""
    good = grid(1.0, 0.5, 0.1, lambda x, y: 0.1 * x * y)
    bad = joined(broken.thick(good, 0.02), broken.speck(), broken.moebius())
    bad = broken.flipped(bad, np.arange(0, len(bad.faces), 3))
    files = []
    for mesh in (good, bad):
        tables = mesh.vertices.tolist(), mesh.faces.tolist()
        files += [("stl", binary_stl(mesh)), ("stl", text_stl(mesh)), ("obj", obj(mesh))]
        files += [("ply", ply(*tables, order, extra=order == ">")) for order in ("", "<", ">")]
    return files


def mutated(data, other, rng):
    """One to three mutations of a file, half of them small; `other` is spliced in."""
    for _ in range(rng.integers(1, 4)):
        place = (
            int(rng.integers(0, len(data) + 1)) if rng.random() < 0.7 else int(rng.integers(0, 300))
        )
        length = int(rng.integers(1, 60))
        match rng.integers(0, 16):
            case 0:  # flip bytes
                flips = bytes(rng.integers(0, 256, length, dtype=np.uint8))
                data = data[:place] + flips + data[place + length :]
            case 1:  # flip one bit
                if place < len(data):
                    bit = bytes([data[place] ^ (1 << int(rng.integers(0, 8)))])
                    data = data[:place] + bit + data[place + 1 :]
            case 2:  # cut the end off
                data = data[:place]
            case 3:  # drop something
                data = data[:place] + data[place + length :]
            case 4:  # repeat something
                data = data[:place] + data[max(0, place - length) : place] * 3 + data[place:]
            case 5:  # splice
                start = int(rng.integers(0, len(other)))
                data = data[:place] + other[start : start + 10 * length] + data[place:]
            case 6:  # edit a number, or a word
                word = (_NUMBERS + _WORDS)[rng.integers(0, len(_NUMBERS) + len(_WORDS))]
                spaces = [at for at, byte in enumerate(data[place : place + 200]) if byte in b" \n"]
                begin = place + (spaces[0] + 1 if spaces else 0)
                end = place + spaces[1] if len(spaces) > 1 else begin
                data = data[:begin] + word + data[end:]
            case 7:  # claim another count
                data = with_count(data, rng)
            case _:  # another digit or a small other value: the file stays whole
                data = with_value(data, place, rng)
    return data


def with_value(data, place, rng):
    if b"\0" not in data:
        digits = [at for at, byte in enumerate(data[place : place + 50]) if byte in b"0123456789"]
        if not digits:
            return data
        at = place + digits[0]
        return data[:at] + bytes([rng.integers(48, 58)]) + data[at + 1 :]
    value = rng.choice([0, 1, 2, 250]) if rng.random() < 0.5 else rng.uniform(-1, 1)
    raw = struct.pack("<i", int(value)) if value == int(value) else struct.pack("<f", value)
    place = 84 + 50 * ((place - 84) // 50) + 12 + 4 * int(rng.integers(0, 9))
    return data[:place] + raw + data[place + 4 :]


def with_count(data, rng):
    count = int(rng.choice([0, 1, 7, 101, 2**31 - 1, 2**32 - 1, int(rng.integers(0, 2**32))]))
    if data[:3] == b"ply":
        head, mark, rest = data.partition(
            b"element face " if rng.random() < 0.5 else b"element vertex "
        )
        return head + mark + str(count).encode() + rest[rest.find(b"\n") :] if mark else data
    return data[:80] + struct.pack("<I", count) + data[84:]


def outcomes(folder, count, seed):
    """Reads and examines mutated files; returns how often each outcome came."""
    rng = np.random.default_rng(seed)
    files = seeds()
    found = Counter()
    for number in range(count):
        kind, data = files[number % len(files)]
        path = folder / f"fuzz.{kind}"
        path.write_bytes(mutated(data, files[rng.integers(0, len(files))][1], rng))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                mesh, _ = read_mesh(path)
                repaired, _ = check_mesh(mesh)
        except MeshError as error:
            assert str(error)
            found[type(error).__name__] += 1
        except BaseException as error:
            error.add_note(f"input {number} of seed {seed} is kept as {path}")
            raise
        else:
            assert np.isfinite(repaired.vertices).all() and len(repaired.faces) > 0
            assert repaired.face_areas.min() > 0
            found["mesh"] += 1
    return found


def grown_kib(before):
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before


def test_the_seeds_are_good_files(tmp_path):
    for kind, data in seeds():
        path = tmp_path / f"seed.{kind}"
        path.write_bytes(data)
        check_mesh(read_mesh(path)[0])


def test_mutated_files_end_in_a_mesh_or_a_named_error(tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = outcomes(tmp_path, 360, seed=1)
    assert sum(found.values()) == 360
    assert found["mesh"] > 30
    assert found["MeshUnreadableError"] > 60
    assert grown_kib(before) < MOST_GROWTH_KIB


@pytest.mark.long
def test_ten_thousand_mutated_files(tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = outcomes(tmp_path, 10_000, seed=2)
    assert sum(found.values()) == 10_000
    assert found["mesh"] > 1000
    assert {"MeshUnreadableError", "MeshEmptyError", "MeshUnitError", "MeshNotFiniteError"} <= set(
        found
    )
    assert grown_kib(before) < MOST_GROWTH_KIB
