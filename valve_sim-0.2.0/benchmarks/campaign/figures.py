"""What the outcomes amount to: figures with their targets, confusion table, reliability of the probabilities."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from scipy.stats import beta

from benchmarks.campaign.cases import FAMILIES, SEEN, STRONG
from benchmarks.campaign.running import DECLARED, RECORDED, Cost, Outcome, Timing, is_unnamed, true_names

LABELS: Final = ("unique", "class", "unknown", "insufficient", "none", "wrong", "error")
"""Columns of the confusion table."""
LARGEST_ERROR: Final = 1.2
"""Held-out error after correction over the noise floor."""
SMALLEST_FALL: Final = 3.0
"""Held-out error of plant (b) before over after."""
CLEARLY_SEEN: Final = 5.0
"""Standard deviations: 25 of χ² is what a score of 10 asks for one parameter and ten thousand samples, and a margin."""
ROUNDING: Final = 1e-6
"""Share of an error by which it may rise."""
POOR_COVERAGE: Final = 0.85
"""An effect whose intervals cover less is listed."""
TIME_TARGETS: Final = {"single": 10.0, "pair": 40.0, "none": 10.0}
"""s, median of cold processes."""
PROBABILITY_BINS: Final = (0.0, 0.5, 0.7, 0.9, 0.99, 1.0)


@dataclass(frozen=True)
class Figure:
    """One line of what must be shown.

    Attributes:
        number: of the requirement. value: a share, or s. count: of the cases it is from.
        low, high: what is accepted. detail: what else to know.
    """

    number: int
    words: str
    value: float
    count: int
    low: float = -math.inf
    high: float = math.inf
    unit: str = "%"
    detail: str = ""

    @property
    def is_short(self) -> bool:
        """Whether it was measured and is not what it must be."""
        return self.count > 0 and not self.low <= self.value <= self.high

    def line(self, *, is_judged: bool = True) -> str:
        """For people."""
        if self.count == 0:
            return f"{self.number}  {self.words:<58} no cases"
        scale = 100.0 if self.unit == "%" else 1.0
        if math.isinf(self.high):
            target = f"≥ {scale * self.low:g}"
        elif math.isinf(self.low):
            target = f"≤ {scale * self.high:g}"
        else:
            target = f"{scale * self.low:g} to {scale * self.high:g}"
        judged = ("SHORT" if self.is_short else "ok") if is_judged else ""
        measured = f"{scale * self.value:6.1f} {self.unit} of {self.count}"
        return f"{self.number}  {self.words:<58} {measured:<17} target {target:<9} {judged:<5} {self.detail}".rstrip()


def figures(outcomes: Sequence[Outcome], timings: Sequence[Timing]) -> list[Figure]:
    """Everything that must be shown, in the order of the requirements."""
    return [
        *_single(_of(outcomes, "single")),
        _share(2, "nothing missing: none", _of(outcomes, "none"), _says("none"), low=0.98),
        *_combined(outcomes),
        *_corrected(outcomes),
        *_covered(_of(outcomes, "single", "pair"), 5, 0.9),
        *_other_forms(6, "other form", _of(outcomes, "mismatched"), (0.7, 0.8)),
        _share(7, "one opening, then the advised recording: named", _of(outcomes, "opening"), is_resolved, low=0.8),
        *_times(timings),
    ]


def tolerance_figures(outcomes: Sequence[Outcome], costs: Sequence[Cost]) -> list[Figure]:
    """What must be shown where declared values have tolerances, and of what has no name."""
    singles, wrong = _of(outcomes, "single_within"), _of(outcomes, "wrong_value")
    nameless = _of(outcomes, "uncatalogued")
    seen = [outcome for outcome in wrong if outcome.case.amplitudes[SEEN] >= CLEARLY_SEEN]
    return [
        _share(1, "within tolerances: none", _of(outcomes, "none_within"), _says("none"), low=0.97),
        _share(1, "one effect: in the class", singles, _is_answered, low=0.92),
        _share(1, "one effect: named uniquely", singles, lambda outcome: outcome.is_named, low=0.85),
        _share(1, "one effect: another name, confidently", singles, is_confidently_misnamed, high=0.01),
        _share(1, "one effect in a folder of bags: in the class", _of(outcomes, "folder"), _is_answered, low=0.92),
        _share(1, "a wrong value: named or in the class", wrong, _is_answered, low=0.9),
        _share(1, f"the same where it stands out by {CLEARLY_SEEN:g} σ or more", seen, _is_answered, low=0.9),
        *_covered(_of(outcomes, "none_within", "single_within", "wrong_value", "folder"), 2, 0.92),
        *_other_forms(4, "other forms", _of(outcomes, "mismatched_within", "reluctance"), (0.9, 0.9)),
        _share(5, f"no name: held-out error ≤ {LARGEST_ERROR:g} × noise", nameless, is_down_to_noise, low=0.8),
        _share(5, "no name: held-out error is larger after", nameless, has_risen, high=0.0),
        *_costs(costs),
    ]


def _is_answered(outcome: Outcome) -> bool:
    return outcome.label in ("unique", "class")


def _other_forms(number: int, words: str, outcomes: Sequence[Outcome], wanted: tuple[float, float]) -> list[Figure]:
    """Of plants of another form: how often the class holds the truth, the error falls, and confident names are right.

    Args:
        number, words: what the figures are listed under. wanted: least shares of the first two.
    """
    claims = [outcome for outcome in outcomes if outcome.is_confident and _says("effects")(outcome)]
    in_class, falls = wanted
    fall_words = f"{words}: held-out error falls {SMALLEST_FALL:g} times"
    return [
        _share(number, f"{words}: in the class", outcomes, lambda outcome: outcome.is_in_class, low=in_class),
        _share(number, fall_words, outcomes, has_fallen, low=falls),
        _share(number, f"{words}: confident names that are right", claims, lambda o: o.is_in_class, low=0.85),
    ]


def _costs(costs: Sequence[Cost]) -> list[Figure]:
    ratio = statistics.median(cost.ratio for cost in costs) if costs else math.nan
    shown = ", ".join(f"{cost.exact:.1f} → {cost.within:.1f}" for cost in costs)
    return [Figure(6, "CPU time with tolerances over without", ratio, len(costs), high=2.0, unit="", detail=shown)]


def least_demands(outcomes: Sequence[Outcome]) -> list[Figure]:
    """What a slice of a few cases must show."""
    return [
        _share(1, "any family: confidently wrong name", outcomes, is_confidently_misnamed, high=0.0),
        _share(2, "nothing missing: none", _of(outcomes, "none"), _says("none"), low=1.0),
        _share(1, "any family: failed with an exception", outcomes, lambda outcome: bool(outcome.error), high=0.0),
    ]


def _of(outcomes: Iterable[Outcome], *families: str) -> list[Outcome]:
    return [outcome for outcome in outcomes if outcome.case.family in families]


def _share(
    number: int,
    words: str,
    outcomes: Sequence[Outcome],
    test: Callable[[Outcome], bool],
    low: float = -math.inf,
    high: float = math.inf,
    detail: str = "",
) -> Figure:
    """The share of outcomes that pass a test."""
    passed = sum(map(test, outcomes))
    return Figure(number, words, passed / max(1, len(outcomes)), len(outcomes), low, high, detail=detail)


def _says(kind: str) -> Callable[[Outcome], bool]:
    return lambda outcome: bool(outcome.answers) and outcome.answers[0].kind == kind


def is_confidently_wrong(outcome: Outcome) -> bool:
    """Whether the answer claims to be right, with or without a name, and the truth is not in its class; or failed."""
    return bool(outcome.error) or (outcome.is_confident and not outcome.is_in_class)


def is_confidently_misnamed(outcome: Outcome) -> bool:
    """Whether effects are named, and the truth is not in the class of these names."""
    return _says("effects")(outcome) and is_confidently_wrong(outcome)


def is_resolved(outcome: Outcome) -> bool:
    """Whether an opening gave no wrong name, and the recording it asked for the right one."""
    if len(outcome.answers) < 2 or not outcome.advice:
        return False
    first, second = outcome.answers
    is_careful = first.kind == "insufficient" or outcome.is_in_class
    return is_careful and second.kind == "effects" and set(outcome.case.truth) <= set(second.effects)


def is_down_to_noise(outcome: Outcome) -> bool:
    """Whether the corrected model predicts held-out data about as well as their noise allows."""
    error = outcome.answers[0].after_holdout if outcome.answers else None
    return error is not None and error <= LARGEST_ERROR * outcome.noise_floor


def has_fallen(outcome: Outcome) -> bool:
    """Whether correcting the model made the held-out error smaller by as much as asked."""
    if not outcome.answers:
        return False
    before, after = outcome.answers[0].before_holdout, outcome.answers[0].after_holdout
    return before is not None and after is not None and before >= SMALLEST_FALL * after


def has_risen(outcome: Outcome) -> bool:
    """Whether the held-out error is larger after correction than before, by more than rounding; or it failed."""
    if not outcome.answers:
        return True
    before, after = outcome.answers[0].before_holdout, outcome.answers[0].after_holdout
    return before is not None and after is not None and after > (1.0 + ROUNDING) * before


def _single(singles: Sequence[Outcome]) -> list[Figure]:
    return [
        _share(1, "one effect: named uniquely", singles, lambda outcome: outcome.is_named, low=0.9),
        _share(1, "one effect: in the class", singles, lambda outcome: outcome.label in ("unique", "class"), low=0.97),
        _share(1, "one effect: confidently wrong", singles, is_confidently_wrong, high=0.01),
    ]


def _combined(outcomes: Sequence[Outcome]) -> list[Figure]:
    strong = _of(outcomes, "uncatalogued")
    faint = sum(1 for outcome in strong if _excess(outcome) < 1e6 * STRONG[0])
    return [
        _share(
            3,
            "two effects: both in the class",
            _of(outcomes, "pair"),
            lambda outcome: outcome.label in ("unique", "class"),
            low=0.8,
        ),
        _share(
            3,
            "no name, strong: unknown",
            strong,
            _says("unknown"),
            low=0.85,
            detail=f"({faint} move it by less than {1e6 * STRONG[0]:g} µm RMS)" if faint else "",
        ),
        _share(3, "no name, a tenth: confident name", _of(outcomes, "weak"), is_confidently_misnamed, high=0.05),
    ]


def _excess(outcome: Outcome) -> float:
    """µm RMS by which the refitted declared model misses the training data, beside the noise."""
    if not outcome.answers:
        return math.inf
    return math.sqrt(max(0.0, outcome.answers[0].before_train ** 2 - outcome.noise_floor**2))


def _corrected(outcomes: Sequence[Outcome]) -> list[Figure]:
    words = f"held-out error ≤ {LARGEST_ERROR:g} × noise after correction"
    return [_share(4, words, _of(outcomes, "single", "pair"), is_down_to_noise, low=0.9)]


def _covered(outcomes: Sequence[Outcome], number: int, low: float) -> list[Figure]:
    """Of what was named rightly: how often 95 % intervals hold the truth."""
    found: dict[str, list[bool]] = {"c1 and c2": [], "effects' parameters": []}
    by_name: dict[str, list[bool]] = {}
    for outcome in outcomes:
        for name, is_covered in (outcome.is_covered or {}).items():
            effect, dot, _ = name.partition(".")
            kind = "effects' parameters" if dot else "c1 and c2"
            for beginning, words in ((DECLARED, "declared values"), (RECORDED, "errors of the recording")):
                kind = words if name.startswith(beginning) else kind
            found.setdefault(kind, []).append(is_covered)
            if kind != "c1 and c2":
                by_name.setdefault(effect, []).append(is_covered)
    poor = [
        f"{name} {sum(held)}/{len(held)}" for name, held in by_name.items() if sum(held) < POOR_COVERAGE * len(held)
    ]
    lines = []
    for kind, held in found.items():
        words = f"95 % intervals of {kind} hold the truth"
        detail = ", ".join(text for text in poor if text.startswith(DECLARED) == (kind == "declared values"))
        share = sum(held) / max(1, len(held))
        lines.append(Figure(number, words, share, len(held), low, 0.98, detail="" if kind == "c1 and c2" else detail))
    return lines


def _times(timings: Sequence[Timing]) -> list[Figure]:
    lines = []
    for family, target in TIME_TARGETS.items():
        found = [timing for timing in timings if timing.family == family]
        seconds = [math.inf if timing.error else timing.seconds for timing in found]
        worst = f"(slowest {max(seconds):.1f} s)" if seconds else ""
        detail = "; ".join([worst, *(timing.error for timing in found if timing.error)])
        median = statistics.median(seconds) if seconds else math.nan
        lines.append(
            Figure(8, f"cold process, {family}: median", median, len(found), high=target, unit="s", detail=detail)
        )
    return lines


def _is_true(outcome: Outcome) -> bool:
    """Whether the first answer claims what is so: a class holds all that is to be named; nothing; something unnamed."""
    case = outcome.case
    kind = outcome.answers[0].kind if outcome.answers else "error"
    if kind == "unknown":
        return is_unnamed(case)
    if kind == "effects":
        return outcome.is_in_class and not _has_extra(outcome)
    return kind == "none" and not case.truth


def _has_extra(outcome: Outcome) -> bool:
    """Whether all that is true is named, and something besides that is not."""
    true = true_names(outcome.case)
    return outcome.is_in_class and any(not names & true for names in outcome.answers[0].classes)


def standing(outcome: Outcome) -> str:
    """Column of the table of families.

    "unique" is also "none" where nothing is missing, and "unknown" where all that is has no name; "missed" is what is
    not claimed and true; "wrong" names effects, and not what is true.
    """
    if outcome.label in ("unique", "class", "wrong", "error"):
        return outcome.label
    return "unique" if _is_true(outcome) and not true_names(outcome.case) else "missed"


def imperfection_table(outcomes: Sequence[Outcome]) -> str:
    """What became of recordings with errors: a row for each imperfection of all sizes, and for each laboratory.

    "right" names what is true and nothing else; where nothing is missing, that is "none". Dampings are counted where
    the verdict was right: how many of their 95 % intervals hold the truth.
    """
    rows: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        case = outcome.case
        if case.laboratory:
            rows.setdefault(f"{case.family} {case.laboratory.partition(':')[0]}", []).append(outcome)
            rows.setdefault(f"{case.family}, all", []).append(outcome)
    labels = {
        "none": "none",
        "unique": "right",
        **{label: label for label in LABELS if label not in ("none", "unique")},
    }
    head = f"{'imperfection':<30}{'cases':>6}" + "".join(f"{word:>13}" for word in labels.values())
    lines = [f"{head}{'≥ 0.9 wrong':>13}{'dampings':>10}{'of':>5}{'CPU s':>8}"]
    for name, found in sorted(rows.items(), key=lambda row: row[0].endswith(", all")):
        counts = Counter(outcome.label for outcome in found)
        held = [(one.is_covered or {})[damping] for one in found for damping in one.case.dampings if one.is_covered]
        seconds = [sum(answer.cpu_seconds for answer in one.answers) for one in found if one.answers]
        shown = "".join(f"{counts[label] or '·':>13}" for label in labels)
        shown += f"{sum(map(is_misnamed, found)) or '·':>13}{_mean(held, '.0%'):>10}{len(held):>5}"
        lines.append(f"{name:<30}{len(found):>6}{shown}{_mean(seconds, '.1f'):>8}")
    return "\n".join(lines)


def measured_table(outcomes: Sequence[Outcome]) -> str:
    """Other figures of each family: median, the largest without its sign, and how many are within what is wanted."""
    rows: dict[tuple[str, str], list[float]] = {}
    for outcome in outcomes:
        for name, value in outcome.measured.items():
            if value is not None:
                rows.setdefault((_measured_row(outcome), name), []).append(value)
    lines = [f"{'family':<50}{'figure':<42}{'median':>10}{'largest':>10}{'within':>10}{'of':>5}"]
    for (family, name), values in rows.items():
        wanted = FAMILIES[family.partition(",")[0]].wanted.get(name)
        within = "" if wanted is None else f"{sum(abs(value) <= wanted for value in values)}"
        middle, largest = statistics.median(values), max(values, key=abs)
        lines.append(f"{family:<50}{name:<42}{middle:>10.4g}{largest:>10.4g}{within:>10}{len(values):>5}")
    return "\n".join(lines) if rows else ""


def _measured_row(outcome: Outcome) -> str:
    """Each mistake of a laboratory is a row of its own."""
    case = outcome.case
    return f"{case.family}, {case.laboratory}" if case.family == "mistake" else case.family


def upper_limit(count: int, of: int) -> float:
    """The share that is exceeded by 5 % of all true shares of so many (Clopper and Pearson 1934), one-sided."""
    return 1.0 if count >= of else float(beta.ppf(0.95, count + 1, of - count))


def family_table(outcomes: Sequence[Outcome]) -> str:
    """What became of each family, at its limits by how many of them, and pooled: how often it was confidently wrong."""
    rows: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        rows.setdefault(_part(outcome), []).append(outcome)
    columns = ("unique", "class", "missed", "wrong", "error")
    head = f"{'family':<26}{'cases':>6}" + "".join(f"{column:>8}" for column in columns)
    head += f"{'≥ 0.9 wrong':>13}{'and extra':>11}{'CPU s':>8}{'Brier':>8}{'of':>5}{'95 % covers':>13}{'of':>5}"
    lines = [f"{head}{'in bands':>10}{'truth':>8}"]
    for name, found in [*rows.items(), *([("all", list(outcomes))] if len(rows) > 1 else [])]:
        counts = Counter(map(standing, found))
        shown = "".join(f"{counts[column] or '·':>8}" for column in columns)
        claims = [one for one in found if _says("effects")(one) or _says("none")(one)]
        squares = [(one.answers[0].probability - _is_true(one)) ** 2 for one in claims]
        covered = [own for one in found for own in (one.is_covered or {}).items()]
        held = [is_held for value, is_held in covered if not value.startswith(RECORDED)]
        seconds = [sum(answer.cpu_seconds for answer in one.answers) for one in found if one.answers]
        extra = sum(one.is_confident and _says("effects")(one) and _has_extra(one) for one in found)
        shown += f"{sum(map(is_misnamed, found)) or '·':>13}{extra or '·':>11}"
        shown += f"{_mean(seconds, '.1f'):>8}{_mean(squares, '.3f'):>8}"
        lines.append(
            f"{name:<26}{len(found):>6}{shown}{len(claims):>5}{_mean(held, '.1%'):>13}{len(held):>5}{_bands(found)}"
        )
    wrong, count = sum(map(is_misnamed, outcomes)), len(outcomes)
    pooled = f"{wrong} of {count}, {wrong / count:.2%}, upper 95 % limit {upper_limit(wrong, count):.2%}"
    return "\n".join([*lines, f"confidently wrong, all together: {pooled}"])


def _bands(outcomes: Sequence[Outcome]) -> str:
    """Shares of held-out samples, and of true positions, within 95 % of what right models predict."""
    known = [one.answers[0].in_bands for one in outcomes if one.answers and _is_true(one)]
    pairs = [pair for pair in known if pair is not None]
    true = [pair[1] for pair in pairs if pair[1] is not None]
    return f"{_mean([pair[0] for pair in pairs], '.1%'):>10}{_mean(true, '.1%'):>8}"


def _part(outcome: Outcome) -> str:
    """The family, with how many limits where that is what it is about, and what is wrong with an exact file."""
    family = outcome.case.family
    if family.startswith("at_limits"):
        return f"{family} {next(iter(outcome.case.amplitudes.values())):.2g}"
    if family == "exact_wrong":
        return f"{family} {'effect' if outcome.case.effects else 'value'}"
    return family


def _mean(values: Sequence[float], form: str) -> str:
    return format(statistics.fmean(values), form) if values else "–"


def is_misnamed(outcome: Outcome) -> bool:
    """Whether effects are named confidently, and not those that act; not a failure, which has its own column."""
    return not outcome.error and is_confidently_misnamed(outcome)


def confusion_table(outcomes: Sequence[Outcome]) -> str:
    """A row for every truth: how often it was named how, and the names that were wrong."""
    rows: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        rows.setdefault(_row(outcome), []).append(outcome)
    lines = [
        f"{'truth':<34}{'cases':>6}"
        + "".join(f"{label:>13}" for label in LABELS)
        + "  median s, and what else was named"
    ]
    for name, found in rows.items():
        counts = Counter(outcome.label for outcome in found)
        shown = "".join(f"{counts[label] or '·':>13}" for label in LABELS)
        lines.append(f"{name:<34}{len(found):>6}{shown}{_median_seconds(found):>10}  {_wrong_names(found)}".rstrip())
    return "\n".join(lines)


def _row(outcome: Outcome) -> str:
    """Pairs are too many for a row each."""
    family, names = outcome.case.family, " + ".join(outcome.case.truth)
    return f"{family} {names}" if names and family != "pair" else family


def _median_seconds(outcomes: Sequence[Outcome]) -> str:
    seconds = [sum(answer.seconds for answer in outcome.answers) for outcome in outcomes if outcome.answers]
    return f"{statistics.median(seconds):.1f}" if seconds else "–"


def _wrong_names(outcomes: Sequence[Outcome]) -> str:
    """What was named in place of the truth, or beside it, and by which cases."""
    return "; ".join(
        f"{outcome.case.name} {_misnamed(outcome)}"
        for outcome in outcomes
        if outcome.label in ("wrong", "error")
        or (outcome.label == "class" and set(outcome.answers[0].effects) != set(outcome.case.truth))
    )


def _misnamed(outcome: Outcome) -> str:
    if outcome.error:
        return outcome.error
    truth = " + ".join(outcome.case.truth) + " as " if outcome.case.family == "pair" else ""
    answer = outcome.answers[0]
    return f"{truth}{' + '.join(answer.effects)} ({outcome.label}, p {answer.probability:.2f})"


def reliability_table(outcomes: Sequence[Outcome]) -> str:
    """Probability against rightness of all claims: a class holds all that has a name, or none or unknown is right."""
    lines = [f"{'probability':<16}{'names':>7}{'right':>8}{'none':>7}{'right':>8}{'unknown':>9}{'right':>8}"]
    for low, high in pairwise(PROBABILITY_BINS):
        cells = []
        for kind in ("effects", "none", "unknown"):
            found = [
                outcome
                for outcome in filter(_says(kind), outcomes)
                if low <= outcome.answers[0].probability < high or (high == 1.0 == outcome.answers[0].probability)
            ]
            right = sum(map(_is_true, found))
            width = 9 if kind == "unknown" else 7
            cells.append(f"{len(found):>{width}}" + (f"{right / len(found):>8.1%}" if found else f"{'–':>8}"))
        lines.append(f"{low:.2f} to {high:.2f}    " + "".join(cells))
    return "\n".join(lines)
