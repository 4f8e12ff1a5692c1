"""The 3-D view: what is in the scene, and the server that hands it to the browser."""

import dataclasses
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import threading
import urllib.request

import numpy as np
import pytest

import meshes
from skinplan.errors import PortBusyError, ViewerMissingError
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.model import FEATURE, ROW
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scanner.coverage import certify
from skinplan.scanner.model import ScannerModel
from skinplan.stations.model import SkippedPoint, Station, StationPlan
from skinplan.transforms import planar, rotate, transform
from skinplan.view.browser import BrowserView, free_port
from skinplan.view.scene_data import (
    SceneData,
    arrows,
    field_mesh,
    point_sentence,
    row_lines,
    scanner_pose,
)
from skinplan.view.subject import Subject

UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="viser is not installed"
)


@pytest.fixture(scope="module")
def subject():
    mesh = meshes.grid(0.5, 0.3, 0.01, lambda x, y: meshes.bump(x, y, 0.05, 0.06))
    segmentation = segment_mesh(mesh)
    settings = ScanSettings()
    scanner = ScannerModel.from_settings(settings)
    path = plan_scan_path(mesh, segmentation, settings)
    half = len(path) // 2
    stations = (
        Station(0, planar(-0.3, -0.9, 0.0), np.arange(half)),
        Station(1, planar(0.3, -0.9, 0.1), np.arange(half, len(path) - 1)),
    )
    last = SkippedPoint(len(path) - 1, "too far away")
    return Subject(
        part_id="<panel>",
        mesh=mesh,
        segmentation=segmentation,
        path=path,
        scanner=scanner,
        coverage=certify(mesh, segmentation, path, scanner),
        station_plan=StationPlan("rectangles", stations, 2, 2, True, 1.0, (last,)),
        skipped=(last,),
        T_map_workpiece=transform((0.0, 0.0, 1.05), UPRIGHT),
    )


def test_the_pieces_are_the_whole_part(subject):
    data = SceneData(subject)
    assert list(data.colourings) == ["regions", "coverage"]
    for pieces in data.colourings.values():
        assert sum(piece.mesh.area for piece in pieces) == pytest.approx(subject.mesh.area)
        assert len({piece.name for piece in pieces}) == len(pieces)
    regions = data.colourings["regions"]
    assert len(regions) == 1 + subject.segmentation.regions


def test_large_meshes_are_thinned_and_it_is_said(subject):
    small = SceneData(subject, most_faces=800)
    assert small.is_thinned
    assert 100 < len(small.display.mesh.faces) <= 800
    shown = sum(len(piece.mesh.faces) for piece in small.colourings["coverage"])
    assert shown == len(small.display.mesh.faces)
    assert not SceneData(subject).is_thinned


def test_arrows_start_at_the_points_and_point_at_the_part(subject):
    path = subject.path
    for kind in (ROW, FEATURE):
        ends = arrows(path, kind)
        chosen = path.kinds == kind
        assert ends[:, 0] == pytest.approx(path.positions[chosen])
        along = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None]
        assert along == pytest.approx(path.directions[chosen])


def test_row_lines_join_neighbours_of_one_row_only(subject):
    path = subject.path
    lines = row_lines(path)
    rows = len(np.unique(path.groups[path.kinds == ROW]))
    assert len(lines) == path.row_points - rows
    assert set(map(tuple, lines.reshape(-1, 3))) <= set(map(tuple, path.positions))


def test_the_field_of_view_is_the_cylinder_of_the_scanner(subject):
    scanner = subject.scanner
    field = field_mesh(scanner)
    assert field.bounds[:, 0] == pytest.approx([scanner.range_min_m, scanner.range_max_m])
    radii = np.hypot(field.vertices[:-2, 1], field.vertices[:-2, 2])
    assert radii == pytest.approx(scanner.field_radius_m)
    # Outward normals all around: the divergence theorem gives the volume.
    volume = np.einsum("ij,ij->i", field.centroids, field.face_normals) @ field.face_areas / 3
    length = scanner.range_max_m - scanner.range_min_m
    assert volume == pytest.approx(np.pi * scanner.field_radius_m**2 * length, rel=0.01)


def test_the_scanner_looks_along_its_x_axis(subject):
    for point in range(0, len(subject.path), 7):
        pose = scanner_pose(subject.path, point)
        assert pose[:3, 0] == pytest.approx(subject.path.directions[point])
        assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_a_point_is_told_with_its_station_or_why_it_has_none(subject):
    assert "row point" in point_sentence(subject, 0)
    assert point_sentence(subject, 0).endswith("station 0")
    last = len(subject.path) - 1
    assert point_sentence(subject, last).endswith("not scanned: too far away")
    assert "feature point" in point_sentence(subject, last)
    assert point_sentence(subject, last + 1) == "no such point"


def listening(port):
    with socket.socket() as probe:
        probe.settimeout(2.0)
        return probe.connect_ex(("127.0.0.1", port)) == 0


