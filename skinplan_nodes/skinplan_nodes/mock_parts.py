"""What the mock devices share: their parameters and the part that stands before them."""

from types import SimpleNamespace

from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan_nodes.parameters import CELL_FILE, Parameter
from skinplan_nodes.part_cache import part_path

PART_URI = Parameter(
    "part_uri",
    "",
    "Part that stands in the mock cell: absolute path or file:// URI of a part.yaml.",
)
SEED = Parameter("seed", 1, "Seed of every random draw of this mock [1].", 0, 2**31 - 1)
STATE_FILE = Parameter(
    "state_file",
    "",
    "Absolute path of a file with where the device stands, for a process that is started again; "
    "empty = it begins anew.",
)
#: Parameters of a mock that knows the part.
SHOP = (CELL_FILE, PART_URI, SEED)


def part_of(values: SimpleNamespace) -> Part:
    """Returns the part that stands in the mock cell.

    Raises:
        PartNotFoundError: There is no such part file.
        PartInvalidError: The part file can't be used.
    """
    return load_part(part_path(values.part_uri))
