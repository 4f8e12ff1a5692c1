"""JSON documents on disk: whole or not at all, without NumPy types."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skinplan.whole_file import whole_file


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Writes a JSON file in one step: a reader sees the old one or the new one, never half."""
    text = json.dumps(plain(document), indent=1, allow_nan=False)
    with whole_file(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """Returns a document without NumPy types, in which NaN and infinities are None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
