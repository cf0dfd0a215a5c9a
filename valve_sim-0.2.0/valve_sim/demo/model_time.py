"""Model time of messages without a stamp, from the stamps that were published with them."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Final

NANOSECONDS: Final = 1_000_000_000


class ModelTime:
    """Relates the wall's clock to the valve's, by messages that show both.

    valve_node publishes all that belongs to one step at once, the stamped joint states first. So a message without a
    stamp belongs to the last joint states published before it. Its arrival does not tell: on a busy machine one
    topic arrives tens of milliseconds later than another.

    Args:
        speed: model seconds a second.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._published: list[int] = []
        self._stamps: list[int] = []
        self._lead = -math.inf

    @property
    def is_set(self) -> bool:
        """Whether a stamp has come yet."""
        return bool(self._stamps)

    @property
    def latest(self) -> int:
        """The newest stamp, ns."""
        return self._stamps[-1] if self._stamps else 0

    def observe(self, stamp: int, published: int) -> None:
        """A stamp (ns) was published at this time of the wall's clock (ns)."""
        if self._published and published < self._published[-1]:
            return  # the wall's clock was set back; keep the relation known so far
        self._stamps.append(stamp)
        self._published.append(published)
        self._lead = max(self._lead, (stamp - self._stamps[0]) - self._speed * (published - self._published[0]))

    def stamp_of(self, published: int) -> int | None:
        """The stamp (ns) of the step with which something was published; None while that may still be on its way."""
        if not self._published or published >= self._published[-1]:
            return None
        return self._stamps[max(bisect_right(self._published, published) - 1, 0)]

    def at(self, wall: int) -> int:
        """Model time, ns, at a time of the wall's clock, ns, from the stamp with the least delay."""
        if not self._stamps:
            raise RuntimeError("a stamp comes before the first question")
        return self._stamps[0] + round(self._speed * (wall - self._published[0]) + self._lead)
