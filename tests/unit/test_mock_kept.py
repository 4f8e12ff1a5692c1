"""Where a device stands, kept on disk; and devices that are put there."""

from pathlib import Path

import numpy as np
import pytest

from skinplan.errors import InputError, JointsInvalidError
from skinplan.mock.arm import MockArm
from skinplan.mock.base import BaseConfig, MockBase
from skinplan.mock.kept import KeptState
from skinplan.robot.cell import CellConfig
from skinplan.transforms import planar


def test_what_was_written_is_read_by_another(tmp_path: Path) -> None:
    path = str(tmp_path / "arm.state")
    kept = KeptState(path, 3)
    assert kept.read(100.0) is None
    kept.write(5.0, np.array([1.0, 2.0, 3.0]))
    kept.write(7.0, np.array([1.0, 2.0, 4.0]))
    kept.close()
    again = KeptState(path, 3)
    np.testing.assert_array_equal(again.read(7.0), [1.0, 2.0, 4.0])
    assert again.read(6.9) is None, "of another run: its clock began anew"
    assert KeptState(path, 4).read(9.0) is None
    assert KeptState("", 3).read(9.0) is None


@pytest.mark.parametrize("place", [0, 6, 20])
def test_a_damaged_file_counts_as_none(tmp_path: Path, place: int) -> None:
    path = tmp_path / "arm.state"
    kept = KeptState(str(path), 3)
    kept.write(1.0, np.arange(3.0))
    data = bytearray(path.read_bytes())
    data[place] ^= 0x10
    path.write_bytes(data)
    assert kept.read(2.0) is None


def test_a_file_that_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can be written"):
        KeptState(str(tmp_path / "no" / "arm.state"), 3)


def test_an_arm_stands_where_it_is_put() -> None:
    arm = MockArm(("a", "b"), [-1.0, -1.0], [1.0, 1.0], 1.0, [0.0, 0.0])
    arm.place([0.5, -0.5], 3.0)
    np.testing.assert_array_equal(arm.state(9.0)[0], [0.5, -0.5])
    with pytest.raises(JointsInvalidError):
        arm.place([2.0, 0.0], 3.0)


def test_a_base_stands_where_another_stood() -> None:
    first = MockBase(BaseConfig(slip_probability=1.0), CellConfig(), 3)
    first.goal(planar(1.0, 0.5, 0.4))
    first.step(100.0)
    first.jump(0.07)
    second = MockBase(BaseConfig(), CellConfig(), 8)
    second.place(first.stand())
    for name in ("true", "believed", "odometry"):
        np.testing.assert_allclose(getattr(second, name), getattr(first, name), atol=1e-12)
    second.step(200.0)
    assert not second.moving
    with pytest.raises(InputError, match="11"):
        second.place(np.zeros(3))
