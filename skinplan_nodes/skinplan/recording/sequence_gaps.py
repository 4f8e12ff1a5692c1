"""Messages that were published but never received, by the publisher's sequence numbers."""


class SequenceGaps:
    """Counts what is missing between the messages of a topic that has one publisher.

    With several, their numbers can't be told apart, and nothing is counted; nor after a number that
    does not rise, until the topic is known to have one publisher again.

    Attributes:
        lost: Messages missing so far.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._last = 0
        self._alone = False

    def note_publishers(self, count: int) -> None:
        """Takes how many publishers the topic has now."""
        if count == 1 and not self._alone:
            self._last = 0
        self._alone = count == 1

    def note(self, number: int | None) -> None:
        """Takes the number of a received message; None = the middleware tells none."""
        if number is None:
            return
        if number <= self._last:
            self._alone = False
        elif self._alone and self._last:
            self.lost += number - self._last - 1
        self._last = number
