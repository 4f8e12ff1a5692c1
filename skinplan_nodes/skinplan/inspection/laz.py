"""Clouds as compressed LAS (LAZ 1.4), for programs of surveyors."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from skinplan.errors import CloudInvalidError
from skinplan.transforms import Array
from skinplan.whole_file import whole_file

# LAS keeps whole multiples of this [m].
_STEP_M = 1e-6
_BATCH = 500_000


def write_laz(path: Path, points: Array, values: Mapping[str, Array]) -> None:
    """Writes points with further values, each as a 32-bit extra dimension.

    Args:
        path: The file.
        points: shape (n, 3) [m].
        values: By name, each shape (n,); ``intensity`` is called ``returned_light`` there, because
            LAS has whole numbers of that name.

    Raises:
        CloudInvalidError: The file can't be written.
    """
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, _STEP_M)
    header.offsets = np.floor(points.min(axis=0)) if len(points) else np.zeros(3)
    named = {("returned_light" if k == "intensity" else k): v for k, v in values.items()}
    header.add_extra_dims([laspy.ExtraBytesParams(name, "f4") for name in named])
    try:
        with (
            whole_file(path) as temporary,
            laspy.open(str(temporary), mode="w", header=header, do_compress=True) as stream,
        ):
            for begin in range(0, len(points), _BATCH):
                part = slice(begin, begin + _BATCH)
                record = laspy.ScaleAwarePointRecord.zeros(len(points[part]), header=header)
                record.x, record.y, record.z = points[part].T
                for name, value in named.items():
                    record[name] = value[part].astype(np.float32)
                stream.write_points(record)
    except (OSError, ValueError) as error:
        raise CloudInvalidError(f"{path}: the cloud can't be written ({error})") from error
