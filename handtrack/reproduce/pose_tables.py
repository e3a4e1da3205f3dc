"""Tables 3.1-3.6 of the hand thesis, theirs beside ours: nothing in, six tables of Gauss-Newton iterates out.

Each table follows a chain of section 3.2 from a start pose to the pose of minimal cost ``H = ||residuals||^2 / 2``, eq.
(3.3), by full or damped Gauss-Newton steps, eq. (3.4). Printed values that a correct computation cannot give are shown
all the same, marked as not expected, and explained in the errata.
"""

import json
import math
import textwrap
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..solve import solve
from .chains import ChainProblem, p_chain, pr_chain, r_chain, rr_chain

# Half a unit of the last printed decimal, and a little for values that lie on the edge.
_PRINTED = 0.5e-4 * (1.0 + 1e-6)
# The criterion of sections 3.2.3 and 3.2.4: sum of the corrections, radians.
_SETTLED = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class PoseRow:
    """One iterate: the joint values, then the cost.

    Attributes
    ----------
    k : int
        Number of the iterate as printed.
    ours_k : int
        Number of our iterate beside it; it differs where the two runs settle after different numbers of steps.
    ours, printed : (j + 1,)
        Radians or the chain's length unit, then H; NaN where nothing is printed.
    expected : (j + 1,)
        Whether a correct computation gives the printed value.
    """

    k: int
    ours_k: int
    ours: Float[np.ndarray, " v"]
    printed: Float[np.ndarray, " v"]
    expected: Bool[np.ndarray, " v"]

    @property
    def agrees(self) -> Bool[np.ndarray, " v"]:
        """Which values are the printed ones to the printed decimals."""
        return np.abs(self.ours - self.printed) <= _PRINTED


