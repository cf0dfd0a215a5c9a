"""Checked samples of one topic, and what of them is in order and believable."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.traces.clocks import order_samples
from valve_sim.traces.errors import TraceError
from valve_sim.traces.trouble import LARGEST_POSITION

if TYPE_CHECKING:
    from numpy.typing import NDArray

MOST_REPEATED: Final = 0.05
"""Share of samples that may have another sample's stamp; beyond it nobody can say which is right."""
BROKEN_READING: Final = 1.0
"""m; what is beyond this among metres is no position, and what is a million times beyond it is none in any unit."""
MICROMETRES: Final = 1e6
"""In a metre."""


class Samples(NamedTuple):
    """Checked messages of one topic: stamps and bag times in ns, values (n, columns)."""

    stamps: NDArray[np.int64]
    bag_times: NDArray[np.int64]
    values: NDArray[np.float64]

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Samples:
        """Return some of the samples; of all of them no copy, which of a long recording would be large."""
        if chosen.dtype == np.bool_ and chosen.all():
            return self
        return Samples(self.stamps[chosen], self.bag_times[chosen], self.values[chosen])


class Readings(NamedTuple):
    """What one source recorded.

    Attributes:
        bag_times: When each message was recorded, ns, shape (n,).
        stamps: When it was taken by its header, ns; the bag time where `is_stamped` is False.
        is_stamped: Whether the header holds a time, and is to be used.
        values: SI (°C for temperatures), NaN where a message has none.
    """

    bag_times: NDArray[np.int64]
    stamps: NDArray[np.int64]
    is_stamped: NDArray[np.bool_]
    values: NDArray[np.float64]

    def without_repeated(self, late: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return ascending times, ns, and values, the first of those of one time.

        Args:
            late: What to take from bag times to get the stamps' clock, ns.
        """
        times = np.where(self.is_stamped, self.stamps, self.bag_times - late)
        if (times[1:] > times[:-1]).all():
            return times, self.values
        times, first = np.unique(times, return_index=True)
        return times, self.values[first]


def is_broken(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n, 2) readings that no plunger can have, as broken messages hold; other units than metres are no break."""
    sizes = np.where(np.isfinite(values), values, 0.0)
    np.abs(sizes, out=sizes)
    is_metres = float(np.median(sizes[:, 0])) <= LARGEST_POSITION
    return np.asarray(sizes > (BROKEN_READING if is_metres else BROKEN_READING * MICROMETRES))


def in_order(samples: Samples, where: str, topic: str) -> tuple[Samples, int, tuple[str, ...]]:
    """Return samples with strictly ascending stamps, how far their clock leads that of the commands, ns, and findings.

    Args:
        samples: As recorded.
        where: File and topic, for errors.
        topic: For findings.

    Raises:
        TraceError: No stamp can be believed, or too many samples share one.
    """
    ordered = order_samples(samples.stamps, samples.bag_times, samples.values, topic)
    if len(ordered.places) == 0:
        raise TraceError(
            f"{where}: none of {len(samples.stamps)} samples has a stamp that can be believed; "
            "stamp them with the time of sampling"
        )
    if ordered.changes:
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
