"""A model of a machine with recordings of it: what the valve and a machine of a file have in common."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import (
    Array,
    Channel,
    Direction,
    EffectChoice,
    Piece,
    Plant,
    Sensitivities,
)
from valve_sim.model.parameters import Parameter


class Model(Protocol):
    """A machine without its recordings."""

    @property
    def refitted(self) -> Sequence[str]:
        """Parameters that are refitted before any effect is claimed."""

    @property
    def effects(self) -> Mapping[str, EffectChoice]:
        """The effects that may be missing, and declared values that may be wrong, by name."""

    def parameter(self, name: str) -> Parameter:
        """Unit and range of anything that can be freed.

        Raises:
            KeyError: there is none of that name.
        """

    def declared(self, name: str) -> float:
        """The declared value of a parameter, or the value at which an effect's parameter changes nothing."""


Of = TypeVar("Of", bound=Model)


class Prediction(NamedTuple):
    """What the channels show.

    Attributes:
        known: (k,) along which of the directions derivatives are known.
        pieces: stretches of all channels in order, each channel's together; they may be simulated while iterating.
    """

    known: NDArray[np.bool_]
    pieces: Iterable[Piece]


class RecordedPlant(Plant, Generic[Of]):
    """A model of a machine with recordings of it.

    Args:
        model: the machine. channels: all measured signals, recording by recording.

    Attributes:
        model: as given.
    """

    def __init__(self, model: Of, channels: Sequence[Channel]) -> None:
        self.model, self._channels = model, channels

    @property
    def channels(self) -> Sequence[Channel]:
        """The measured channels, recording by recording."""
        return self._channels

    def channels_in(self, recording: int) -> tuple[int, ...]:
        """Indices of the channels of a recording."""
        return tuple(index for index, channel in enumerate(self._channels) if channel.recording == recording)

    @property
    def base(self) -> Sequence[str]:
        """The parameters that the model refits."""
        return self.model.refitted

    @property
    def effects(self) -> Mapping[str, EffectChoice]:
        """The effects of the model, and that its declared values may be wrong."""
        return self.model.effects

    def parameter(self, name: str) -> Parameter:
        """Unit and range of a parameter of the machine or of `<effect>.<parameter>`."""
        return self.model.parameter(name)

    def declared(self, name: str) -> float:
        """The declared value, or the one at which an effect changes nothing."""
        return self.model.declared(name)

    def prediction(self, values: Mapping[str, float], directions: Sequence[Direction] = ()) -> Prediction:
        """What the channels show, in one piece each, with derivatives; arguments: see `sensitivities`."""
        raise NotImplementedError

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """What each channel would show, in its unit."""
        return [piece.shown for piece in self.prediction(values).pieces]

    def sensitivities(self, values: Mapping[str, float], directions: Sequence[Direction]) -> Sensitivities:
        """The derivatives of what `predict` returns, as far as the model has them."""
        known, pieces = self.prediction(values, directions)
        if not known.any():
            return Sensitivities([], known)
        whole = list(pieces)
        return Sensitivities([piece.columns for piece in whole], known, [piece.shown for piece in whole])
