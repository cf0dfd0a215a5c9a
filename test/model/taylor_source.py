"""Write the recurrences of a Taylor series out, as `valve_sim/model/taylor_coefficients.py` has them.

In test/: `python -m model.taylor_source > ../valve_sim/model/taylor_coefficients.py` writes it again. Written out,
because loops over arrays take more than twice the time.
"""

from __future__ import annotations

import textwrap

ORDER = 14
"""Of x in a step. Measured for an opening at 1e-8: 12 takes 18 steps, 14 takes 14 in 0.75 of the time, 16 no less."""
WIDTH = 120

HEAD = f'''"""The recurrences of `taylor_series`, written out by `test/model/taylor_source.py`, which says why.

Not to be edited.
"""

# fmt: off
# ruff: noqa: PLR0915

from __future__ import annotations

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
    x_0, x_1 = start
    target, a_0, rate, b_0, eddy_rate = current
    a0, a1, a2, a3 = attraction
    load, spring, damping, per_mass = motion
    w_0 = target + a_0 + b_0
'''


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


def statements() -> list[tuple[str, str]]:
    """What is assigned, in order: name and expression."""
    found = []
    for k in range(ORDER - 1):
        if k > 0:
            found.append((f"a_{k}", f"-a_{k - 1} * rate * {1 / k!r}"))
            found.append((f"b_{k}", f"-b_{k - 1} * eddy_rate * {1 / k!r}"))
            found.append((f"w_{k}", f"a_{k} + b_{k}"))
        force = f"f_{k} - spring * x_{k} - damping * {k + 1.0} * x_{k + 1}"
        found += [
            (f"s_{k}", square("w", k)),
            (f"q_{k}", f"a2 * x_{k} + a3 * ({square('x', k)})" + (" + a1" if k == 0 else "")),
            (f"g_{k}", product("x", "q", k) + (" + a0" if k == 0 else "")),
            (f"f_{k}", product("s", "g", k) + (" - load" if k == 0 else "")),
            (f"x_{k + 2}", f"({force}) * (per_mass * {1 / ((k + 1) * (k + 2))!r})"),
        ]
    found += [(f"series[{k}]", f"x_{k}") for k in range(ORDER + 1)]
    return found + [(f"velocity_series[{k}]", f"{k + 1.0} * x_{k + 1}") for k in range(ORDER)]


def source() -> str:
    """The whole module."""
    lines = []
    for name, expression in statements():
        line = f"    {name} = {expression}"
        if len(line) > WIDTH:
            parts = textwrap.wrap(expression, WIDTH - 8, break_long_words=False)
            line = f"    {name} = (\n" + "".join(f"        {part}\n" for part in parts) + "    )"
        lines.append(line)
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(source(), end="")
