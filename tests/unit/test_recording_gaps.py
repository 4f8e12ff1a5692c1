"""What was published but never received is counted, and nothing that was not."""

import pytest

from skinplan.recording.sequence_gaps import SequenceGaps


def gaps(*numbers: int | None, publishers: int = 1) -> SequenceGaps:
    found = SequenceGaps()
    found.note_publishers(publishers)
    for number in numbers:
        found.note(number)
    return found


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [((), 0), ((7, 8, 9), 0), ((7, 9, 10, 15), 5), ((None, None), 0), ((3, None, 5), 1)],
)
def test_missing_numbers_of_the_only_publisher_are_counted(
    numbers: tuple[int | None, ...], lost: int
) -> None:
    assert gaps(*numbers).lost == lost


def test_several_publishers_are_not_counted() -> None:
    assert gaps(1, 500, 2, 501, 90, publishers=2).lost == 0


def test_a_publisher_that_nobody_has_noticed_yet_does_not_count_as_a_gap() -> None:
    assert gaps(500, 1, 501, 2, 502).lost == 0


def test_counting_goes_on_with_the_publisher_that_is_left() -> None:
    found = gaps(500, 1, 501)
    found.note_publishers(2)
    found.note(700)
    found.note_publishers(1)
    for number in (800, 801, 803):
        found.note(number)
    assert found.lost == 1
