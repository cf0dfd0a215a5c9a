"""Write the recurrences of a Taylor series out, as two modules of `valve_sim/model` have them.

In test/: `python -m model.taylor_source` writes them again. Written out, because loops over arrays take more than twice
the time; and twice, because those with forces of effects take 1.6 times as long as those without.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

ORDER = 14
"""Of x in a step. Measured for an opening at 1e-8: 12 takes 18 steps, 14 takes 14 in 0.75 of the time, 16 no less."""
WIDTH = 120

TOP = '''"""The recurrences of `taylor_series`, {}written out by `test/model/taylor_source.py`, which says why.

Not to be edited.
"""

# fmt: off
# ruff: noqa: PLR0915

from __future__ import annotations
'''

PLAIN = (
    TOP.format("")
    + f'''
from typing import Final

from valve_sim.model.compiling import inner

ORDER: Final = {ORDER}
"""Of x in a step."""


@inner
def coefficients(series, velocity_series, start, current, attraction, motion):
    """Write the series of x, m/s^k, and of v.

    Here `q` is a1 + a2 x + a3 x², `g` the bracket of (2), `w` the current that pulls and `s` its square.

    Args:
        start: x and v, m and m/s. current: (T, A, 1/τ, B, 1/τ_e). attraction: (a0, a1, a2, a3).
        motion: (L, r, c, 1/m), N, N/m, N·s/m, 1/kg.
    """
'''
)

WITH_EFFECTS = (
    TOP.format("with effects, ")
    + '''
from valve_sim.model.compiling import inner


@inner
def coefficients_with_effects(series, velocity_series, start, current, attraction, motion, effects):
    """As `taylor_coefficients`, with forces of effects.

    Besides, `z` is `s` after (7), `y` and `c` are x² and x³, `d` is v², and `e` is the force that decays.

    Args:
        effects: forces, N, for each m²/s² of v² and each m³ of x³; a force that decays, N, and the reciprocal of its
            time constant, 1/s; k of the saturation s (1 + k)/(1 + k s).
    """
    of_v_squared, of_x_cubed, e_0, decay_rate, saturation = effects
'''
)

BEGIN = """    x_0, x_1 = start
    target, a_0, rate, b_0, eddy_rate = current
    a0, a1, a2, a3 = attraction
    load, spring, damping, per_mass = motion
    w_0 = target + a_0 + b_0
"""


def product(a: str, b: str, order: int) -> str:
    """Cauchy's rule: coefficient `order` of the product of two series. What `b` has last is added last."""
    inner_terms = [f"{a}_{j} * {b}_{order - j}" for j in range(1, order)]
    outer_terms = [f"{a}_{order} * {b}_0", f"{a}_0 * {b}_{order}"] if order else [f"{a}_0 * {b}_0"]
    return " + ".join(inner_terms + outer_terms)


def square(a: str, order: int) -> str:
    """The same of a series by itself, whose terms come in pairs."""
    middle = [f"{a}_{order // 2} * {a}_{order // 2}"] if order % 2 == 0 else []
    pairs = [f"{a}_{j} * {a}_{order - j}" for j in range((order - 1) // 2, -1, -1)]
    doubled = [f"2.0 * ({' + '.join(pairs)})"] if pairs else []
    return " + ".join(middle + doubled)


def saturated(order: int) -> list[tuple[str, str]]:
    """(7): z (1 + k s) = s (1 + k), solved for the last coefficient of z."""
    if order == 0:
        return [
            ("share", "1.0 / (1.0 + saturation * s_0)"),
            ("grown", "(1.0 + saturation) * share"),
            ("folded", "saturation * share"),
            ("z_0", "grown * s_0"),
        ]
    before = " + ".join(f"s_{j} * z_{order - j}" for j in range(1, order + 1))
    return [(f"z_{order}", f"grown * s_{order} - folded * ({before})")]


def of_current(k: int) -> list[tuple[str, str]]:
    """The current that pulls, and its square."""
    decays = [
        (f"a_{k}", f"-a_{k - 1} * rate * {1 / k!r}"),
        (f"b_{k}", f"-b_{k - 1} * eddy_rate * {1 / k!r}"),
        (f"w_{k}", f"a_{k} + b_{k}"),
    ] if k > 0 else []  # fmt: skip
    return [*decays, (f"s_{k}", square("w", k))]


def plain(k: int) -> list[tuple[str, str]]:
    """The k-th coefficient of the forces, and what follows from it."""
    force = f"f_{k} - spring * x_{k} - damping * {k + 1.0} * x_{k + 1}"
    return [
        *of_current(k),
        (f"q_{k}", f"a2 * x_{k} + a3 * ({square('x', k)})" + (" + a1" if k == 0 else "")),
        (f"g_{k}", product("x", "q", k) + (" + a0" if k == 0 else "")),
        (f"f_{k}", product("s", "g", k) + (" - load" if k == 0 else "")),
        (f"x_{k + 2}", f"({force}) * (per_mass * {1 / ((k + 1) * (k + 2))!r})"),
    ]


def with_effects(k: int) -> list[tuple[str, str]]:
    """The same with forces of effects. In one block without a branch the compiler spills more than the cubes take."""
    force = f"f_{k} - spring * x_{k} + of_x_cubed * c_{k} - damping * v_{k} + of_v_squared * d_{k}"
    decays = [(f"e_{k}", f"-e_{k - 1} * decay_rate * {1 / k!r}")] if k > 0 else []
    return [
        *of_current(k),
        *saturated(k),
        *decays,
        (f"y_{k}", square("x", k)),
        (f"q_{k}", f"a2 * x_{k} + a3 * y_{k}" + (" + a1" if k == 0 else "")),
        (f"g_{k}", product("x", "q", k) + (" + a0" if k == 0 else "")),
        (f"v_{k}", f"{k + 1.0} * x_{k + 1}"),
        (f"c_{k}", f"{product('x', 'y', k)} if of_x_cubed != 0.0 else 0.0"),
        (f"d_{k}", square("v", k)),
        (f"f_{k}", product("z", "g", k) + f" + e_{k}" + (" - load" if k == 0 else "")),
        (f"x_{k + 2}", f"({force}) * (per_mass * {1 / ((k + 1) * (k + 2))!r})"),
    ]


def written_out(orders: list[list[tuple[str, str]]]) -> str:
    """What is assigned, in order, given names and expressions of each order."""
    found = [statement for order in orders for statement in order]
    found += [(f"series[{k}]", f"x_{k}") for k in range(ORDER + 1)]
    found += [(f"velocity_series[{k}]", f"{k + 1.0} * x_{k + 1}") for k in range(ORDER)]
    lines = []
    for name, expression in found:
        line = f"    {name} = {expression}"
        if len(line) > WIDTH:
            parts = textwrap.wrap(expression, WIDTH - 8, break_long_words=False)
            line = f"    {name} = (\n" + "".join(f"        {part}\n" for part in parts) + "    )"
        lines.append(line)
    return BEGIN + "\n".join(lines) + "\n"


def sources() -> dict[Path, str]:
    """What the two modules are."""
    folder, orders = Path(__file__).parents[2] / "valve_sim" / "model", range(ORDER - 1)
    return {
        folder / "taylor_coefficients.py": PLAIN + written_out([plain(k) for k in orders]),
        folder / "taylor_with_effects.py": WITH_EFFECTS + written_out([with_effects(k) for k in orders]),
    }


if __name__ == "__main__":
    for module, text in sources().items():
        module.write_text(text, encoding="utf-8")
