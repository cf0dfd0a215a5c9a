"""Checked samples of one topic, and what of them is in order and believable."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.recordings.clocks import order_samples
from valve_sim.recordings.trace import TraceError
from valve_sim.recordings.trouble import LARGEST_POSITION

if TYPE_CHECKING:
    from numpy.typing import NDArray

MOST_REPEATED: Final = 0.05
"""Share of samples that may have another sample's stamp; beyond it nobody can say which is right."""
BROKEN_READING: Final = 1.0
"""m; what is beyond this among metres is no position, and what is a million times beyond it is none in any unit."""
MICROMETRES: Final = 1e6
"""In a metre."""


class Samples(NamedTuple):
    """Checked positions of one topic, or what is in their place.

    Attributes:
        stamps: ns, shape (n,).
        delays: What bag times are after them, ns, shape (n,).
        pilot: Shape (n,).
        main: Shape (n,); NaN where there is none.
    """

    stamps: NDArray[np.int64]
    delays: NDArray[np.integer]
    pilot: NDArray[np.float64]
    main: NDArray[np.float64]

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Samples:
        """Return some of the samples."""
        return Samples(self.stamps[chosen], self.delays[chosen], self.pilot[chosen], self.main[chosen])


class Readings(NamedTuple):
    """What one source recorded.

    Attributes:
        stamps: When it was taken by its header, ns, shape (n,); the bag time where `is_stamped` is False.
        delays: What bag times are after the stamps, ns, shape (n,).
        is_stamped: Whether the header holds a time, and is to be used.
        values: SI (°C for temperatures), NaN where a message has none; a view of what was read, not to be changed.
    """

    stamps: NDArray[np.int64]
    delays: NDArray[np.integer]
    is_stamped: NDArray[np.bool_]
    values: NDArray[np.float64]

    def times(self, late: int) -> NDArray[np.int64]:
        """Return when each was taken by the stamps' clock, ns, shape (n,).

        Args:
            late: What to take from bag times to get that clock, ns.
        """
        return np.where(self.is_stamped, self.stamps, self.stamps - late)

    def without_repeated(self, late: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return ascending times, ns, and values, the first of those of one time.

        Args:
            late: As of `times`.
        """
        times = self.times(late)
        if (times[1:] > times[:-1]).all():
            return times, self.values
        times, first = np.unique(times, return_index=True)
        return times, self.values[first]


def is_broken(pilot: NDArray[np.float64], main: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) readings of either that no plunger can have, as broken messages hold; another unit than m is no break."""
    sizes = np.nan_to_num(np.abs(np.stack([pilot, main])), posinf=0.0)
    is_metres = np.median(sizes[0]) <= LARGEST_POSITION
    return np.asarray(sizes > BROKEN_READING * (1.0 if is_metres else MICROMETRES))


def in_order(samples: Samples, where: str, topic: str) -> tuple[Samples, int, tuple[str, ...]]:
    """Return samples with strictly ascending stamps, how far their clock leads that of the commands, ns, and findings.

    Args:
        samples: As recorded.
        where: File and topic, for errors.
        topic: For findings.

    Raises:
        TraceError: No stamp can be believed, or too many samples share one.
    """
    ordered = order_samples(samples.stamps, samples.delays, (samples.pilot, samples.main), topic)
    if ordered.places is None:
        return samples, ordered.shift, ordered.findings
    if len(ordered.places) == 0:
        raise TraceError(
            f"{where}: none of {len(samples.stamps)} samples has a stamp that can be believed; "
            "stamp them with the time of sampling"
        )
    samples = samples.take(ordered.places)
    fresh = np.concatenate([[True], samples.stamps[1:] > samples.stamps[:-1]])
    repeated = int((~fresh).sum())
    if repeated > MOST_REPEATED * len(fresh):
        raise TraceError(
            f"{where}: {repeated} of {len(fresh)} samples have the stamp of another sample but "
            "another value; two publishers, a clock set back or coarse stamps; record one, finely stamped"
        )
    findings = ordered.findings
    if repeated:
        words = f"dropped {repeated} of {len(fresh)} samples that differ from another sample of the same stamp"
        findings = (*findings, f"{topic}: {words}")
    return samples.take(fresh), ordered.shift, findings