@dataclass(frozen=True, slots=True, eq=False)
class PoseTable:
    """One table: `name` as printed, the chain, its columns, rows, ideal pose, and what is wrong in print.

    `steps` counts our corrections up to the first that sums to 1e-5 or less; `status` is the solver's verdict.
    """

    name: str
    chain: str
    columns: tuple[str, ...]
    rows: tuple[PoseRow, ...]
    ideal: Float[np.ndarray, " j"]
    steps: int
    status: str
    errata: tuple[str, ...]

    @property
    def reproduced(self) -> bool:
        """Whether every value that should agree with the printed one does."""
        return all(bool((row.agrees | ~row.expected).all()) for row in self.rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Printed:
    """A table as printed: k, the values, and which of them ("111", one digit each) a correct computation gives."""

    name: str
    chain: str
    columns: tuple[str, ...]
    start: tuple[float, ...]
    ideal: tuple[float, ...]
    rows: tuple[tuple[int, tuple[float, ...], str], ...]
    errata: tuple[str, ...] = ()
    eta: float = 1.0


_RR_IDEAL = (-math.pi / 3, -2 * math.pi / 3)
_RR_START = (math.radians(30.0), math.radians(-60.0))

_R = _Printed(
    name="3.1",
    chain="R",
    columns=("theta1", "H"),
    start=(math.radians(120.0),),
    ideal=(math.pi / 2,),
    rows=(
        (0, (2.0944, 4.9744), "11"),
        (1, (1.5727, 0.0001), "11"),
        (2, (1.5708, 0.0), "11"),
        (3, (1.5708, 0.0), "11"),
        (4, (1.5708, 0.0), "11"),
    ),
)
_P = _Printed(
    name="3.2",
    chain="P",
    columns=("d1", "H"),
    start=(1.0,),
    ideal=(0.0,),
    rows=((0, (1.0, 1.5), "11"), (1, (0.0, 0.0), "11"), (2, (0.0, 0.0), "11")),
)
_PR = _Printed(
    name="3.3",
    chain="PR",
    columns=("d1", "theta2", "H"),
    start=(2.0, math.radians(60.0)),
    ideal=(3.0, math.radians(-30.0)),
    rows=(
        (0, (2.0, 1.0472, 43.9103), "111"),
        (1, (6.8490, 0.4321, 2.1344), "111"),
        (2, (5.1707, 0.0480, 0.7339), "111"),
        (5, (2.9998, -0.5237, 0.0005), "110"),
        (6, (3.0, -0.5236, 0.0), "111"),
        (7, (3.0, -0.5236, 0.0), "111"),
    ),
    errata=(
        "The printed projection has y = p0y + P s(theta2); its own Jacobian and residual use P c(theta2), as here.",
        "The cost 0.0005 printed at k = 5 is that of k = 4; at k = 5 it is below 0.0001.",
    ),
)
_RR = _Printed(
    name="3.4",
    chain="RR",
    columns=("theta1", "theta2", "H"),
    start=(math.radians(-42.0), math.radians(-102.0)),
    ideal=_RR_IDEAL,
    rows=(
        (0, (-0.7330, -1.7802, 5.2081), "111"),
        (1, (-0.8616, -2.2315, 0.7270), "000"),
        (2, (-1.0617, -2.0927, 0.0038), "000"),
        (4, (-1.0472, -2.0943, 0.0), "000"),
        (5, (-1.0472, -2.0944, 0.0), "111"),
        (6, (-1.0472, -2.0944, 0.0), "111"),
    ),
    errata=(
        "The printed k = 1 does not follow from the printed Jacobian; a correct step more than halves its cost.",
        "The equations pair line r1 with the terminal link; the printed costs need r1 on the base link.",
    ),
)
_RR_FAR = _Printed(
    name="3.5",
    chain="RR, far start",
    columns=("theta1", "theta2", "H"),
    start=_RR_START,
    ideal=_RR_IDEAL,
    rows=(
        (0, (0.5236, -1.0472, 109.3510), "111"),
        (1, (1.2304, -4.4211, 131.2587), "111"),
        (2, (1.1705, -1.9139, 105.1625), "000"),
        (14, (3.3975, -4.5082, 7.9345), "000"),
        (15, (3.3974, -4.5082, 7.9345), "000"),
        (16, (3.3974, -4.5082, 7.9345), "000"),
    ),
    errata=(
        "The thesis says that this start leads to a pose which is not the ideal one. It does not: correct full steps "
        "raise the cost at k = 1, as printed, and then reach the ideal pose.",
        "The printed end is no minimum either: the cost falls there at a rate of 2.04 per radian of theta2.",
        "Its lesson holds all the same: full steps can overshoot and raise the cost; trust-region steps do not.",
    ),
)
_RR_DAMPED = _Printed(
    name="3.6",
    chain="RR, far start, eta = 0.1",
    columns=("theta1", "theta2", "H"),
    start=_RR_START,
    ideal=_RR_IDEAL,
    rows=(
        (0, (0.5236, -1.0472, 109.3510), "111"),
        (1, (0.5943, -1.3846, 93.2694), "111"),
        (2, (0.6476, -1.6683, 79.9565), "000"),
        (96, (-1.0471, -2.0944, 0.0), "000"),
        (97, (-1.0471, -2.0944, 0.0), "111"),
    ),
    errata=(
        "The printed k = 2 differs from a correct step, as in Table 3.4; the printed end is reached 7 steps later.",
        "The remaining 1e-4 rad are 0.0057 degrees, not 0.0573.",
    ),
    eta=0.1,
)


def pose_tables() -> tuple[PoseTable, ...]:
    """All six tables, computed.

    Returns
    -------
    tuple of PoseTable
        In the order of the thesis.

    Notes
    -----
    Hand thesis, section 3.2, Tables 3.1-3.6.

    Examples
    --------
    >>> [(table.name, table.reproduced) for table in pose_tables()]
    [('3.1', True), ('3.2', True), ('3.3', True), ('3.4', True), ('3.5', True), ('3.6', True)]
    """
    return tuple(
        _computed(printed, problem)
        for printed, problem in (
            (_R, r_chain()),
            (_P, p_chain()),
            (_PR, pr_chain()),
            (_RR, rr_chain()),
            (_RR_FAR, rr_chain()),
            (_RR_DAMPED, rr_chain()),
        )
    )


def _computed(printed: _Printed, problem: ChainProblem) -> PoseTable:
    method = "gauss-newton" if printed.eta == 1.0 else "damped"
    path = solve(problem, np.array(printed.start), method=method, step=printed.eta, max_steps=300, trace=True)
    values = np.column_stack([path.trace_x, path.trace_cost])
    correction = np.abs(np.diff(path.trace_x, axis=0)).sum(axis=1)
    end = int(np.argmax(np.append(correction, 0.0) <= _SETTLED))
    rows = []
    for k, theirs, expected in printed.rows:
        # Ours may settle earlier or later than theirs: the last printed row stands beside our end, no row beyond it.
        is_last = k == printed.rows[-1][0]
        ours_k = end if is_last else min(k, end)
        rows.append(
            PoseRow(
                k=k,
                ours_k=ours_k,
                ours=values[ours_k],
                printed=np.array(theirs),
                expected=np.array([digit == "1" for digit in expected]),
            )
        )
    return PoseTable(
        name=printed.name,
        chain=printed.chain,
        columns=printed.columns,
        rows=tuple(rows),
        ideal=np.array(printed.ideal),
        steps=end + 1,
        status=path.status,
        errata=printed.errata,
    )


def as_text(tables: tuple[PoseTable, ...]) -> str:
    """The tables for a terminal: ours and theirs side by side, then the errata.

    Returns
    -------
    str
        Lines of at most 120 characters; ``=`` marks values that agree, ``x`` values that should and do not, ``~``
        values that cannot (see the errata).

    Examples
    --------
    >>> print(as_text(pose_tables()[1:2]))
    Table 3.2: chain P, Gauss-Newton stops at step 2, reproduced
        k       d1 ours    printed        H ours    printed
        0        1.0000 =   1.0000        1.5000 =   1.5000
        1        0.0000 =   0.0000        0.0000 =   0.0000
        2        0.0000 =   0.0000        0.0000 =   0.0000
    """
    return "\n\n".join("\n".join(_table_lines(table)) for table in tables)


def _table_lines(table: PoseTable) -> list[str]:
    verdict = "reproduced" if table.reproduced else "NOT REPRODUCED"
    lines = [f"Table {table.name}: chain {table.chain}, Gauss-Newton stops at step {table.steps}, {verdict}"]
    lines.append("    k  " + "  ".join(f"{name + ' ours':>12}  {'printed':>9}" for name in table.columns))
    for row in table.rows:
        cells = []
        for ours, theirs, agrees, expected in zip(row.ours, row.printed, row.agrees, row.expected, strict=True):
            mark = "=" if agrees else "x" if expected else "~"
            cells.append(f"{_four(ours):>12} {mark} {_four(theirs):>8}")
        later = f"  (ours: k = {row.ours_k})" if row.ours_k > row.k else ""
        lines.append(f"{row.k:>5}  " + "  ".join(cells) + later)
    for text in table.errata:
        lines += textwrap.wrap(text, 118, initial_indent="  * ", subsequent_indent="    ")
    return lines


def _four(value: float) -> str:
    # Adding zero turns the -0 that rounding leaves into 0.
    return f"{round(float(value), 4) + 0.0:.4f}"


def as_json(tables: tuple[PoseTable, ...]) -> str:
    """The tables as JSON: a list of objects with the fields of `PoseTable` and, in their rows, of `PoseRow`.

    Examples
    --------
    >>> json.loads(as_json(pose_tables()))[1]["rows"][1]["printed"]
    [0.0, 0.0]
    """
    return json.dumps(
        [
            {
                "name": table.name,
                "chain": table.chain,
                "columns": list(table.columns),
                "steps": table.steps,
                "status": table.status,
                "reproduced": table.reproduced,
                "ideal": table.ideal.tolist(),
                "rows": [
                    {
                        "k": row.k,
                        "ours_k": row.ours_k,
                        "ours": (row.ours + 0.0).tolist(),
                        "printed": row.printed.tolist(),
                        "expected": row.expected.tolist(),
                        "agrees": row.agrees.tolist(),
                    }
                    for row in table.rows
                ],
                "errata": list(table.errata),
            }
            for table in tables
        ],
        indent=2,
    )
