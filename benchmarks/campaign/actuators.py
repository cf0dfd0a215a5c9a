# ruff: noqa: D103, E501 -- the rates of each kind are a line of physics, and the plants are YAML as users write it
"""Made-up actuators of ten kinds, each described by a file as users write it, and lacking one effect or none.

The truth comes from small steps written here (midpoint rule, dry friction as what takes a velocity towards 0), not from
the package. Declared values are off as their tolerances allow. A round is two hundred; one in five lacks nothing.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import yaml
from numba import njit

from benchmarks.campaign.bench import Bench
from valve_sim.files.plant_files import plant_from
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.estimation.budget import Budget
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.traces.columns import read

SUBSTEPS: Final = 60
ROUND: Final = 200
"""Actuators."""
SECONDS: Final = 120.0
"""That stand for the work of a diagnosis."""
NOISE: Final = 2e-3
"""Of the range of what is shown."""


class Kind(NamedTuple):
    """A kind of actuator.

    Attributes:
        plant: its file, as a user writes it. values: true values of its parameters.
        effects: usual size of each effect, in the order in which `rates` takes them.
        rates: of (states, input, values, sizes of effects).
        slides: which state the first effect takes towards 0 as dry friction, -1 for none; inertia: place of its inertia.
        drive: amplitude, and "sines" or "steps". duration: s. rate: Hz.
    """

    plant: str
    values: tuple[float, ...]
    effects: dict[str, float]
    rates: Callable[..., Any]
    slides: int
    inertia: int
    drive: tuple[float, str]
    duration: float
    rate: float


@njit
def march(rates, slides, inertia, start, times, inputs, p, e):  # type: ignore[no-untyped-def]
    shown = np.zeros((len(times), len(start)))
    s = start.copy()
    for i in range(len(times)):
        shown[i] = s
        if i == len(times) - 1:
            break
        h = (times[i + 1] - times[i]) / SUBSTEPS
        for k in range(SUBSTEPS):
            u0 = inputs[i] + (inputs[i + 1] - inputs[i]) * k / SUBSTEPS
            u1 = inputs[i] + (inputs[i + 1] - inputs[i]) * (k + 0.5) / SUBSTEPS
            half = s + 0.5 * h * rates(s, u0, p, e)
            s = s + h * rates(half, u1, p, e)
            if slides >= 0:
                v = s[slides]
                s[slides] = np.sign(v) * max(0.0, abs(v) - h * (e[0] / p[inertia]))
    return shown


@njit
def axis_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    x, v = s[0], s[1]
    force = u - p[1] * v + e[1] - e[2] * v * abs(v) - e[3] * x
    return np.array([v, force / p[0]])


@njit
def arm_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    q, w = s[0], s[1]
    return np.array([w, (u - p[1] * w - e[1] * np.sin(q) + e[2] - e[3] * q) / p[0]])


@njit
def spring_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    x, v = s[0], s[1]
    return np.array([v, (u - p[1] * v - p[2] * x - e[1] * x**3 + e[2] - e[3] * v * abs(v)) / p[0]])


@njit
def coil_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    i = s[0]
    drop = e[0] * np.tanh(i / 1e-6) if e[0] > 0.0 else 0.0
    return np.array([(u - p[0] * i - drop + e[1]) * (1.0 + e[2] * i * i) / p[1]])


@njit
def tank_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    h = s[0]
    return np.array([(u - p[0] * np.sqrt(h + 0.01) - e[0] * h - e[1] * max(0.0, h - 0.35) + e[2]) / p[1]])


@njit
def heater_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    t = s[0]
    return np.array([(p[0] * u - t - e[0] * t * t + e[1] - e[2] * max(0.0, t - 30.0)) / p[1]])


@njit
def motor_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    i, w = s[0], s[1]
    return np.array([(u - p[0] * i - p[1] * w) / p[2], (p[1] * i - p[3] * w + e[1] - e[2] * w * abs(w)) / p[4]])


@njit
def voice_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    i, x, v = s[0], s[1], s[2]
    pull = p[1] * (1.0 - e[1] * x * x) * i
    return np.array(
        [(u - p[0] * i - p[1] * (1.0 - e[1] * x * x) * v) / p[2], v, (pull - p[3] * v - p[4] * x + e[2]) / p[5]]
    )


@njit
def valve_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    y, x = s[0], s[1]
    through = y - max(-e[0], min(e[0], y))
    return np.array([(u - y) / p[0], p[1] * through + e[1] - e[2] * x])


@njit
def two_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    a, va, b, vb = s[0], s[1], s[2], s[3]
    twist = a - b
    pull = p[2] * twist + p[3] * (va - vb) + e[2] * twist**3
    return np.array([va, (u - pull - p[4] * va) / p[0], vb, (pull - e[1] * vb * abs(vb) + e[3]) / p[1]])


KINDS: Final[dict[str, Kind]] = {
    "slide": Kind(
        """
