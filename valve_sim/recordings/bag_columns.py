"""The fields of a bag's messages, each at the times of its own topic, brought to one clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from valve_sim.files.channels import MAIN
from valve_sim.files.recording_map import Source
from valve_sim.model.drives import Drive
from valve_sim.recordings.clocks import SECOND, clock_offset, clock_rate, order_samples
from valve_sim.recordings.command_times import Commands, commands_by_logs
from valve_sim.recordings.layout import POSITIONS, valves_among
from valve_sim.recordings.open_recording import Readings
from valve_sim.recordings.topics import Stamps
from valve_sim.recordings.trace import TraceError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from valve_sim.recordings.storage import Recording
    from valve_sim.recordings.topics import Batch, Topic
    from valve_sim.recordings.trace import DriveErrors

    Array = NDArray[np.float64]

MOST_RATE: Final = 100.0
"""So many times faster or slower than a recorder's no clock of a simulation runs."""
MOST_REPEATED: Final = 0.05
"""Share of samples that may have another sample's stamp; beyond it nobody can say which is right."""


class BagColumns:
    """A bag as `OpenRecording` has it; `where` is the map that names its topics, for messages; empty: this package."""

    is_table = False
    timed_by = ""

    def __init__(self, path: Path, recording: Recording, where: str = "") -> None:
        self.path, self.findings, self._recording, self._where = path, list(recording.findings), recording, where
        self.clock = "header"
        self.epoch_ns = 0
        self._late = 0
        """What to take from bag times to get the samples' clock, ns."""
        self._rate, self._recorded_at = 1.0, np.empty(0, dtype=np.int64)
        """What the samples' clock advances in a second of bag time, and when each sample was recorded, ns."""
        self._samples = np.empty(0, dtype=np.int64)
        self._reported: set[str] = set()

    def are_beside(self, first: Source, other: Source) -> bool:
        """See `OpenRecording`."""
        return first.topic == other.topic

    def _topic(self, name: str) -> Topic:
        topic = self._recording.topic(self.path, name)
        if name not in self._reported:
            self._reported.add(name)
            if topic.malformed:
                self.findings.append(f"{name}: dropped {topic.malformed} of {topic.size} messages that cannot be read")
            if topic.trimmed:
                self.findings.append(f"{name}: trimmed surplus bytes after {topic.trimmed} of {topic.size} messages")
        return topic

    def rows(self, key: str, source: Source) -> Array:
        """See `OpenRecording`."""
        found = self._recording.types[source.topic]
        if source.type not in ("", found):
            raise TraceError(
                f"{self.path}: topic {source.topic} is {found}, expected {source.type}; publish it as that"
            )
        values, without = self._topic(source.topic).values(source)
        if without is not None and np.isnan(values).all():
            raise TraceError(self._no_field(key, source, without))
        return values

    def _no_field(self, key: str, source: Source, batch: Batch) -> str:
        found = batch.what_lacks(source)
        if self._where:
            return f"{self._where}: {key}: topic {source.topic} of {self.path} {found}"
        if "names" not in found or source.joint in batch.joints:
            return f"{self.path}: topic {source.topic}: no finite {source.joint} position; fill the position array"
        return f"{self.path}: topic {source.topic} {found} (and {MAIN}); name the joints so"

    def _stamps(self, key: str, source: Source) -> Stamps:
        # Model time begins at 0, where a sample may be; in other messages, 0 means that they were not stamped.
        stamps = self._topic(source.topic).stamps(source.clock, may_be_zero=key in POSITIONS)
        if self._where and source.clock == "header" and not stamps.is_stamped.any():
            raise TraceError(
                f"{self._where}: {key}: clock: header, but the messages of {source.topic} "
                f"({self._recording.types[source.topic]}) have no stamp; use clock: bag"
            )
        return stamps

    def _times(self, key: str, source: Source) -> NDArray[np.int64]:
        """When each message was taken by the samples' clock, ns, shape (n,)."""
        taken, _, is_stamped = self._stamps(key, source)
        return np.where(is_stamped, taken, self._by_samples(taken)) if self._late or self._rate != 1.0 else taken

    def _by_samples(self, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """Bag times by the samples' clock, ns, shape (n,)."""
        if self._rate == 1.0:
            return times - self._late
        first, start = self._recorded_at.min(), self._samples[0]
        order = np.argsort(self._recorded_at, kind="stable")
        seen = self._recorded_at[order] - first
        beside = np.interp(times - first, seen, self._samples[order] - start - self._rate * seen)
        return np.asarray(start + np.rint(self._rate * (times - first) + beside), dtype=np.int64)

    def _since(self, times: NDArray[np.int64]) -> Array:
        return np.asarray((times - self.epoch_ns) / SECOND, dtype=np.float64)

    def ordered(self, key: str, source: Source, use: NDArray[np.bool_], columns: Sequence[Array]) -> Sequence[Array]:
        """See `OpenRecording`."""
        taken, delays, is_stamped = self._stamps(key, source)
        taken, delays = taken[use], delays[use]
        columns = [column[use] for column in columns]
        if not is_stamped.any():
            self.clock = "bag"
        elif len(taken) > 1 and (taken == taken[0]).all():
            self.findings.append(f"{source.topic}: all header stamps are the same: samples are timed by bag time")
            self.clock, taken, delays = "bag", taken + delays, np.zeros_like(taken)
        self._rate = clock_rate(delays, taken + delays)
        if not 1.0 / MOST_RATE < self._rate < MOST_RATE:
            self.findings.append(
                f"{source.topic}: header stamps advance by {self._rate:.3g} s in a second of recording, as if in "
                "another unit: samples are timed by bag time"
            )
            self.clock, self._rate, taken, delays = "bag", 1.0, taken + delays, np.zeros_like(taken)
        order = order_samples(taken, delays, columns, source.topic)
        self.findings += order.findings
        if order.places is not None:
            places = order.places
            if not len(places):
                raise TraceError(
                    f"{self.path}: topic {source.topic}: none of {len(taken)} samples has a stamp that can be "
                    "believed; stamp them with the time of sampling"
                )
            fresh = np.diff(taken[places], prepend=taken[places[0]] - 1) > 0
            self._check_repeated(source.topic, int((~fresh).sum()), len(fresh))
            places = places[fresh]
            taken, delays, columns = taken[places], delays[places], [column[places] for column in columns]
        self.epoch_ns, self._samples, self._recorded_at = int(taken[0]), taken, taken + delays
        if self._rate != 1.0:
            self.findings.append(
                f"{source.topic}: the stamps' clock advances by {self._rate:.3g} s in a second of bag time, as that of "
                "a simulation: commands and other messages without a header were moved onto it, good to the transport "
                "delay only"
            )
            return columns
        offset, findings = clock_offset(delays + order.shift if order.shift else delays, source.topic)
        self.findings += findings
        self._late = offset - order.shift
        return columns

    def _check_repeated(self, topic: str, repeated: int, count: int) -> None:
        if repeated > MOST_REPEATED * count:
            raise TraceError(
                f"{self.path}: topic {topic}: {repeated} of {count} samples have the stamp of another sample but "
                "another value; two publishers, a clock set back or coarse stamps; record one, finely stamped, or "
                "give clock: bag in a map"
            )
        if repeated:
            words = f"dropped {repeated} of {count} samples that differ from another sample of the same stamp"
            self.findings.append(f"{topic}: {words}")

    def begin(self, sources: Iterable[tuple[str, Source]]) -> None:
        """See `OpenRecording`."""
        first = [int(np.min(self._times(key, source))) for key, source in sources]
        self.epoch_ns = min([*first, *self._samples[:1].tolist()], default=0)

    @property
    def sample_times(self) -> Array:
        """See `OpenRecording`."""
        return self._since(self._samples)

    def readings(self, key: str, source: Source) -> Readings:
        """See `OpenRecording`: the last number of those of one time."""
        values, times = self.rows(key, source), self._times(key, source)
        if (times[1:] > times[:-1]).all():
            return Readings(self._since(times), values)
        order = np.lexsort((np.isfinite(values), times))
        last = order[np.diff(times[order], append=times[order[-1]] + 1) > 0]
        return Readings(self._since(times[last]), values[last], len(times) - len(last))

    def commands(self, source: Source, logs: Sequence[str]) -> tuple[Drive, DriveErrors | None]:
        """See `OpenRecording`: as they were sent, where who sent them logged it; else as they were recorded."""
        volts, times = source.to_si(self.rows("command", source), "voltage"), self._times("command", source)
        finite = np.isfinite(volts)
        if not finite.any():
            raise TraceError(
                f"{self.path}: topic {source.topic}: none of {len(volts)} commands is a finite voltage; record it again"
            )
        if not finite.all():
            self.findings.append(
                f"{source.topic}: dropped {(~finite).sum()} of {len(volts)} commands that are not finite"
            )
        order = np.flatnonzero(finite)[np.argsort(times[finite], kind="stable")]
        found = Commands(times[order], volts[order])
        if len(order) > 1 and found.times[0] == found.times[-1] and np.ptp(found.volts) > 0.0:
            raise TraceError(
                f"{self.path}: topic {source.topic}: all {len(order)} commands have one time, expected that of each; "
                "record them again, or record the coil's voltage with a stamp"
            )
        found = self._sent(source, found, logs) if logs else found
        last = np.diff(found.times, append=found.times[-1] + 1) > 0
        if not last.all():
            self.findings.append(f"{source.topic}: {(~last).sum()} commands were replaced by another at the same time")
        return Drive(self._since(found.times[last]), found.volts[last]), None

    def _sent(self, source: Source, recorded: Commands, topics: Sequence[str]) -> Commands:
        logs = []
        for topic in topics:
            messages = self._recording.topics.get(topic)
            if messages is None or not messages.batches:
                continue
            stamps, _, is_stamped = messages.stamps(may_be_zero=True)
            stamps, volts = stamps[is_stamped], messages.values(Source(topic, "voltage"))[0][is_stamped]
            order = np.argsort(stamps, kind="stable")
            # The node's clock is the samples' clock, or the recorder's.
            logs.append(Commands(stamps[order], volts[order]))
            if self._late or self._rate != 1.0:
                logs.append(Commands(self._by_samples(stamps[order]), volts[order]))
        found = commands_by_logs(recorded, logs)
        if found is None and len(valves_among(self._recording.types)) == 1:
            self.findings.append(f"{source.topic}: timed as recorded, for {', '.join(topics)} logs other commands")
        return recorded if found is None else found
