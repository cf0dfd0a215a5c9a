"""What any recording gives before it is known what it is of: columns of numbers, each with its times."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from valve_sim.files.recording_map import Source
    from valve_sim.model.drives import Drive
    from valve_sim.recordings.trace import DriveErrors

    Array = NDArray[np.float64]


class Readings(NamedTuple):
    """What one place recorded.

    Attributes:
        times: s after the recording begins, strictly ascending, shape (n,).
        values: as recorded, shape (n,); NaN where a message or a cell has none.
        repeated: how many were left out, because another one has their time.
    """

    times: Array
    values: Array
    repeated: int = 0


class OpenRecording(Protocol):
    """A recording that is open. Its methods raise a `TraceError` of one line where a place is not as it should be.

    Attributes:
        path: The file, for messages.
        findings: What was dropped or repaired so far, a line each.
        is_table: Whether places are columns of rows, of which some cells may be empty.
        clock: What the times are: "header", "bag", "time column", "rate".
        timed_by: That in words, where the file or a map says it; else empty.
    """

    path: Path
    findings: list[str]
    is_table: bool
    clock: str
    timed_by: str

    @property
    def epoch_ns(self) -> int:
        """When the recording begins, ns since 1970."""

    def are_beside(self, first: Source, other: Source) -> bool:
        """Whether two places are in the same messages or rows."""

    def rows(self, key: str, source: Source) -> Array:
        """The numbers of a place as they lie in the file, (n,), not to be changed; `key` is for messages."""

    def ordered(self, key: str, source: Source, use: NDArray[np.bool_], columns: Sequence[Array]) -> Sequence[Array]:
        """Take some rows of one place for the samples: their columns in the order of time.

        The recording begins with the first of them, and their clock counts for all other places.
        """

    def begin(self, sources: Iterable[tuple[str, Source]]) -> None:
        """Begin the recording no later than the first message of some places; a table begins with its first row."""

    @property
    def sample_times(self) -> Array:
        """When the samples were taken, s, strictly ascending, shape (n,)."""

    def readings(self, key: str, source: Source) -> Readings:
        """The numbers of a place, in the order of time."""

    def commands(self, source: Source, logs: Sequence[str]) -> tuple[Drive, DriveErrors | None]:
        """Commanded voltages and how well they are known, if anything says it; `logs`: topics of who sent them."""
