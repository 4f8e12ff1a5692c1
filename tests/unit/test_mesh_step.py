"""STEP files; those that need Open CASCADE write their parts with it."""

import importlib.util

import numpy as np
import pytest

from skinplan.errors import InputError, MeshExtraMissingError, MeshUnitError, MeshUnreadableError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import Tessellation, read_mesh

INSTALLED = importlib.util.find_spec("OCP") is not None
needs_extra = pytest.mark.skipif(not INSTALLED, reason="needs the optional package cadquery-ocp")


@pytest.mark.skipif(INSTALLED, reason="cadquery-ocp is installed")
@pytest.mark.parametrize("name", ["part.step", "PART.STP"])
def test_without_the_extra_the_error_says_how_to_install_it(tmp_path, name):
    path = tmp_path / name
    path.write_text("ISO-10303-21;\nHEADER;\nENDSEC;\n")
    with pytest.raises(MeshExtraMissingError, match=r"cadquery-ocp.*make extras") as caught:
        read_mesh(path)
    assert name in str(caught.value)


def test_what_is_no_step_file_never_reaches_open_cascade(tmp_path):
    path = tmp_path / "part.step"
    path.write_bytes(b"solid no step file\n" + bytes(range(256)))
    with pytest.raises(MeshUnreadableError, match="does not begin with ISO-10303-21;"):
        read_mesh(path)


@pytest.mark.parametrize(
    "values", [(0.0, 0.1), (-1e-4, 0.1), (np.nan, 0.1), (1e-4, 0.0), (1e-4, 9.0), (2.0, 0.1)]
)
def test_the_tolerance_is_checked(values):
    with pytest.raises(InputError, match="tessellation within"):
        Tessellation(*values)


def write_step(path, shape, unit="MM"):
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    assert writer.Write(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    return path


def cylinder(radius_mm=1000.0, length_mm=800.0):
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder

    return BRepPrimAPI_MakeCylinder(radius_mm, length_mm).Shape()


@needs_extra
@pytest.mark.parametrize("unit", ["MM", "M", "INCH"])
def test_the_unit_is_the_files_own(tmp_path, unit):
    path = write_step(tmp_path / "part.step", cylinder(), unit)
    mesh, findings = read_mesh(path, "cm")
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0)[0, None], [2.0], atol=0.01)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(0.8, abs=1e-9)
    (finding,) = findings
    assert (finding.name, finding.count, finding.action) == (
        "tessellated",
        len(mesh.faces),
        "noted",
    )
    assert "0.1 mm" in finding.detail


@needs_extra
@pytest.mark.parametrize("tolerance_m", [1e-3, 1e-4, 1e-5])
def test_the_surface_is_met_within_the_tolerance(tmp_path, tolerance_m):
    """A cylinder of 1 m radius: the middles of the chords lie at most the tolerance inside."""
    path = write_step(tmp_path / "part.stp", cylinder())
    mesh, _ = read_mesh(path, tessellation=Tessellation(tolerance_m, 1.0))
    side = np.abs(mesh.face_normals[:, 2]) < 0.5
    edges = mesh.faces[side][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    middles = mesh.vertices[edges].mean(axis=1)
    inside = 1.0 - np.linalg.norm(middles[:, :2], axis=1)
    assert inside.max() <= tolerance_m * 1.001
    assert inside.max() > tolerance_m / 10
    np.testing.assert_allclose(
        np.linalg.norm(mesh.vertices[np.unique(mesh.faces[side])][:, :2], axis=1), 1.0, atol=1e-9
    )


@needs_extra
def test_faces_look_outward_and_the_doctor_keeps_the_upper_side(tmp_path):
    mesh, _ = read_mesh(write_step(tmp_path / "part.step", cylinder()))
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.centroids - [0, 0, 0.4])
    assert outward.min() > 0
    skin, findings = check_mesh(mesh)
    assert [finding.name for finding in findings] == ["closed solid"]
    assert skin.area == pytest.approx(np.pi, rel=1e-3)
    np.testing.assert_allclose(skin.vertices[:, 2], 0.8, atol=1e-9)


@needs_extra
def test_a_step_part_of_kilometres_is_refused(tmp_path):
    path = write_step(tmp_path / "part.step", cylinder(1e6, 1e3))
    with pytest.raises(MeshUnitError, match="its own unit would be 2 km"):
        read_mesh(path)


@needs_extra
@pytest.mark.parametrize("seed", range(4))
def test_damaged_step_files_end_in_named_errors(tmp_path, seed):
    data = bytearray(write_step(tmp_path / "part.step", cylinder()).read_bytes())
    rng = np.random.default_rng(seed)
    if seed == 0:
        data = data[:13] + bytes(range(256)) * 20
    elif seed == 1:
        del data[len(data) // 2 :]
    else:
        for place in rng.integers(300, len(data), 400):
            data[place] = rng.integers(32, 127)
    path = tmp_path / "broken.step"
    path.write_bytes(bytes(data))
    with pytest.raises(MeshUnreadableError, match="broken.step can't be read as STEP"):
        read_mesh(path)
