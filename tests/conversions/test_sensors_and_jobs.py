"""Round trips of images, markers, clouds, jobs and results; each with its illegal twin."""

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from skinplan_msgs.msg import PartPose

from skinplan.errors import ImageInvalidError, InputError, JobInvalidError
from skinplan.inspection.model import Alignment, Inspection
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.localization.model import CameraModel, Observation, Sighting, WorkpiecePose
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import transform
from skinplan_nodes import conversions as c

NAN = float("nan")
CAMERA = CameraModel(
    64, 48, np.array([[90.0, 0, 32], [0, 91, 24], [0, 0, 1]]), np.array([0.1, -0.2, 0, 0, 0.01])
)


def cloud_of(count):
    random = np.random.default_rng(count)
    points = random.normal(size=(count, 3)).astype(np.float32).astype(float)
    values = {"intensity": np.ones(count), "incidence": np.full(count, 0.5)}
    return c.ScanFrame(points, values, "tracker", 7.5)


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3)])
def test_image_round_trip(shape):
    image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    msg = c.image_to_msg(image, "camera_color_optical_frame", 1.0)
    np.testing.assert_array_equal(c.image_from_msg(msg), image)


def test_image_rgb_becomes_bgr_and_padding_is_left_out():
    image = np.random.default_rng(1).integers(0, 256, (4, 5, 3), dtype=np.uint8)
    padded = np.zeros((4, 20), dtype=np.uint8)
    padded[:, :15] = image.reshape(4, 15)
    msg = Image(height=4, width=5, encoding="rgb8", step=20, data=padded.tobytes())
    np.testing.assert_array_equal(c.image_from_msg(msg), image[:, :, ::-1])


@pytest.mark.parametrize(
    "msg, text",
    [
        (Image(), "encodings"),
        (Image(encoding="mono8"), "0 x 0"),
        (Image(encoding="mono8", width=4, height=2, step=4, data=b"1234567"), "7 bytes"),
        (Image(encoding="16UC1", width=1, height=1, step=2, data=b"12"), "16UC1"),
    ],
)
def test_image_refuses(msg, text):
    with pytest.raises(ImageInvalidError, match=text):
        c.image_from_msg(msg)


def test_camera_round_trip():
    found = c.camera_info_from_msg(c.camera_info_to_msg(CAMERA, "optical"))
    assert (found.width, found.height) == (64, 48)
    np.testing.assert_array_equal(found.K, CAMERA.K)
    np.testing.assert_array_equal(found.D, CAMERA.D)


def test_camera_refuses():
    with pytest.raises(ImageInvalidError, match="0 x 0"):
        c.camera_info_from_msg(CameraInfo())
    msg = c.camera_info_to_msg(CAMERA, "optical")
    msg.distortion_model = "equidistant"
    with pytest.raises(ImageInvalidError, match="equidistant"):
        c.camera_info_from_msg(msg)
    msg.distortion_model = "plumb_bob"
    msg.d = [NAN] * 5
    with pytest.raises(ImageInvalidError, match="finite"):
        c.camera_info_from_msg(msg)


def test_rational_camera_round_trip_and_rectified_region_and_binning():
    D = np.array([0.3, -0.2, 0.001, -0.002, 0.05, 0.2, -0.1, 0.03])
    msg = c.camera_info_to_msg(CameraModel(64, 48, CAMERA.K, D), "optical")
    assert msg.distortion_model == "rational_polynomial"
    np.testing.assert_array_equal(c.camera_info_from_msg(msg).D, D)
    flat = c.camera_info_from_msg(msg, rectified=True)
    np.testing.assert_array_equal(flat.K, CAMERA.K)
    assert not flat.D.any()
    msg.binning_x = msg.binning_y = 2
    msg.roi.x_offset, msg.roi.y_offset, msg.roi.width, msg.roi.height = 8, 4, 32, 24
    part = c.camera_info_from_msg(msg)
    assert (part.width, part.height) == (16, 12)
    np.testing.assert_allclose(part.K[0], [45.0, 0.0, (32 - 8 + 0.5) / 2 - 0.5])


