"""The result files of a run: valid by their schemas, consistent with each other, escaped."""

import json
import os
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import skinplan.inspection
from meshes import bump, grid
from scanned_part import dented
from skinplan.inspection.cloud import read_ply
from skinplan.inspection.complete import complete_run
from skinplan.inspection.measure import InspectionSettings, coverage_so_far, inspect
from skinplan.inspection.qif import qif_document
from skinplan.inspection.report import write_report
from skinplan.inspection.results import write_results
from skinplan.mesh.model import Segmentation
from skinplan.part.inspection_plan import Characteristic, InspectionPlan
from skinplan.part.inspection_points import InspectionPoints
from skinplan.scanner.samples import sample_surface

EVIL = '<script>alert("x")</script> & \x07'
SPACE = "{http://qifstandards.org/xsd/qif3}"
JOB = {
    "id": "job-7", "state": "Ended", "order_id": EVIL, "serial_number": EVIL, "part": "plate",
    "part_uri": "/parts/plate.yaml", "operator_name": EVIL, "attributes": {EVIL: EVIL},
}  # fmt: skip
FACTS = [
    {"name": "tool", "file": "/c/tool-3.json", "sha256": "0", "date": "2026-11-03T08:15:00Z",
     "due": "2027-02-01", "residual": 0.00002, "unit": "m", "state": "valid"},
    {"name": "tracker_position", "file": "/c/tracker.json", "sha256": "0",
     "date": "2026-08-01T08:15:00Z", "due": "2026-11-01", "residual": 0.00008, "unit": "m",
     "state": "due"},
    {"name": "camera", "file": "", "sha256": "", "date": "", "due": "", "residual": None,
     "unit": "", "state": "missing"},
]  # fmt: skip
PLAN = InspectionPlan(
    2e-4,
    0.9,
    (
        Characteristic("skin", "profile", 1.2e-3),
        Characteristic("seat", "flatness", 1e-4, centre_m=(0.2, -0.15, 0.0), radius_m=0.04),
        Characteristic("knob", "sphere_diameter", 1e-4, 0.5, (0.0, 0.0, 0.03), 0.04),
        Characteristic("gauge", "points", 1.2e-3),
    ),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with a dent and a missing area, completed and reported."""
    folder = tmp_path_factory.mktemp("runs") / "job-7"
    folder.mkdir()
    mesh = grid(0.5, 0.4, 0.005, bump)
    rng = np.random.default_rng(0)
    true = dented(mesh, (0.15, 0.1, 0.03, -5e-4))
    face = rng.choice(len(mesh.faces), 150_000, p=mesh.face_areas / mesh.area)
    points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), 150_000), true.corners[face])
    points += rng.normal(size=(150_000, 1)) * 3e-5 * mesh.face_normals[face]
    points = points[np.hypot(points[:, 0] + 0.18, points[:, 1] + 0.12) > 0.04]
    segmentation = Segmentation((np.hypot(*mesh.centroids[:, :2].T) < 0.12).astype(int), mesh)
    coverage = coverage_so_far(sample_surface(mesh), segmentation)
    found = inspect(points, mesh, segmentation, np.eye(4), InspectionSettings(), None, coverage)
    targets = np.array([[0.15, 0.1, 0.0], [-0.18, -0.12, 0.0]])
    asked = InspectionPoints(targets, np.tile([0.0, 0.0, 1.0], (2, 1)), np.ones(2, np.int64))
    values = {"intensity": np.ones(len(points))}
    write_results(folder / "cloud.ply", points, found, coverage, values, PLAN, asked)
    measured = {
        "points": found.points, "area_ratio": found.area_ratio, "alignment_rms_m": 3e-5,
        "feature_area_ratio": found.feature_area_ratio, "deviation_rms_m": found.deviation_rms_m,
    }  # fmt: skip
    mesh_facts = {"triangles": len(mesh.faces), "area_m2": mesh.area, "sha256": "ab" * 32}
    summary = {"job": JOB, "mesh": mesh_facts, "measured": measured, "calibration": FACTS}
    (folder / "summary.json").write_text(json.dumps(summary))
    write_report(folder)
    return folder, found, coverage


def schema():
    path = Path(skinplan.inspection.__file__).with_name("summary.schema.json")
    return json.loads(path.read_text())


def test_the_summary_is_valid_by_its_schema(run):
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    document = json.loads((run[0] / "summary.json").read_text())
    assert [error.message for error in validator.iter_errors(document)] == []
    assert document["inspection"] == json.loads((run[0] / "inspection.json").read_text())
    # Its illegal twins.
    for path, value in (
        (("version",), "2.0"),
        (("job", "state"), "Done"),
        (("inspection", "whole", "area_ratio"), 98.0),
        (("inspection", "characteristics", 0, "state"), "ok"),
        (("files", "cloud.ply", "sha256"), "?"),
    ):
        twin = json.loads(json.dumps(document))
        inner = twin
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        assert list(validator.iter_errors(twin)), path


def test_completing_again_changes_nothing(run):
    before = {path.name: path.read_bytes() for path in run[0].iterdir() if path.is_file()}
    write_report(run[0])
    assert {path.name: path.read_bytes() for path in run[0].iterdir() if path.is_file()} == before


def test_the_table_has_a_line_for_each_piece(run):
    folder, found, coverage = run
    table = np.genfromtxt(folder / "deviation.csv", delimiter=",", names=True)
    assert len(table) == len(coverage.samples.points)
    assert table["points"].sum() == found.surface.count.sum()
    np.testing.assert_allclose(table["deviation_m"], found.surface.local, atol=1e-7)
    assert table["measured"].mean() == pytest.approx(found.area_ratio)


def test_the_laz_file_has_the_cloud(run):
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    cloud, las = read_ply(run[0] / "cloud.ply"), laspy.read(str(run[0] / "cloud.laz"))
    places = np.stack([las.x, las.y, las.z], axis=1)
    np.testing.assert_allclose(places, cloud.points, atol=2e-6)
    np.testing.assert_array_equal(np.asarray(las.deviation), cloud.values["deviation"])


def test_qif_has_what_was_asked_and_found(run):
    root = ET.parse(run[0] / "results.qif").getroot()
    names = [element.text for element in root.iter(f"{SPACE}Name")][1:]
    assert names[:4] == ["deviation", "skin", "seat", "knob"]
    assert names[4:6] == ["gauge.1", "gauge.2"]
    states = [element.text for element in root.iter(f"{SPACE}CharacteristicStatusEnum")]
    assert states == ["FAIL", "PASS", "PASS", states[3], "PASS", "NOT_ANALYZED"]
    assert states[3] != "PASS"  # a bump is no ball
    value = root.find(f".//{SPACE}PointProfileCharacteristicMeasurement/{SPACE}Value")
    assert float(value.text) == pytest.approx(-5e-4, abs=4e-5)
    serial = root.find(f".//{SPACE}SerialNumber").text
    assert serial == EVIL.replace("\x07", "\ufffd")
    numbers = [int(element.get("id")) for element in root.iter() if element.get("id")]
    assert len(set(numbers)) == len(numbers) and max(numbers) == int(root.get("idMax"))


def test_qif_is_valid_by_its_schema(run):
    """Needs QIFDocument.xsd of QIF 3.0; SKINPLAN_QIF_XSD names it."""
    etree = pytest.importorskip("lxml.etree")
    path = Path(os.environ.get("SKINPLAN_QIF_XSD", "/nowhere"))
    if not path.is_file():
        pytest.skip("SKINPLAN_QIF_XSD does not name QIFDocument.xsd")
    space = "http://www.w3.org/2000/09/xmldsig#"
    stub = (
        f'<s:schema xmlns:s="http://www.w3.org/2001/XMLSchema" targetNamespace="{space}">'
        f'<s:complexType name="SignatureType"/></s:schema>'
    )

    class Local(etree.Resolver):
        def resolve(self, url, _, context):
            return self.resolve_string(stub, context) if "xmldsig" in url else None

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Local())
    checker = etree.XMLSchema(etree.parse(str(path), parser))
    summary = json.loads((run[0] / "summary.json").read_text())
    nothing = {**summary, "inspection": {"verdict": {"state": "not_judged"}}}
    for content in (
        (run[0] / "results.qif").read_bytes(),
        qif_document(nothing),
        qif_document({"job": JOB}),
    ):
        checker.validate(etree.fromstring(content))
        assert [str(error) for error in checker.error_log] == []


def test_a_run_without_inspection_is_completed_without_it(tmp_path):
    complete_run(tmp_path)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "summary.json").write_text(json.dumps({"job": {"id": "a", "state": "Aborted"}}))
    complete_run(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["version"] and "inspection" not in summary and summary["files"] == {}
    assert not (tmp_path / "results.qif").exists()


@pytest.mark.parametrize("content", ["[]", '{"characteristics": [{"kind": "profile"}]}', "{"])
def test_a_damaged_inspection_is_no_reason_to_fail(tmp_path, content):
    (tmp_path / "summary.json").write_text(json.dumps({"job": {"id": "a", "state": "Ended"}}))
    (tmp_path / "inspection.json").write_text(content)
    assert write_report(tmp_path).is_file()


def test_what_a_reader_looks_for_stands_first(run):
    html = (run[0] / "report.html").read_text()
    places = [
        html.index(text)
        for text in (
            "Not within tolerance",
            "worst deviation",
            "missing area",
            "out of date",
            "<h2>Deviation</h2>",
        )
    ]
    assert places == sorted(places)
    assert "<script" not in html and "&lt;script&gt;" in html
    assert "tool-3.json" in html and "tolerance ±0.200 mm" in html


def test_the_report_in_a_browser_without_network(run, tmp_path):
    browser = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )  # noqa: E501
    if browser is None:
        pytest.skip("no Chromium: the report is not looked at")
    for width in (1400, 500):
        picture = tmp_path / f"{width}.png"
        command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        command += ["--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path / 'u'}"]
        command += [f"--window-size={width},1000", f"--screenshot={picture}"]
        address = (run[0] / "report.html").as_uri()
        subprocess.run([*command, address], capture_output=True, timeout=120, check=True)
        pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
        assert pixels.shape[:2] == (1000, width)
        # The verdict's red is there at the top, without scrolling.
        red = (np.abs(pixels - [179, 38, 30]).max(axis=2) < 40)[:400]
        assert red.sum() > 500