states: {x: {unit: m}, v: {unit: m/s}}
inputs: {force: {unit: N}}
parameters: {mass: {value: 4, unit: kg, tolerance: 0.04}, viscous: {value: 8, unit: N*s/m, free: true, range: [0, 500]}}
derivatives: {x: v, v: (force - viscous*v)/mass}
outputs: {position: {value: x, unit: m}}
effects:
  coulomb: {add: {v: -l*sign(v)/mass}, parameters: {l: {unit: N, neutral: 0, scale: 2, range: [0, 50]}}}
  load: {add: {v: l/mass}, parameters: {l: {unit: N, neutral: 0, scale: 2}}}
  drag: {add: {v: -c*v*abs(v)/mass}, parameters: {c: {unit: N*s^2/m^2, neutral: 0, scale: 5, range: [0, 500]}}}
  stiffness: {add: {v: -k*x/mass}, parameters: {k: {unit: N/m, neutral: 0, scale: 20, range: [0, 1000]}}}
""", (4.0, 8.0), {"coulomb": 2.0, "load": 1.0, "drag": 8.0, "stiffness": 15.0},
        axis_rates, 1, 0, (9.0, "sines"), 6.0, 250.0,
    ),
    "arm": Kind(
        """
states: {q: {unit: rad}, w: {unit: rad/s}}
inputs: {torque: {unit: N*m}}
parameters: {inertia: {value: 0.02, unit: kg*m^2, tolerance: 0.0002}, viscous: {value: 0.05, unit: N*m*s/rad, free: true, range: [0, 5]}}
derivatives: {q: w, w: (torque - viscous*w)/inertia}
outputs: {angle: {value: q, unit: rad}}
effects:
  coulomb: {add: {w: -l*sign(w)/inertia}, parameters: {l: {unit: N*m, neutral: 0, scale: 0.03, range: [0, 5]}}}
  gravity: {add: {w: -g*sin(q)/inertia}, parameters: {g: {unit: N*m, neutral: 0, scale: 0.1}}, confused_with: [spring]}
  load: {add: {w: l/inertia}, parameters: {l: {unit: N*m, neutral: 0, scale: 0.03}}}
  spring: {add: {w: -k*q/inertia}, parameters: {k: {unit: N*m/rad, neutral: 0, scale: 0.1}}, confused_with: [gravity]}
""", (0.02, 0.05), {"coulomb": 0.04, "gravity": 0.15, "load": 0.02, "spring": 0.1},
        arm_rates, 1, 0, (0.25, "sines"), 6.0, 250.0,
    ),
    "spring": Kind(
        """
states: {x: {unit: m}, v: {unit: m/s}}
inputs: {force: {unit: N}}
parameters: {mass: {value: 0.5, unit: kg, tolerance: 0.005}, viscous: {value: 2, unit: N*s/m, free: true, range: [0, 100]}, rate: {value: 200, unit: N/m, tolerance: 4}}
derivatives: {x: v, v: (force - viscous*v - rate*x)/mass}
outputs: {position: {value: x, unit: m}}
effects:
  coulomb: {add: {v: -l*sign(v)/mass}, parameters: {l: {unit: N, neutral: 0, scale: 0.3, range: [0, 10]}}}
  hardening: {add: {v: -k*x**3/mass}, parameters: {k: {unit: N/m^3, neutral: 0, scale: 20000, range: [0, 1.0e+7]}}}
  load: {add: {v: l/mass}, parameters: {l: {unit: N, neutral: 0, scale: 0.3}}}
  drag: {add: {v: -c*v*abs(v)/mass}, parameters: {c: {unit: N*s^2/m^2, neutral: 0, scale: 3, range: [0, 100]}}}
""", (0.5, 2.0, 200.0), {"coulomb": 0.3, "hardening": 30000.0, "load": 0.3, "drag": 4.0},
        spring_rates, 1, 0, (6.0, "sines"), 5.0, 250.0,
    ),
    "coil": Kind(
        """
