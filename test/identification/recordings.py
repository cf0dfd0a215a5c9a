"""Recordings by the independent plant, as traces: one builder for all tests that want one."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Profile, Recorder, record, single_opening, train_profile

from benchmarks.campaign.declared import as_trace
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.plants.protocol import Channel, EffectChoice, ForceMap
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive, Valve
from valve_sim.recordings import Trace

FINE = Recorder(quantisation=0.1e-6, sample_rate=10e3)
COARSER = Recorder(quantisation=0.1e-6, sample_rate=5e3)
TRUTH = {"pilot_damping": 1.4, "main_damping": 3.2}
"""N·s/m, neither of them declared."""


class Short(ValvePlant):
    """A valve of whose catalogue few effects are tried, all declared values and, unless told, no curves."""

    def __init__(self, traces: Sequence[Trace], valve: Valve, few: Sequence[str], *, with_curves: bool = False) -> None:
        super().__init__(traces, valve)
        self._few, self._with_curves = few, with_curves

    @property
    def force_maps(self) -> Sequence[ForceMap]:  # type: ignore[override]
        return super().force_maps if self._with_curves else ()

    @functools.cached_property
    def effects(self) -> Mapping[str, EffectChoice]:  # type: ignore[override]
        every = super().effects
        return {name: every[name] for name in every if name in self._few or every[name].is_declared_value}


def recorded(
    recorder: Recorder = FINE,
    profile: Profile | None = None,
    seed: int = 1,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    **parameters: float | tuple[float, float, float, float],
) -> Trace:
    """What a plant of these parameters and effects shows, 8 strokes unless told; the current, where one is recorded."""
    plant = DeclaredPlant(effects or {}, {**CAMPAIGN_VALVE, **TRUTH, **parameters})
    return as_trace(record(plant, train_profile() if profile is None else profile, recorder, seed), f"seed {seed}")


FEW = ("coulomb_friction", "stiction", "constant_force")
"""A catalogue that is short, and has friction and what looks like it."""


@functools.cache
def friction_found() -> Diagnosis:
    """Friction of 0.1 N that no file declares, found in one recording and held against another; made once a process."""
    valve, friction = default_valve().exact(), {"coulomb_friction": {"force": 0.1}}
    train, other = (Short([recorded(COARSER, seed=seed, effects=friction)], valve, FEW) for seed in (1, 2))
    return diagnose_plant(train, other)


def one_opening(seed: int = 1, **parameters: float) -> Trace:
    """One opening at 9 V, never released."""
    return recorded(profile=single_opening(), seed=seed, **parameters)


def still(values: np.ndarray, kind: str = "position") -> Channel:
    """A channel of a machine that never moves."""
    count = len(values)
    return Channel("test", kind, np.arange(count) / 20e3, values, np.ones(count, bool), np.zeros(count, np.int64))


def shortened(trace: Trace, stop: float) -> Trace:
    """The part before `stop`, s."""
    kept, commands = trace.times < stop, trace.drive.times < stop
    return replace(
        trace,
        drive=Drive(trace.drive.times[commands], trace.drive.volts[commands]),
        times=trace.times[kept],
        pilot_position=trace.pilot_position[kept],
        main_position=None,
    )
