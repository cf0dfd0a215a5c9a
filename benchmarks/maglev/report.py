"""What is printed: the verdict, errors before and after, of records fitted and left out, and the check of the force."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.maglev.force import Lift, lift_of, shares_of_weight
from benchmarks.maglev.plant import MagnetPlant
from benchmarks.maglev.records import DEFAULT, MagnetRecord, read_jumps, read_record, records_in
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.effect_titles import titles_of
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.identification.reporting.summary import summarise
from valve_sim.identification.selection.search import Search
from valve_sim.model import ValveError

FROM, TO = -0.05, 0.15
"""s after the jump between which errors are judged."""
WANTED_FITTED, WANTED_LEFT_OUT = 0.021, 0.030
"""A rms there, at most: of records that were fitted, and of records that were not."""
MOTIONAL_EMF: Final = "motional_emf"

Values = Mapping[str, float]


@dataclass(frozen=True)
class Rung:
    """A model with so many effects, and its errors around the jump, A.

    Attributes:
        effects: what was added to the declared model. values: fitted to all that is fitted.
        fitted, unseen: rms of each record that was fitted; of each that was not, by models fitted without it.
    """

    effects: tuple[str, ...]
    values: Values
    fitted: tuple[float, ...]
    unseen: tuple[float, ...]


@dataclass(frozen=True)
class Pull:
    """How hard an inductance pulls where the balls lift.

    Attributes:
        shares: of the ball's weight, at each lift. stderr: of their median, by leaving each record out that the
            inductance was fitted to (jackknife).
    """

    shares: tuple[float, ...]
    stderr: float

    @property
    def median(self) -> float:
        """Of the shares."""
        return float(np.median(self.shares))


@dataclass(frozen=True)
class Findings:
    """All that is printed and drawn.

    Attributes:
        records: that were fitted. others: that were predicted; none: each fitted one is left out in turn.
        diagnosis: of these. rungs: the declared model first, the corrected one last.
        lifts: where the balls lift. pulls: of each way to know the inductance, by its name.
    """

    records: Sequence[MagnetRecord]
    others: Sequence[MagnetRecord]
    diagnosis: Diagnosis
    rungs: Sequence[Rung]
    lifts: Sequence[Lift]
    pulls: Mapping[str, Pull]

    @property
    def falls_short(self) -> list[str]:
        """What is wanted and not reached, in words."""
        last = self.rungs[-1]
        found = []
        if MOTIONAL_EMF not in self.diagnosis.verdict.effects:
            found.append("motional EMF is not named")
        for what, errors, wanted in (
            ("fitted", last.fitted, WANTED_FITTED),
            ("left out", last.unseen, WANTED_LEFT_OUT),
        ):
            if not together(errors) <= wanted:
                found.append(f"{1e3 * together(errors):.1f} mA {what}, wanted at most {1e3 * wanted:.0f} mA")
        return found


def around_jump(record: MagnetRecord, times: Array) -> np.typing.NDArray[np.bool_]:
    """Which of some times are judged: those around the jump, or all where the ball stays."""
    if record.jump is None:
        return np.ones(len(times), dtype=bool)
    since = times - record.times[record.jump]
    half = 0.5 * record.interval
    return np.asarray((since > FROM - half) & (since < TO + half))


def errors_of(records: Sequence[MagnetRecord], values: Values) -> tuple[float, ...]:
    """A rms of each record, measured less predicted around the jump."""
    plant = MagnetPlant(records)
    found: list[float] = []
    for record, channel, shown in zip(records, plant.channels, plant.predict(values), strict=True):
        judged = around_jump(record, channel.times)
        found.append(root_mean_square((channel.data - shown)[judged]))
    return tuple(found)


def together(errors: Sequence[float]) -> float:
    """The rms over records, each of which counts alike."""
    return root_mean_square(np.array(errors))


def refitted(records: Sequence[MagnetRecord], effects: Sequence[str], start: Values) -> Values:
    """The declared model with these effects, fitted from a start."""
    plant = MagnetPlant(records)
    added = itertools.chain(*(plant.effects[effect].free_names() for effect in effects))
    return fit(Problem(plant), (*plant.base, *added), start, nuisances=plant.nuisances).values


def ladder(
    records: Sequence[MagnetRecord], others: Sequence[MagnetRecord], diagnosis: Diagnosis, say: Callable[[str], None]
) -> list[Rung]:
    """The declared model, the best of the effects that lead in the diagnosis, two of them, and so on to all."""
    search, named = Search(Problem(MagnetPlant(records))), diagnosis.verdict.effects
    rungs = []
    for count in range(len(named) + 1):
        sets = (tuple(sorted(effects)) for effects in itertools.combinations(named, count))
        best = max(sets, key=lambda names: search.fit(names).log_evidence)
        say(titles_of(best) if best else "the declared model")
        values = search.fit(best).values
        unseen = errors_of(others, values) if others else left_out(records, best, values)
        rungs.append(Rung(best, values, errors_of(records, values), unseen))
    return rungs


def left_out(records: Sequence[MagnetRecord], effects: Sequence[str], start: Values) -> tuple[float, ...]:
    """A rms of each record, by the model that is fitted to all the others."""
    found: list[float] = []
    for number, record in enumerate(records):
        rest = [*records[:number], *records[number + 1 :]]
        found.extend(errors_of([record], refitted(rest, effects, start)))
    return tuple(found)


def pull_of(records: Sequence[MagnetRecord], effects: Sequence[str], start: Values, lifts: Sequence[Lift]) -> Pull:
    """The pull that follows from a model with these effects, fitted to these records."""
    values = refitted(records, effects, start)
    medians = [
        np.median(shares_of_weight(refitted([*records[:number], *records[number + 1 :]], effects, values), lifts))
        for number in range(len(records))
    ]
    stderr = float(np.std(medians)) * (len(medians) - 1) ** 0.5
    return Pull(tuple(shares_of_weight(values, lifts)), stderr)


def study(folder: Path, predicted: Sequence[Path], say: Callable[[str], None] = lambda what: None) -> Findings:
    """Read, diagnose, correct, predict, and check the force.

    Args:
        folder: of the rig's records. predicted: records that take no part in fits.
        say: told what is being worked on.

    Raises:
        ValveError: a file is unusable.
    """
    apart = {path.resolve() for path in predicted}
    records = read_jumps(path for path in records_in(folder, "force") if path.resolve() not in apart)
    others = [read_record(path) for path in predicted]
    if len(records) < 2:
        raise ValveError(f"{folder}: {len(records)} jumps are left to fit; expected at least 2")
    held = [read_record(path) for path in records_in(folder, "inductance") if path.resolve() not in apart]
    diagnosis = diagnose_plant(MagnetPlant(records), MagnetPlant(others) if others else None, lambda what, _: say(what))
    rungs = ladder(records, others, diagnosis, say)
    last, lifts = rungs[-1], [lift_of(record) for record in records]
    say("pull")
    pulls = {
        "by the dip of the current": pull_of(records, last.effects, last.values, lifts),
        "by steps, the ball held": pull_of(held, last.effects, last.values, lifts),
    }
    return Findings(records, others, diagnosis, rungs, lifts, pulls)


def report(found: Findings) -> str:
    """The whole page."""
    verdict, before, after = found.diagnosis.verdict, found.diagnosis.before, found.diagnosis.after
    noise = before.fit.problem.noise.sigma
    lines = [
        f"{len(found.records)} jumps, current's noise {1e3 * noise:.1f} mA",
        "",
        f"verdict, kind {verdict.kind!r}: {' and '.join(verdict.effects) or 'nothing'}. {summarise(found.diagnosis)}",
        f"current's error in mA over 2 s, fitted / held out: {1e3 * before.train_rmse:.1f} / "
        f"{1e3 * before.holdout_rmse:.1f} before, {1e3 * after.train_rmse:.1f} / {1e3 * after.holdout_rmse:.1f} after",
        "",
        *error_table(found),
        "",
        *value_lines(found.rungs[-1].values),
        "",
        *force_table(found),
    ]
    return "\n".join(lines)


def error_table(found: Findings) -> list[str]:
    """One line for each model, then each record that was not fitted."""
    unseen = "others" if found.others else "left out"
    lines = [
        f"error of the current, mA rms, {-1e3 * FROM:.0f} ms before to {1e3 * TO:.0f} ms after the jump",
        f"{'added to a constant inductance':<42}{'fitted':>9}{'worst':>9}{unseen:>11}{'worst':>9}",
    ]
    for rung in found.rungs:
        name = titles_of(rung.effects) if rung.effects else "(nothing)"
        figures = (together(rung.fitted), max(rung.fitted), together(rung.unseen), max(rung.unseen))
        lines.append(f"{name:<42}" + "".join(f"{1e3 * a:>{w}.1f}" for a, w in zip(figures, (9, 9, 11, 9), strict=True)))
    lines.append("")
    first, last = found.rungs[0], found.rungs[-1]
    for record, before, after in zip(found.others or found.records, first.unseen, last.unseen, strict=True):
        lines.append(f"    {record.source:<38}{unseen}: {1e3 * before:>6.1f} before, {1e3 * after:.1f} after")
    return lines


def value_lines(values: Values) -> list[str]:
    """What the corrected model has for each value."""
    plant = MagnetPlant(())
    units = {nuisance.name: nuisance.unit for nuisance in plant.nuisances}
    return [
        f"    {name:<38}{value:>10.4g} {units[name] if name in units else plant.parameter(name).unit}"
        for name, value in values.items()
    ]


def force_table(found: Findings) -> list[str]:
    """Pull over weight where each ball lifts, by both ways to know the inductance."""
    lines = [
        "pull over weight where the ball lifts, by the inductance that shows",
        f"{'':<18}{'distance':>12}{'current':>10}" + "".join(f"{name:>28}" for name in found.pulls),
    ]
    for lift, *shares in zip(found.lifts, *(pull.shares for pull in found.pulls.values()), strict=True):
        line = f"    {lift.source:<14}{1e3 * lift.distance:>9.1f} mm{lift.current:>8.3f} A"
        lines.append(line + "".join(f"{share:>28.2f}" for share in shares))
    medians = "".join(f"{f'{pull.median:.2f} ± {pull.stderr:.2f}':>28}" for pull in found.pulls.values())
    return [*lines, f"    {'median ± standard error':<36}" + medians]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the page; 1 where it falls short of what is wanted, 2 where a file is unusable."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.maglev", description="Diagnose a real electromagnet.")
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT, help="of force_*.mat and inductance_*.mat")
    parser.add_argument("--predict", nargs="+", type=Path, default=[], metavar="FILE", help="records to leave out")
    parser.add_argument("--plot", type=Path, metavar="PNG", help="draw the current around a jump, and the pull")
    chosen = parser.parse_args(arguments)
    try:
        found = study(chosen.folder, chosen.predict, lambda what: print(f"... {what}", file=sys.stderr))
        print(report(found))
        if chosen.plot is not None:
            from benchmarks.maglev.figures import plot

            plot(chosen.plot, found)
    except ValveError as error:
        print(error, file=sys.stderr)
        return 2
    for words in found.falls_short:
        print(f"falls short: {words}")
    return 1 if found.falls_short else 0
