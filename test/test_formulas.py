"""Formulas that are printed from the equations' graphs."""

from __future__ import annotations

import pytest
from formulas import equations_without_effects, formulas_of, latex

from valve_sim.model import CATALOGUE
from valve_sim.model.core.tracer import Node, Trace, exp, maximum, minimum, sqrt, where

TRACE = Trace()
X, V, A, B = TRACE.state("x"), TRACE.state("v"), TRACE.number("stroke"), TRACE.number("film_thickness")


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (-A * X**3, r"- s \, {x}^3"),
        (A - (X - B), r"s + \text{film thickness} - x"),
        (A * (X + B), r"s \, \left(x + \text{film thickness}\right)"),
        ((A / B) ** 2, r"\frac{{s}^2}{{\text{film thickness}}^2}"),
        (X / (3.0 * A), r"\frac{\tfrac{1}{3} \, x}{s}"),
        (2.0 * exp(-X / A), r"2 \, e^{- \frac{x}{s}}"),
        (sqrt(A / B), r"\sqrt{\frac{s}{\text{film thickness}}}"),
        (maximum(0.0, X), r"\max\left(0,\; x\right)"),
        (minimum(X, A), r"\min\left(s,\; x\right)"),
        (where(TRACE.number("lifted") > 0.5, X, 0.0),
         r"\begin{cases} x & \text{in Phase 2} \\ 0 & \text{in Phase 1} \end{cases}"),
    ],
)  # fmt: skip
def test_an_expression_is_written_as_a_person_would(expression: Node, expected: str) -> None:
    assert latex(expression) == expected


def test_the_equations_without_effects_are_those_of_the_paper_with_a_coil() -> None:
    pull = r"\left(a_0 + a_1 \, x + a_2 \, x^2 + a_3 \, x^3\right) \, {u}^2"
    assert equations_without_effects() == [
        rf"m_1 \dot v = {pull} - F_\mathrm{{seat}} - c_1 \, v",
        rf"m_2 \dot v = {pull} - F_0 - k \, x - c_2 \, v",
        r"\dot u = \frac{\frac{V}{V_\mathrm{ref}} - u}{\tau}",
    ]


def test_every_force_and_friction_of_the_catalogue_has_its_formula() -> None:
    for effect in CATALOGUE.values():
        first = [formula.split(" = ")[0] for formula in formulas_of(effect)]
        if not effect.shapes:
            assert ("F" in first, "F_f" in first) == (effect.force is not None, effect.friction is not None)


def test_a_formula_has_all_parameters_of_its_effect() -> None:
    for effect in CATALOGUE.values():
        formulas = " ".join(formulas_of(effect))
        if formulas:
            assert [name for name in effect.names if name.replace("_", " ") not in formulas] == []