def test_compressed_images_and_what_is_none():
    image = np.random.default_rng(2).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    data = cv2.imencode(".png", image)[1].tobytes()
    np.testing.assert_array_equal(c.compressed_image_from_msg(CompressedImage(data=data)), image)
    for broken in (b"", b"no image", data[: len(data) // 8]):
        with pytest.raises(ImageInvalidError, match="accepted"):
            c.compressed_image_from_msg(CompressedImage(format="png", data=broken))


@pytest.mark.parametrize("count", [0, 2])
def test_observations_round_trip(count):
    def marker(i):
        return Observation(
            id=i,
            size_m=0.1,
            corners=np.arange(8.0).reshape(4, 2),
            corner_covariance=np.eye(8),
            corner_floor_px=0.01,
            T_camera_marker=transform((0, 0, i)),
            covariance=np.diag(np.arange(1.0, 7.0)),
            reprojection_error_px=0.1,
            T_camera_second=transform((0, 1, i)),
            second_error_px=0.5,
            ambiguity_ratio=0.2,
            distance_m=1.0,
            angle_rad=1.5,
            quality=0.9,
        )

    wanted = Sighting(tuple(marker(i) for i in range(count)), (7,), (8,), (9, 10), (11,))
    settings = QualitySettings(alpha=0.4, threshold=0.8)
    msg = c.observations_to_msg(wanted, settings, "optical", 1.0, 0.05)
    found = c.observations_from_msg(msg)
    assert (found.unknown, found.duplicates) == ((7,), (8,))
    assert (found.mirrored, found.covered) == ((9, 10), (11,))
    assert [o.id for o in found.markers] == [o.id for o in wanted.markers]
    for a, b, item in zip(found.markers, wanted.markers, msg.observations, strict=True):
        for name in ("T_camera_marker", "T_camera_second", "covariance", "corners"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12)
        assert (a.quality, a.distance_m, a.angle_rad) == (b.quality, b.distance_m, b.angle_rad)
        assert (item.alpha, item.quality_threshold, item.image_age) == (0.4, 0.8, 0.05)
        assert item.facing == pytest.approx(np.sin(1.5))
        assert item.nearness == pytest.approx(2.0 / 2.3)
    msg.header.frame_id = ""
    with pytest.raises(InputError, match="optical frame"):
        c.observations_from_msg(msg)


def test_part_pose_round_trip_and_mapping_of_the_covariance():
    T_arm_base_camera = transform((1, 2, 3), [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    pose = WorkpiecePose(transform((0, 0, 1)), covariance, 0.2, 0.9, 1.0, 1.5, np.array([3, 4]))
    located = c.LocatedPart.from_camera(pose, T_arm_base_camera, 2.5)
    # The camera's z axis is the arm base's x axis.
    np.testing.assert_allclose(np.diag(located.covariance), [3, 1, 2, 6, 4, 5], atol=1e-12)
    np.testing.assert_allclose(located.T_arm_base_workpiece[:3, 3], [2, 2, 3], atol=1e-12)
    found = c.part_pose_from_msg(c.part_pose_to_msg(located))
    np.testing.assert_allclose(found.T_arm_base_workpiece, located.T_arm_base_workpiece, atol=1e-12)
    np.testing.assert_allclose(found.covariance, located.covariance)
    assert (found.quality, found.stamp_s, found.marker_ids.tolist()) == (0.9, 2.5, [3, 4])


def test_part_pose_refuses_another_frame():
    with pytest.raises(InputError, match="frame 'arm_base'"):
        c.part_pose_from_msg(PartPose())


@pytest.mark.parametrize("count", [0, 1, 500])
def test_scan_frame_round_trip(count):
    scan = cloud_of(count)
    found = c.scan_frame_from_msg(c.scan_frame_to_msg(scan))
    np.testing.assert_array_equal(found.points, scan.points)
    assert list(found.values) == ["intensity", "incidence"]
    np.testing.assert_array_equal(found.values["incidence"], scan.values["incidence"])
    assert found.stamp_s == 7.5


def test_scan_frame_leaves_out_places_without_an_echo():
    points = np.array([[0.0, 0.0, 1.0], [NAN, NAN, NAN], [1.0, 0.0, 1.0]])
    values = {"intensity": np.array([1.0, 2.0, 3.0])}
    found = c.scan_frame_from_msg(c.scan_frame_to_msg(c.ScanFrame(points, values)))
    np.testing.assert_array_equal(found.points, points[[0, 2]])
    np.testing.assert_array_equal(found.values["intensity"], [1.0, 3.0])


def test_scan_frame_reads_other_layouts():
    kind = np.dtype([("z", ">f8"), ("pad", "V4"), ("x", ">f4"), ("y", ">f4")])
    table = np.zeros(2, dtype=kind)
    table["x"], table["y"], table["z"] = [1, 2], [3, 4], [5, 6]
    fields = [
        PointField(name="z", offset=0, datatype=PointField.FLOAT64, count=1),
        PointField(name="x", offset=12, datatype=PointField.FLOAT32, count=1),
        PointField(name="y", offset=16, datatype=PointField.FLOAT32, count=1),
    ]
    msg = PointCloud2(height=2, width=1, fields=fields, is_bigendian=True, point_step=20)
    msg.row_step, msg.data, msg.header.frame_id = 20, table.tobytes(), "tracker"
    found = c.scan_frame_from_msg(msg)
    np.testing.assert_array_equal(found.points, [[1, 3, 5], [2, 4, 6]])


@pytest.mark.parametrize(
    "change, text",
    [
        (lambda m: setattr(m.header, "frame_id", "map"), "frame 'tracker'"),
        (lambda m: setattr(m, "fields", m.fields[1:]), "fields x, y, z"),
        (lambda m: setattr(m, "data", m.data[:-1]), "bytes were announced"),
        (lambda m: setattr(m, "width", 4_000_000), "bytes were announced"),
        (lambda m: setattr(m.fields[2], "offset", 4000), "inside of the"),
        (lambda m: setattr(m.fields[2], "datatype", 99), "PointField"),
    ],
)
def test_scan_frame_refuses(change, text):
    msg = c.scan_frame_to_msg(cloud_of(10))
    change(msg)
    with pytest.raises(InputError, match=text):
        c.scan_frame_from_msg(msg)


def test_scan_frame_refuses_values_that_do_not_fit():
    with pytest.raises(InputError, match="10 values"):
        c.scan_frame_to_msg(c.ScanFrame(np.zeros((10, 3)), {"intensity": np.zeros(9)}))


@pytest.mark.parametrize(
    "job", [Job("a", "/p.yaml"), Job("b", "/p", "ff", "o", "s", "me", -3, (("k", "v"), ("k", "")))]
)
def test_job_round_trip(job):
    assert c.job_from_msg(c.job_to_msg(job)) == job


def test_job_status_round_trip():
    job = Job("a", "/p.yaml")
    record = JobRecord(
        job, JobState.RUNNING, "scanning", 2, 3, 0.5, 12.0, "/runs/a", 1, "", 1_700_000_000_123_456
    )
    found = c.job_status_from_msg(c.job_status_to_msg(record), job)
    assert found == record


def test_job_status_unknown_time_left_and_unknown_state():
    record = JobRecord(Job("a", ""), JobState.ABORTED, error_code=803, error="no")
    msg = c.job_status_to_msg(record)
    assert np.isnan(c.job_status_from_msg(msg).time_left_s)
    assert c.job_status_from_msg(msg).error == "no"
    msg.state = 9
    with pytest.raises(JobInvalidError, match="found 9"):
        c.job_status_from_msg(msg)


def test_inspection_round_trip():
    alignment = Alignment(transform((1, 2, 3)), 1e-4, 12, True)
    inspection = Inspection(alignment, 5, np.zeros(5), 2e-4, 0.98, NAN)
    msg = c.inspection_to_msg(inspection, "job", "/runs/job/cloud.ply")
    found = c.inspection_from_msg(msg)
    np.testing.assert_allclose(
        found.alignment.T_tracker_workpiece, alignment.T_tracker_workpiece, atol=1e-12
    )
    assert (found.points, found.area_ratio, found.deviation_rms_m) == (5, 0.98, 2e-4)
    assert np.isnan(found.feature_area_ratio)
    msg.alignment.position.x = NAN
    with pytest.raises(InputError, match="finite"):
        c.inspection_from_msg(msg)


def test_coverage_progress_round_trip():
    progress = c.CoverageProgress("job", 5, 1, 2, 900, 0.25, 0.125)
    msg = c.coverage_progress_to_msg(progress, 1.0)
    assert c.coverage_progress_from_msg(msg) == progress
    assert np.isnan(c.coverage_progress_to_msg(c.CoverageProgress("job")).area_ratio)
    msg.header.frame_id = "map"
    with pytest.raises(InputError, match="frame 'workpiece'"):
        c.coverage_progress_from_msg(msg)