states: {i: {unit: A}}
inputs: {u: {unit: V}}
parameters: {resistance: {value: 8, unit: Ohm, free: true, range: [0, 100]}, inductance: {value: 40, unit: mH, free: true, range: [0, 1000]}}
derivatives: {i: (u - resistance*i)/inductance}
outputs: {current: {value: i, unit: A}}
effects:
  drop: {add: {i: -d*sign(i)/inductance}, parameters: {d: {unit: V, neutral: 0, scale: 0.5, range: [0, 10]}}}
  offset: {add: {i: o/inductance}, parameters: {o: {unit: V, neutral: 0, scale: 0.2}}}
  saturation: {add: {i: (u - resistance*i)/inductance*c*i**2}, parameters: {c: {unit: 1/A^2, neutral: 0, scale: 0.3, range: [0, 100]}}}
""", (8.0, 0.04), {"drop": 0.5, "offset": 0.2, "saturation": 0.4},
        coil_rates, -1, 0, (10.0, "steps"), 0.4, 4000.0,
    ),
    "tank": Kind(
        """
states: {h: {unit: m, start: 0.1}}
inputs: {q: {unit: m^3/s}}
parameters: {outlet: {value: 2.0e-3, unit: 1, free: true, range: [0, 1]}, root: {value: 1, unit: m^3/s}, one: {value: 1, unit: m}, area: {value: 0.02, unit: m^2, tolerance: 0.0004}}
derivatives: {h: (q - outlet*root*sqrt(h/one + 0.01))/area}
outputs: {level: {value: h, unit: m}}
effects:
  leak: {add: {h: -k*h/area}, parameters: {k: {unit: m^2/s, neutral: 0, scale: 5.0e-4, range: [0, 1]}}}
  overflow: {add: {h: '-k*max(0, h - top)/area'}, parameters: {k: {unit: m^2/s, neutral: 0, scale: 5.0e-3, range: [0, 1]}, top: {unit: m, range: [0, 1]}}}
  inflow: {add: {h: o/area}, parameters: {o: {unit: m^3/s, neutral: 0, scale: 1.0e-4}}}
""", (2e-3, 0.02), {"leak": 6e-4, "overflow": 8e-3, "inflow": 1e-4},
        tank_rates, -1, 0, (2.2e-3, "steps"), 400.0, 10.0,
    ),
    "heater": Kind(
        """
states: {T: {unit: K}}
inputs: {power: {unit: W}}
parameters: {gain: {value: 1.2, unit: K/W, free: true, range: [0, 100]}, tau: {value: 20, unit: s, free: true, range: [0.1, 1000]}}
derivatives: {T: (gain*power - T)/tau}
outputs: {temperature: {value: T, unit: K}}
effects:
  radiation: {add: {T: -r*T**2/tau}, parameters: {r: {unit: 1/K, neutral: 0, scale: 5.0e-3, range: [0, 1]}}}
  ambient: {add: {T: a/tau}, parameters: {a: {unit: K, neutral: 0, scale: 2}}}
  boiling: {add: {T: '-b*max(0, T - limit)/tau'}, parameters: {b: {unit: 1, neutral: 0, scale: 1, range: [0, 50]}, limit: {unit: K, range: [1, 100]}}}
""", (1.2, 20.0), {"radiation": 6e-3, "ambient": 2.0, "boiling": 1.0},
        heater_rates, -1, 0, (45.0, "steps"), 400.0, 5.0,
    ),
    "motor": Kind(
        """
states: {i: {unit: A}, w: {unit: rad/s}}
inputs: {u: {unit: V}}
parameters: {resistance: {value: 2, unit: Ohm, tolerance: 0.02}, k: {value: 0.05, unit: V*s/rad, tolerance: 0.0005}, inductance: {value: 2, unit: mH, tolerance: 0.1}, viscous: {value: 1.0e-4, unit: N*m*s/rad, free: true, range: [0, 1]}, inertia: {value: 1.0e-4, unit: kg*m^2, tolerance: 2.0e-6}}
derivatives: {i: (u - resistance*i - k*w)/inductance, w: (k*i - viscous*w)/inertia}
outputs: {speed: {value: w, unit: rad/s}, current: {value: i, unit: A}}
effects:
  coulomb: {add: {w: -l*sign(w)/inertia}, parameters: {l: {unit: N*m, neutral: 0, scale: 0.01, range: [0, 1]}}}
  load: {add: {w: l/inertia}, parameters: {l: {unit: N*m, neutral: 0, scale: 0.01}}}
  fan: {add: {w: -c*w*abs(w)/inertia}, parameters: {c: {unit: N*m*s^2/rad^2, neutral: 0, scale: 1.0e-6, range: [0, 1]}}}
