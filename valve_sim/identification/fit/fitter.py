"""Fits of sets of hypotheses to one problem, and what they are worth beside the errors of its recordings.

    fit {}; read drift and hum at rest
    learn the sizes of all other errors beside it, or forget them if something is left
    later: learn them again beside a set, and fit again what may come near

Large errors would imitate what a model lacks, most of all numbers of the machine that vary from stroke to stroke. So
they are learned beside a model only that leaves nothing unnamed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.changes import FEWEST, changes_in
from valve_sim.identification.fit.columns import Columns, changes_of, columns_of, known_name
from valve_sim.identification.fit.descent import FIRST_DAMPING, MOST, Beside, Descended, descend
from valve_sim.identification.fit.errors.error import Mode
from valve_sim.identification.fit.gaussian import Gaussian, Spread
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.posterior import EVEN, Evidence, Rivals, Set
from valve_sim.identification.fit.priors import LogNormal
from valve_sim.identification.fit.problem import Problem, weigh_outliers
from valve_sim.identification.fit.process import SMALLEST, Process
from valve_sim.identification.fit.recordings import sizes_at_rest
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.ringing import WORTH, ringing_modes
from valve_sim.identification.fit.unknown import GONE, Group, Hypothesis, Unknown, curve, unknowns_of
from valve_sim.identification.plants.protocol import ForceMap
from valve_sim.model import SimulationError

HELD: Final = 0.3
"""Of the scale of its prior: the size of an error before the data are asked."""
LOOKS: Final = 8
"""Linearisations beside all errors, after which it is asked whether these could explain what is left."""
HOPELESS: Final = 50.0
"""Ln p by which something unnamed is better than any errors of the recordings, from which these are not learned."""
ROUNDS: Final = 4
"""Of fits and sizes."""
SETTLED: Final = 0.2
"""Largest change of the logarithm of a size at which sizes have settled."""
NEARLY: Final = 3.0
"""Difference in ln p by which a model beside something unnamed may be less probable than without, and be looked at
twice."""
LINEAR: Final = 0.4
"""τ up to which something unnamed changes fits so little that one linear step is exact to 0.3 in ln p."""
SPLINES: Final = 24
"""Of a smooth curve: a twentieth of the stroke apart. (With 10 a bump of 85 µm lost 18 in ln p; 40 gained nothing.)"""


@dataclass(frozen=True)
class Tried:
    """A set that was fitted.

    Attributes:
        fit: without a process. plain: ln p(data | set). spread: the same with something unnamed beside it.
        is_fitted: whether the fit was carried to its end.
        beside: the fit beside something unnamed; None: that is `fit`.
    """

    fit: Descended
    plain: float
    spread: Spread
    is_fitted: bool = True
    beside: Descended | None = None

    @property
    def values(self) -> dict[str, float]:
        """What each unknown came to, by name."""
        gaussian = self.fit.gaussian
        return gaussian.model.named(gaussian.z)

    @cached_property
    def result(self) -> Fit:
        """The fit as what is reported of it."""
        return Fit.of(self.fit)

    @property
    def evidence(self) -> Evidence:
        """The evidence of the set, as the posterior takes it."""
        return Evidence(self.plain, self.spread.log_evidence, self.is_fitted)


class LearnedErrors(NamedTuple):
    """What is taken for errors of the recordings: their columns, with the effects that change, and sizes of groups."""

    columns: Columns
    sizes: Mapping[str, float]


class Fitter:
    """Fits sets of hypotheses, with the errors of the recordings as large as they are.

    Args:
        problem: data and noise. rivals: what may be missing. held: sizes of errors that are known, by `known_name`.
        reads_at_rest: whether drift and hum are read while the machine is still.
        free: names that every fit frees; default what the plant says. starts: of the first fits, values by name.

    Attributes:
        problem: with the errors of its recordings as columns. sizes: of the groups of errors, by name.
        hypotheses, curves: by name. base: the declared model, when it has been fitted.
    """

    def __init__(
        self, problem: Problem, rivals: Rivals, held: Mapping[str, float] | None = None, *, reads_at_rest: bool = True,
        free: Sequence[str] | None = None, starts: Sequence[Mapping[str, float]] | None = None,
    ) -> None:  # fmt: skip
        plant = problem.plant
        self.unknowns, self.rivals, self._starts = unknowns_of(plant, free), rivals, starts
        self._held, self._reads = dict(held or {}), reads_at_rest
        self.hypotheses: dict[str, Hypothesis] = dict(self.unknowns.hypotheses)
        self.curves = {own.name: own for own in (curve(one, _force_of(problem), SPLINES) for one in plant.force_maps)}
        self.problem = problem
        self.use(self.columns_with({}, {}))
        self.sizes = {name: self._usual(group) for name, group in self.groups.items()}
        self.base: Tried | None = None

    @cached_property
    def process(self) -> Process:
        """Something unnamed beside what is fitted; of a long recording it is not looked for."""
        return Process(self.problem)

    def _usual(self, group: Group) -> float:
        """The size of an error before the data are asked."""
        known = self._held.get(known_name(group)) if group.is_held else None
        return known if known is not None else group.scale * (1.0 if group.law == "known" else HELD)

    @property
    def groups(self) -> dict[str, Group]:
        """By name, of all errors of the recordings, of stamps and of smooth curves."""
        stamps = {own.group.name: own.group for own in self.unknowns.stamps if own.group}
        curves = {own.group.name: own.group for one in self.curves.values() for own in one.frees if own.group}
        return {**self.problem.columns.groups, **stamps, **curves}

    @property
    def learned(self) -> list[str]:
        """Names of the groups whose size is learned beside a model."""
        reads = self._reads
        return [name for name, own in self.groups.items() if own.is_learned and not (reads and own.at_rest)]

    def size(self, group: Group) -> float:
        """The size that a group has now; of one that came later, before the data are asked."""
        return self.sizes.get(group.name, self._usual(group))

    # -- models and fits -----------------------------------------------------------------------------------------------

    def model(
        self, names: Set, held: Mapping[str, float] | None = None, *, has_columns: bool = True, is_bare: bool = False
    ) -> Model:
        """The machine with a set freed, and errors of the recordings that are more than none.

        Args:
            names: the set. held: values that are fixed, by name. has_columns: whether errors of the sensors are among
                those that are freed. is_bare: whether nothing that varies of the machine is, and no stamp.
        """
        chosen = [self.curves[name] if name in self.curves else self.hypotheses[name] for name in names]
        frees = {own.name: own for own in self.unknowns.base}
        frees |= {own.name: own for one in chosen for own in one.frees}
        known = [own for own in self.unknowns.known if not {own.name, *own.replaces} & frees.keys()]
        columns = self.problem.columns
        varying = [own for own in columns.varying if _acts_on(own, frees)]
        local = [] if is_bare else [*varying, *self.unknowns.stamps]
        linear = columns.unknowns if has_columns else ()
        fixed = {name: value for one in chosen for name, value in one.held.items()} | dict(held or {})
        errors = [own for own in (*local, *linear) if own.is_there(self.sizes)]
        return Model(self.problem, [*frees.values(), *known, *errors], fixed)

    def descended(
        self, model: Model, values: Mapping[str, float], *, most: int = MOST, goal: float = math.inf,
        beside: Beside | None = None, damping: float = FIRST_DAMPING,
    ) -> Descended | None:  # fmt: skip
        """A fit from a start; None where the machine cannot be simulated there. Arguments: see `descend`."""
        try:
            return descend(model, model.at(values), self.sizes, most=most, goal=goal, beside=beside, damping=damping)
        except (SimulationError, np.linalg.LinAlgError):
            return None

    def tried_at(self, values: Mapping[str, float]) -> Tried:
        """The declared model where it is, not fitted again.

        Raises:
            SimulationError: it cannot be simulated there.
        """
        model = self.model(())
        z = model.at(values)
        here = Gaussian(model, z, model.linearise(z), self.sizes)
        fit = Descended(here, converged=True, least=here.cost, damping=FIRST_DAMPING)
        return Tried(fit, here.log_evidence, Spread(-math.inf, SMALLEST, 0.0))

    def weighed(self, names: Set, fit: Descended, *, is_fitted: bool = True, spreads: bool = True) -> Tried:
        """A fit with its evidence, at the sizes of errors that suit it.

        Args:
            names: the set. fit: of it. is_fitted: whether it was carried to its end.
            spreads: whether something unnamed is tried beside it; else it gains as much as beside the declared model.
        """
        values = fit.gaussian.model.named(fit.gaussian.z)
        nothing = Tried(fit, -math.inf, Spread(-math.inf, SMALLEST, 0.0), is_fitted)
        for name in names:
            if name in self.hypotheses and not _may_be_claimed(self.hypotheses[name], values):
                return nothing
        try:
            suited = fit.gaussian.with_best_sizes(self.learned)
            integral = suited.log_integral(self.learned)
            plain = suited.log_evidence + integral
            if spreads:
                return Tried(
                    fit, plain, self._beside_errors(suited, plain, integral, is_rough=not is_fitted), is_fitted
                )
        except np.linalg.LinAlgError:
            return nothing
        base = self.base
        assert base is not None
        unnamed = base.spread._replace(log_evidence=base.spread.log_evidence + plain - base.plain)
        return Tried(fit, plain, unnamed, is_fitted)

    def _beside_errors(self, suited: Gaussian, plain: float, integral: float, *, is_rough: bool = False) -> Spread:
        """Something unnamed beside a model: either may explain what errors of the recording do, and these it.

        Args:
            suited: at the most probable sizes of errors. plain: ln p without. integral: over the sizes.
            is_rough: whether only these sizes are tried.
        """
        chosen = [name for name in suited.groups if name in set(self.learned)]
        first = suited.spread(self.process)
        found = [first._replace(log_evidence=first.log_evidence + integral)]
        has_errors = any(
            suited.size(group) > 0.05 * group.scale for name, (group, _) in suited.groups.items() if name in chosen
        )
        if is_rough or not has_errors:
            return found[0]
        none = {name: float(suited.groups[name][0].grid[0]) for name in chosen}
        found.append(suited.resized(none).spread(self.process))
        if max(found).log_evidence > plain - NEARLY:
            there = suited.beside(self.process, max(found).cell).with_best_sizes(chosen)
            again = suited.resized(there.sizes).spread(self.process)
            found.append(again._replace(log_evidence=again.log_evidence + there.log_integral(chosen)))
        return max(found)

    def beside(self, names: Set, tried: Tried) -> Tried:
        """A set fitted again beside the most probable process, where that changes its fit."""
        for _ in range(2):
            cell = tried.spread.cell
            if cell.tau <= LINEAR:
                break
            start = (tried.beside or tried.fit).gaussian
            fit = self.descended(self.model(names), start.model.named(start.z), beside=Beside(self.process, cell))
            if fit is None:
                break
            own = fit.gaussian
            suited = Gaussian(own.model, own.z, own.sums, own.sizes).with_best_sizes(self.learned)
            spread = self._beside_errors(suited, tried.plain, suited.log_integral(self.learned))
            tried = replace(tried, spread=spread, beside=fit)
            if spread.cell == cell:
                break
        return tried

    # -- errors of the recordings --------------------------------------------------------------------------------------

    def fitted_plainly(self) -> Fit:
        """The declared model, with the errors of the recordings as large as they are before the data are asked.

        Raises:
            SimulationError: it cannot be simulated from any start.
        """
        return Fit.of(self._plain_fit())

    def fitted_declared(self) -> Tried:
        """Fit the declared model, and learn the errors of the recordings beside it.

        Raises:
            SimulationError: it cannot be simulated from any start.
        """
        fit = self._plain_fit()
        first = self.weighed((), fit)
        usual = self.errors
        begun = self.descended(self.model(()), first.values, most=LOOKS) or fit
        is_hopeless = self._leaves_much(begun)
        if is_hopeless:
            self.sizes.update(dict.fromkeys(self._local_groups, 0.0))
            stamped = self._with_stamps(first)
            if self.rivals.unnamed_beside((), stamped.evidence) < EVEN:  # stamps alone explain all
                self.base = stamped
                return stamped
            self.take(usual)
        if is_hopeless and usual.columns.unknowns:
            # A gain and a curve are of the motion as it is, which may be far from the declared one.
            self.use(self.columns_with(first.values, usual.columns.modes))
            begun = self.descended(self.model(()), first.values, most=LOOKS) or begun
            is_hopeless = self._leaves_much(begun)
        if is_hopeless and usual.columns.unknowns:  # modes imitate what is missing, unless they explain all of it
            begun = self.with_modes((), begun)
            is_hopeless = self._leaves_much(begun)
            if is_hopeless and self.problem.columns is not usual.columns:
                self.take(usual)
        found = first
        if not is_hopeless:
            found = self.weighed((), self.learn((), begun))
        if is_hopeless or self.rivals.unnamed_beside((), found.evidence) > EVEN:
            self.take(usual)
            self.sizes.update(dict.fromkeys(self._local_groups, 0.0))
            found = self._with_stamps(first)
        self.base = found
        return found

    def _with_stamps(self, declared: Tried) -> Tried:
        """The declared model with errors of the commands' stamps, where they are plain although something is missing.

        They cannot imitate much, and where they are left out, every set errs by them.
        """
        groups = {own.group.name: own.group for own in self.unknowns.stamps if own.group and own.group.is_learned}
        without = dict(self.sizes)
        self.sizes.update({name: HELD * group.scale for name, group in groups.items()})
        fit = self.descended(self.model(()), declared.values) if groups else None
        if fit is not None:
            found, suited = self.weighed((), fit), fit.gaussian.with_best_sizes(groups)
            if found.spread.log_evidence > declared.spread.log_evidence + WORTH:
                self.sizes.update({name: suited.sizes[name] for name in groups})
                return found
        self.sizes = without
        return declared

    @property
    def _local_groups(self) -> list[str]:
        """Names of the groups of what varies of the machine, and of stamps."""
        varying = (*self.problem.columns.varying, *self.unknowns.stamps)
        return [own.group.name for own in varying if own.group and not own.group.is_held]

    def _plain_fit(self) -> Descended:
        """The declared model without what varies of the machine, drift and hum read at rest."""
        tripled = {
            own.name: 3.0 * own.value(own.start) for own in self.unknowns.base if isinstance(own.prior, LogNormal)
        }
        model = self.model((), is_bare=True)
        fits = [self.descended(model, start) for start in ({}, tripled)]
        known = [fit for fit in fits if fit is not None]
        if not known:
            raise SimulationError("the declared model cannot be simulated from any start of the fit")
        fit = min(known, key=lambda one: one.cost)

        def again(robust: Problem) -> Mapping[str, float]:
            nonlocal fit
            self.problem, there = robust, fit.gaussian
            fit = self.descended(self.model((), is_bare=True), there.model.named(there.z)) or fit
            return fit.gaussian.model.values(fit.gaussian.z)

        weigh_outliers(self.problem, fit.gaussian.model.values(fit.gaussian.z), again)
        if self._reads and self._read_at_rest(fit):
            fit = self.descended(self.model((), is_bare=True), fit.gaussian.model.named(fit.gaussian.z)) or fit
        return fit

    def _read_at_rest(self, fit: Descended) -> bool:
        """Take the sizes of drift and hum from the samples at rest alone; whether there are any."""
        read = sizes_at_rest(fit.gaussian)
        self.sizes.update(read)
        return bool(read)

    def _leaves_much(self, fit: Descended) -> bool:
        """Whether something unnamed acts beside a fit, to first order, whatever sizes errors have."""
        try:
            suited = fit.gaussian.with_best_sizes(self.learned)
            return suited.spread(self.process).log_evidence - suited.log_evidence > HOPELESS
        except np.linalg.LinAlgError:
            return True

    def learn(self, names: Set, fit: Descended) -> Descended:
        """A set fitted again with the most probable sizes of errors beside it, which are those of all fits from now on.

        What a sensor's gain and curve make of the motion is taken from the motion of this fit.
        """
        values = fit.gaussian.model.named(fit.gaussian.z)
        self.use(self.columns_with(values, self.problem.columns.modes))
        groups = self.groups
        for name in self.learned:
            self.sizes[name] = max(self.sizes.get(name, 0.0), HELD * groups[name].scale)
        for _ in range(ROUNDS):
            found = self.descended(self.model(names), fit.gaussian.model.named(fit.gaussian.z)) or fit
            sizes = found.gaussian.with_best_sizes(self.learned).sizes
            changes = [
                abs(math.log(sizes[name] / self.sizes[name]))
                for name in self.learned
                if name in sizes and self.sizes[name] > GONE * groups[name].scale
            ]
            self.sizes.update({name: sizes[name] for name in self.learned if name in sizes})
            fit = found
            if max(changes, default=0.0) < SETTLED:
                break
        return self.descended(self.model(names), fit.gaussian.model.named(fit.gaussian.z)) or fit

    def use(self, columns: Columns) -> None:
        """Fit with other errors of the recordings from now on."""
        self.problem = self.problem.with_columns(columns)

    @property
    def errors(self) -> LearnedErrors:
        """The errors of the recordings as they are now."""
        return LearnedErrors(self.problem.columns, dict(self.sizes))

    def take(self, errors: LearnedErrors) -> None:
        """Fit with these errors, columns and sizes, from now on."""
        if errors.columns is not self.problem.columns:
            self.use(errors.columns)
        self.sizes = dict(errors.sizes)

    def with_modes(self, names: Set, fit: Descended) -> Descended:
        """A fit of a set again with the modes in which the mounts of its sensors ring, where they are worth it."""
        found = fit
        for _ in range(2):
            modes = ringing_modes(found.gaussian.with_best_sizes(self.learned))
            if modes == dict(self.problem.columns.modes):
                break
            values = found.gaussian.model.named(found.gaussian.z)
            before = self.errors
            self.use(self.columns_with(values, modes))
            again = self.descended(self.model(names), values)
            if again is None or not self._is_worth(again, found):
                self.take(before)
                break
            suited = again.gaussian.with_best_sizes(self.learned)
            self.sizes.update({name: suited.sizes[name] for name in self.learned if name in suited.sizes})
            found = self.descended(self.model(names), again.gaussian.model.named(again.gaussian.z)) or again
        return found

    def columns_with(
        self, values: Mapping[str, float], modes: Mapping[int, tuple[Mode, ...]], changing: Sequence[str] | None = None
    ) -> Columns:
        """The errors of the recordings beside a machine of these values.

        Args:
            values: by name. modes: of the sensors' mounts, by channel.
            changing: effects that differ from stroke to stroke; default those that do now.
        """
        if self.problem.is_long:
            return Columns()
        changing = self.problem.columns.changing if changing is None else tuple(changing)
        return columns_of(self.problem.plant, values, modes, changing).held_at(self._held)

    def _lets_change(self, effect: str) -> bool:
        """Let an effect differ from stroke to stroke from now on, if there are strokes enough."""
        strokes = {own.during for own in changes_of(self.problem.plant, (effect,))}
        columns = self.problem.columns
        if len(strokes) < FEWEST or effect in columns.changing:
            return False
        values = {} if self.base is None else self.base.values
        self.use(self.columns_with(values, columns.modes, (*columns.changing, effect)))
        return True

    def least_with_change(self, names: Set, values: Mapping[str, float], effect: str) -> float:
        """What the criterion comes to from a start, to first order, if an effect differs from stroke to stroke."""
        before = self.errors
        try:
            if not self._lets_change(effect):
                return math.inf
            model = self.model(names)
            z = model.at(values)
            here = Gaussian(model, z, model.linearise(z), self.sizes)
            return here.cost - here.step()[1]
        except (SimulationError, np.linalg.LinAlgError):
            return math.inf
        finally:
            self.take(before)

    def with_change(self, names: Set, values: Mapping[str, float], effect: str) -> Descended | None:
        """A fit of a set from a start, an effect of it differing from stroke to stroke; None where that cannot be."""
        fit = self.descended(self.model(names), values) if self._lets_change(effect) else None
        return None if fit is None else self.learn(names, fit)

    def is_orderly(self, tried: Tried) -> bool:
        """Whether an effect that differs from stroke to stroke follows them: free sizes would imitate too much."""
        sizes = tried.fit.gaussian.with_best_sizes(self.learned).sizes
        return any(
            changes_in(tried.result, group, sizes[name])
            for name, group in self.groups.items()
            if group.is_change and name in sizes
        )

    def _is_worth(self, after: Descended, before: Descended) -> bool:
        return self._with_sizes(after) > self._with_sizes(before) + WORTH

    def _with_sizes(self, fit: Descended) -> float:
        suited = fit.gaussian.with_best_sizes(self.learned)
        return suited.log_evidence + suited.log_integral(self.learned)

    def settled(self, tried: Tried, sizes: Mapping[str, float] | None = None) -> Fit:
        """A fit made again with the errors of the recordings that suit it.

        Args:
            tried: the set. sizes: of the errors, by name; default the most probable beside it.
        """
        gaussian = tried.fit.gaussian
        suited = gaussian.with_best_sizes(self.learned).sizes if sizes is None else {**gaussian.sizes, **sizes}
        # What is nothing beside another set is the least that a size may be.
        suited |= {name: max(suited[name], float(group.grid[0])) for name, (group, _) in gaussian.groups.items()}
        changes = [abs(math.log(suited[name] / gaussian.size(group))) for name, (group, _) in gaussian.groups.items()]
        if max(changes, default=0.0) < SETTLED:
            return tried.result
        try:
            return Fit.of(descend(gaussian.model, gaussian.z, suited))
        except (SimulationError, np.linalg.LinAlgError):
            return tried.result

    def scale_of(self, own: ForceMap) -> float:
        """What a force without a name may be, N; of a damping, N·s/m, at the fastest motion."""
        fastest = max((one.high for one in self.problem.plant.force_maps if one.variable == "v"), default=1.0)
        return _force_of(self.problem) / (fastest if own.least == 0.0 else 1.0)

    def fit_curve(self, name: str, names: Set, values: Mapping[str, float], goal: float = math.inf) -> Descended | None:
        """A smooth curve beside a set, as stiff as its own evidence says.

        None where it cannot be simulated, or comes nowhere near a goal for the criterion.
        """
        own = {one.group.name: one.group for one in self.curves[name].frees if one.group}
        self.sizes.update({key: group.scale for key, group in own.items()})
        whole = tuple(sorted((*names, name)))
        fit = self.descended(self.model(whole), values, most=25, goal=goal)
        if fit is not None and not fit.converged and fit.least > goal:
            return None
        for _ in range(ROUNDS):
            if fit is None:
                return None
            sizes = fit.gaussian.with_best_sizes(own).sizes
            change = max(abs(math.log(sizes[key] / self.sizes[key])) for key in own)
            self.sizes.update({key: max(sizes[key], 1e-3 * group.scale) for key, group in own.items()})
            fit = self.descended(self.model(whole), fit.gaussian.model.named(fit.gaussian.z), most=25) or fit
            if change < HELD:
                break
        return fit


def _acts_on(own: Unknown, frees: Mapping[str, Unknown]) -> bool:
    """Whether what varies is there: a number of the machine, or of an effect that is among those that are freed."""
    is_change = own.group is not None and own.group.is_change
    return not is_change or own.nuisance is None or own.nuisance.number in frees


def _may_be_claimed(own: Hypothesis, values: Mapping[str, float]) -> bool:
    """Whether values are within the range in which an effect bears its name."""
    return all(one.claimed[0] <= values[one.name] <= one.claimed[1] for one in own.frees if one.name in values)


def _force_of(problem: Problem) -> float:
    """Scale of a force that nothing describes, N: a fifth of what holds the valve closed."""
    try:
        return 0.2 * abs(problem.plant.declared("spring_preload")) or 0.2
    except (KeyError, AttributeError):
        return 0.2
