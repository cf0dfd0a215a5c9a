"""What is kept of messages of one layout while a bag is read: numbers in columns that grow, and packed times."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from valve_sim.traces.packed_times import PackedTimes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

SECONDS: Final = "header.stamp.sec"
"""Where messages with a header have their stamp; its other part is beside it."""

MOST_APART: Final = 32
"""Numbers of a field that are kept each in a column of its own; those of a longer one, such as an image, together."""


class Field(NamedTuple):
    """Where the numbers of one field are: `size` values of NumPy type `dtype` from byte `offset`."""

    offset: int
    dtype: str
    size: int


class Layout(NamedTuple):
    """The shape of one message.

    Attributes:
        fields: Dotted path ("header.stamp.sec") to the place of its numbers.
        texts: Dotted path to its strings.
        fixed: Byte ranges [start, stop) that another message must share to have this layout: lengths and names.
        end: Where the last field ends; bytes beyond are padding, or invalid.
    """

    fields: Mapping[str, Field]
    texts: Mapping[str, tuple[str, ...]]
    fixed: tuple[tuple[int, int], ...]
    end: int


class Batch(NamedTuple):
    """Messages of one layout.

    Attributes:
        size: How many they are.
        where: Which of the topic's messages they are: a slice, or their places, shape (n,).
        layout: Of each.
        columns: The numbers of the fields kept: (n,) for each of them, or of a long field all of them, (n, k).
        stamps: Of their headers, ns; None where they have none.
    """

    size: int
    where: slice | NDArray[np.intp]
    layout: Layout
    columns: dict[str, list[NDArray[Any]]]
    stamps: PackedTimes | None

    @property
    def places(self) -> NDArray[np.intp]:
        """Where in the topic they are, shape (n,)."""
        return np.arange(self.where.start, self.where.stop) if isinstance(self.where, slice) else self.where

    def numbers(self, path: str, place: int = 0) -> NDArray[Any]:
        """Return one number of a field, shape (n,): a view of what was read, which is not to be changed."""
        columns = self.columns[path]
        return columns[place] if columns[0].ndim == 1 else columns[0][:, place]


class Growing:
    """A batch to which messages are added.

    Byte arrays grow in place, so that nothing is held twice; NumPy arrays would have to be concatenated at the end.

    Args:
        layout: Of the messages.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._count = 0
        self._run: slice | None = None
        self._places = bytearray()
        self._columns: dict[str, list[bytearray]] = {}
        self._stamps: PackedTimes | None = PackedTimes() if SECONDS in layout.fields else None

    def extend(
        self, places: NDArray[np.intp], columns: Mapping[str, NDArray[Any]], stamps: NDArray[np.int64] | None
    ) -> None:
        """Add messages, at least one: ascending places, numbers (n, size) of each field, and their stamps."""
        self._extend_places(places)
        for path, values in columns.items():
            apart = list(values.T) if 0 < values.shape[1] <= MOST_APART else [values]
            known = self._columns.setdefault(path, [bytearray() for _ in apart])
            for grown, numbers in zip(known, apart, strict=True):
                grown.extend(numbers.tobytes())
        if self._stamps is not None and stamps is not None:
            self._stamps.extend(stamps)

    def _extend_places(self, places: NDArray[np.intp]) -> None:
        first, stop = int(places[0]), int(places[-1]) + 1
        if stop - first == len(places) and (not self._count or (self._run is not None and self._run.stop == first)):
            self._run = slice(first if self._run is None else self._run.start, stop)
        else:
            if self._run is not None:
                self._places += np.arange(self._run.start, self._run.stop).tobytes()
                self._run = None
            self._places += places.tobytes()
        self._count += len(places)

    def absorb(self, later: Growing, moved: int) -> None:
        """Add the messages of another, whose places are so much later; it then holds nothing."""
        self._extend_places(later.batch().places + moved)
        for path, known in self._columns.items():
            for grown in known:
                grown.extend(later._columns[path].pop(0))
        if self._stamps is not None and later._stamps is not None:
            self._stamps.absorb(later._stamps)

    def moved(self, by: int) -> Growing:
        """Return the same with later places."""
        if self._run is not None:
            self._run = slice(self._run.start + by, self._run.stop + by)
        else:
            self._places = bytearray((np.frombuffer(self._places, np.intp) + by).tobytes())
        return self

    def batch(self) -> Batch:
        """Return all that were added."""
        where = np.frombuffer(self._places, np.intp) if self._run is None else self._run
        columns = {path: [self._numbers(path, raw) for raw in known] for path, known in self._columns.items()}
        return Batch(self._count, where, self.layout, columns, self._stamps)

    def _numbers(self, path: str, raw: bytearray) -> NDArray[Any]:
        field = self.layout.fields[path]
        numbers = np.frombuffer(raw, field.dtype)
        return numbers if 0 < field.size <= MOST_APART else numbers.reshape(self._count, field.size)