@needs_viser
def test_the_scene_is_served_on_loopback_until_it_is_stopped(subject, capfd):
    with BrowserView(SceneData(subject), 0) as view:
        with urllib.request.urlopen(view.url, timeout=20) as answer:
            assert answer.status == 200
            assert "text/html" in answer.headers["Content-Type"]
            assert b"<html" in answer.read()[:2000].lower()
        assert view.url == f"http://127.0.0.1:{view.port}"
        assert listening(view.port)
    assert not listening(view.port)
    view.stop()
    assert capfd.readouterr().out == ""


@needs_viser
def test_the_scene_has_a_node_for_everything(subject):
    with BrowserView(SceneData(subject), 0) as view:
        scene = view.scene
        assert set(scene.layers) == {
            "floor", "row points", "feature points", "view directions", "rows", "stations",
            "field of view", "tracker", "tracker's range and cone", "arm", "line of sight",
        }  # fmt: skip
        names = {handle.name for handles in scene.layers.values() for handle in handles}
        assert names >= {"/floor", "/part/rows", "/part/row_points", "/part/feature_points"}
        assert names >= {"/stations/0", "/stations/1", "/part/scanner"}
        stations = {h.name: h for h in scene.layers["stations"]}
        assert stations["/stations/1"].position == pytest.approx([0.3, -0.9, 0.0])


@needs_viser
def test_layers_and_colours_follow_the_controls(subject):
    with BrowserView(SceneData(subject), 0) as view:
        scene = view.scene
        rows = scene.layers["rows"][0]
        assert rows.visible
        scene.checkboxes["rows"].value = False
        wait_for(lambda: not rows.visible)
        regions, coverage = scene.surfaces["regions"], scene.surfaces["coverage"]
        assert all(h.visible for h in regions) and not any(h.visible for h in coverage)
        scene.switch.value = "coverage"
        wait_for(lambda: all(h.visible for h in coverage) and not any(h.visible for h in regions))
        field = scene.layers["field of view"][0]
        scene.slider.value = 3
        wait_for(lambda: np.allclose(field.position, subject.path.positions[3], atol=1e-6))
        seen = rotate(transform((0, 0, 0), UPRIGHT), subject.path.directions[3:4])
        assert seen[0] @ [0.0, 1.0, 0.0] > 0.5


def wait_for(condition):
    waited = threading.Event()
    for _ in range(200):
        if condition():
            return
        waited.wait(0.05)
    raise AssertionError("not within 10 s")


@needs_viser
def test_a_part_without_a_plan_can_be_looked_at_too(subject):
    bare = Subject("bare", subject.mesh, subject.segmentation)
    with BrowserView(SceneData(bare), 0) as view:
        assert list(view.scene.layers) == ["floor"]
        assert list(view.scene.surfaces) == ["regions"]


@needs_viser
def test_a_busy_port_gives_way_to_the_next_free_one(subject):
    bare = Subject("bare", subject.mesh, subject.segmentation)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        busy = taken.getsockname()[1]
        with BrowserView(SceneData(bare), busy) as view:
            assert busy < view.port < busy + 20
            assert listening(view.port)


@pytest.mark.parametrize("port", [-1, 65536, 10**9])
def test_what_is_no_port_is_refused(port):
    with pytest.raises(PortBusyError, match="65535"):
        free_port(port)


def test_no_free_port_is_a_named_error():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 65535))
        taken.listen()
        with pytest.raises(PortBusyError, match="--port"):
            free_port(65535)


def test_without_viser_the_error_says_how_to_get_it(subject, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ViewerMissingError, match="pip install"):
        BrowserView(SceneData(subject), 0)


@needs_viser
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_waiting_ends_by_ctrl_c_and_by_terminate(number):
    program = (
        "import threading\n"
        "import meshes\n"
        "from skinplan.mesh.segment import segment_mesh\n"
        "from skinplan.view.browser import BrowserView\n"
        "from skinplan.view.scene_data import SceneData\n"
        "from skinplan.view.subject import Subject\n"
        "mesh = meshes.grid(0.2, 0.1, 0.02)\n"
        "with BrowserView(SceneData(Subject('p', mesh, segment_mesh(mesh))), 0) as view:\n"
        "    told = threading.Timer(0.5, lambda: print(view.port, flush=True))\n"
        "    told.start()  # a signal before the wait has begun would not be the view's\n"
        "    view.wait()\n"
        "print('ended', flush=True)\n"
    )
    folders = os.pathsep.join([os.path.dirname(meshes.__file__), *sys.path])
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": folders},
    )
    try:
        port = int(process.stdout.readline())
        assert listening(port)
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, out.strip()) == (0, "ended"), err
    assert not listening(port)


@needs_viser
def test_the_page_opens_no_tunnel(subject):
    bare = dataclasses.replace(subject, path=None, coverage=None, station_plan=None)
    with BrowserView(SceneData(bare), 0) as view:
        assert view._server.request_share_url() is None


@needs_viser
def test_only_this_machine_is_served(subject):
    bare = Subject("bare", subject.mesh, subject.segmentation)
    with BrowserView(SceneData(bare), 0) as view, socket.socket() as probe:
        probe.settimeout(2.0)
        # A server on all interfaces would answer at every loopback address.
        assert probe.connect_ex(("127.0.0.2", view.port)) != 0
        assert listening(view.port)
