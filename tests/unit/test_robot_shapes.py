import numpy as np

from skinplan.robot.shapes import box_distances, segment_box_distances, segment_distances

SHARES = np.linspace(0.0, 1.0, 201)


def segments(count, seed):
    rng = np.random.default_rng(seed)
    result = rng.uniform(-1.0, 1.0, (count, 2, 3))
    result[:5, 1] = result[:5, 0]  # without length
    result[5:10, 1, 1:] = result[5:10, 0, 1:]  # along x
    return result


def along(segment):
    return segment[0] + SHARES[:, None] * (segment[1] - segment[0])


def test_segment_distances_equal_brute_force():
    first, second = segments(60, 0), segments(60, 1)
    for a, b, found in zip(first, second, segment_distances(first, second), strict=True):
        gaps = np.linalg.norm(along(a)[:, None] - along(b)[None], axis=2)
        assert gaps.min() - 0.015 < found <= gaps.min() + 1e-12


def test_crossing_and_parallel_segments_in_closed_form():
    x = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    y_above = np.array([[0.0, -1, 0.5], [0.0, 1, 0.5]])
    beside = np.array([[3.0, 4, 0], [5.0, 4, 0]])
    assert np.allclose(
        segment_distances(np.stack([x, x]), np.stack([y_above, beside])), (0.5, np.sqrt(20))
    )


def test_segment_box_distances_equal_brute_force():
    low, high = np.array([-0.3, -0.2, -0.4]), np.array([0.2, 0.5, 0.1])
    tested = segments(300, 2)
    for segment, found in zip(tested, segment_box_distances(tested, low, high), strict=True):
        least = box_distances(along(segment), low, high).min()
        assert least - 0.01 < found <= least + 1e-12


def test_distance_is_zero_in_the_box_and_exact_at_face_edge_and_corner():
    low, high = -np.ones(3), np.ones(3)
    points = np.array([[0.0, 0, 0], [3.0, 0, 0], [2.0, 2, 0], [2.0, 2, 2]])
    assert np.allclose(box_distances(points, low, high), (0, 2, np.sqrt(2), np.sqrt(3)))