""", (2.0, 0.05, 2e-3, 1e-4, 1e-4), {"coulomb": 0.01, "load": 0.008, "fan": 2e-6},
        motor_rates, 1, 4, (10.0, "sines"), 3.0, 500.0,
    ),
    "voice_coil": Kind(
        """
states: {i: {unit: A}, x: {unit: m}, v: {unit: m/s}}
inputs: {u: {unit: V}}
parameters: {resistance: {value: 4, unit: Ohm, tolerance: 0.04}, bl: {value: 8, unit: N/A, tolerance: 0.08}, inductance: {value: 1, unit: mH, tolerance: 0.05}, viscous: {value: 3, unit: N*s/m, free: true, range: [0, 100]}, rate: {value: 800, unit: N/m, tolerance: 16}, mass: {value: 0.1, unit: kg, tolerance: 0.001}}
derivatives: {i: (u - resistance*i - bl*v)/inductance, x: v, v: (bl*i - viscous*v - rate*x)/mass}
outputs: {position: {value: x, unit: mm}, current: {value: i, unit: A}}
effects:
  coulomb: {add: {v: -l*sign(v)/mass}, parameters: {l: {unit: N, neutral: 0, scale: 0.5, range: [0, 20]}}}
  motor_bend: {add: {v: -bl*b*x**2*i/mass, i: bl*b*x**2*v/inductance}, parameters: {b: {unit: 1/m^2, neutral: 0, scale: 2000, range: [0, 1.0e+5]}}}
  load: {add: {v: l/mass}, parameters: {l: {unit: N, neutral: 0, scale: 0.5}}}
""", (4.0, 8.0, 1e-3, 3.0, 800.0, 0.1), {"coulomb": 0.5, "motor_bend": 2500.0, "load": 0.4},
        voice_rates, 2, 5, (5.0, "sines"), 2.0, 1000.0,
    ),
    "cylinder": Kind(
        """
states: {y: {unit: 1}, x: {unit: m}}
inputs: {u: {unit: 1}}
parameters: {lag: {value: 0.03, unit: s, tolerance: 0.001}, speed: {value: 0.4, unit: m/s, free: true, range: [0, 10]}}
derivatives: {y: (u - y)/lag, x: speed*y}
outputs: {position: {value: x, unit: m}}
effects:
  dead_zone: {add: {x: '-speed*max(-z, min(z, y))'}, parameters: {z: {unit: 1, neutral: 0, scale: 0.05, range: [0, 0.9]}}}
  drift: {add: {x: d}, parameters: {d: {unit: m/s, neutral: 0, scale: 0.01}}}
  leak: {add: {x: -k*x}, parameters: {k: {unit: 1/s, neutral: 0, scale: 0.1, range: [0, 10]}}}
""", (0.03, 0.4), {"dead_zone": 0.06, "drift": 0.01, "leak": 0.1},
        valve_rates, -1, 0, (0.8, "sines"), 8.0, 250.0,
    ),
    "two_inertias": Kind(
        """
states: {a: {unit: rad}, va: {unit: rad/s}, b: {unit: rad}, vb: {unit: rad/s}}
inputs: {torque: {unit: N*m}}
parameters: {ja: {value: 0.002, unit: kg*m^2, tolerance: 2.0e-5}, jb: {value: 0.004, unit: kg*m^2, tolerance: 4.0e-5}, shaft: {value: 8, unit: N*m/rad, tolerance: 0.16}, inner: {value: 0.005, unit: N*m*s/rad, free: true, range: [0, 1]}, viscous: {value: 0.02, unit: N*m*s/rad, free: true, range: [0, 1]}}
derivatives: {a: va, va: (torque - shaft*(a - b) - inner*(va - vb) - viscous*va)/ja, b: vb, vb: (shaft*(a - b) + inner*(va - vb))/jb}
outputs: {motor: {value: a, unit: rad}, arm: {value: b, unit: rad}}
effects:
  coulomb: {add: {vb: -l*sign(vb)/jb}, parameters: {l: {unit: N*m, neutral: 0, scale: 0.03, range: [0, 5]}}}
  drag: {add: {vb: -c*vb*abs(vb)/jb}, parameters: {c: {unit: N*m*s^2/rad^2, neutral: 0, scale: 1.0e-3, range: [0, 1]}}}
  hardening: {add: {va: -k*(a - b)**3/ja, vb: k*(a - b)**3/jb}, parameters: {k: {unit: N*m/rad^3, neutral: 0, scale: 20000, range: [0, 1.0e+7]}}}
  load: {add: {vb: l/jb}, parameters: {l: {unit: N*m, neutral: 0, scale: 0.03}}}
""", (0.002, 0.004, 8.0, 0.005, 0.02),
        {"coulomb": 0.04, "drag": 1.5e-3, "hardening": 30000.0, "load": 0.02},
        two_rates, 3, 1, (0.25, "sines"), 4.0, 500.0,
    ),
}  # fmt: skip


def missing(seed: int) -> str:
    """The effect that the file of this seed's actuator lacks; empty for one that lacks nothing."""
    turn, number = divmod(seed, ROUND)
    if number // len(KINDS) % 5 == 4:
        return ""
    return str(np.random.default_rng((turn, number)).choice(list(KINDS[kind_of(seed)].effects)))


def kind_of(seed: int) -> str:
    """One after the other."""
    return list(KINDS)[seed % ROUND % len(KINDS)]


def bench(seed: int, effect: str) -> Bench:
    """The actuator of a seed, whose file lacks this effect, or nothing."""
    turn, number = divmod(seed, ROUND)
    with tempfile.TemporaryDirectory() as folder:
        plant = recorded(kind_of(seed), effect, 100_003 * turn + number, Path(folder))
    return Bench(
        kind_of(seed), lambda: diagnose_plant(plant, None, budget=Budget.of_seconds(SECONDS)), lambda found: {}
    )


def recorded(name: str, effect: str, seed: int, folder: Path) -> OwnPlant:
    """A plant as it is declared, with a recording of the true one, read from a file as a user's is."""
    kind, random = KINDS[name], np.random.default_rng(seed)
    content = {"plant": "equations", **yaml.safe_load(kind.plant)}
    names = [key for key in content["parameters"] if key not in ("root", "one")]
    values = np.array(kind.values)
    for place, key in enumerate(names):
        own = content["parameters"][key]
        if "tolerance" in own:
            values[place] += own["tolerance"] * (values[place] / own["value"]) * random.standard_normal()
        else:
            values[place] *= random.uniform(0.7, 1.4)
    sizes = np.zeros(4)
    if effect:
        sizes[list(kind.effects).index(effect)] = kind.effects[effect] * random.uniform(0.5, 1.5)
    times = np.arange(0.0, kind.duration, 1.0 / kind.rate)
    amplitude, form = kind.drive
    share = times / kind.duration
    if form == "sines":
        inputs = sum(
            size * np.sin(2.0 * np.pi * (rate * share + random.uniform()))
            for size, rate in ((0.6, 4.0 + random.uniform(0, 2)), (0.4, 11.0 + random.uniform(0, 3)))
        )
        inputs = amplitude * inputs * np.where((share > 0.45) & (share < 0.55), 0.0, 1.0)
    else:
        levels = random.uniform(0.15, 1.0, 16) * (1.0 if name != "coil" else random.choice([-1.0, 1.0], 16))
        inputs = amplitude * levels[np.minimum((16 * share).astype(int), 15)]
    start = np.array([float(own.get("start", 0.0)) for own in content["states"].values()])
    states = march(kind.rates, kind.slides, kind.inertia, start, times, inputs, values, sizes)
    (driven,) = content["inputs"]
    columns = {"t": times, driven: inputs}
    order = list(content["states"])
    for key, own in content["outputs"].items():
        shown = states[:, order.index(own["value"])] * (1e3 if own["unit"] == "mm" else 1.0)
        sigma = NOISE * float(np.ptp(shown))
        own["noise"] = float(f"{sigma:.6g}")
        columns[key] = shown + sigma * random.standard_normal(len(times))
    path = folder / f"{name}_{seed}.csv"
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.10g"
    )
    read_map = {"time": {"column": "t"}, driven: {"column": driven}}
    read_map |= {key: {"column": key} for key in content["outputs"]}
    return OwnPlant(plant_from(content, f"{name}.yaml"), [read(path, read_map)])
