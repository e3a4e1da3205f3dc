"""
From residuals to a pose
========================

The pose of a chain is the one whose projection lies on what the image shows. Residuals measure what is missing: the
tip against the observed tip, eq. (3.1) of the hand thesis, and points on each link against its line, eq. (3.2).
Half their squared norm is the cost, eq. (3.3), and Gauss-Newton walks down it, eq. (3.4).

The arm of section 3.2.4 has two links and starts far from the truth. The thesis drew its cost and two ways down it in
Figure 3.31; this example draws them again, with the methods that came later.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from handtrack.reproduce.chains import rr_chain
from handtrack.solve import solve

parser = argparse.ArgumentParser(description="Draws four ways down the cost of a chain with two joints.")
parser.add_argument("--out", help="file to save the figure to; nothing is saved without it")
out = parser.parse_known_args()[0].out

# %%
# Residuals and their Jacobian
# ----------------------------
# A problem is a function of the pose. This one knows the arm, its camera, the tip and the two lines.

arm = rr_chain()
start = np.radians([30.0, -60.0])
residual, jacobian = arm(start)
print("residuals at the start:", residual.round(2), f"cost: {residual @ residual / 2:.2f}", "Jacobian:", jacobian.shape)

# %%
# Four ways down
# --------------
# Full steps overshoot: the cost rises, and the walk crosses the valley several times. A tenth of each step is safe and
# slow. Levenberg-Marquardt and the trust region judge each step by what it promised.

ways = {
    "Gauss-Newton": solve(arm, start, method="gauss-newton", trace=True),
    "damped, eta = 0.1": solve(arm, start, method="damped", step=0.1, max_steps=200, tolerance=1e-6, trace=True),
    "Levenberg-Marquardt": solve(arm, start, trace=True),
    "trust region": solve(arm, start, method="trust-region", trace=True),
}
for name, way in ways.items():
    highest = way.trace_cost.max()
    print(
        f"{name:20} {way.status}, {way.steps:3d} steps, pose {np.degrees(way.x).round(2)}, highest cost {highest:.1f}"
    )

# %%
# How sure is the pose?
# ---------------------
# With residuals in units of their noise, ``(J^T J)^-1`` is the covariance of the solution. With noise of 0.1 units:

sigma = 0.1 * np.degrees(np.sqrt(np.diag(ways["Levenberg-Marquardt"].covariance)))
print("sigma of the two angles:", sigma.round(2), "degrees")

# %%
# The cost surface
# ----------------

theta1, theta2 = np.meshgrid(np.linspace(-2.6, 2.2, 90), np.linspace(-5.0, 0.5, 90))
cost = np.array([0.5 * (arm(q)[0] ** 2).sum() for q in np.stack([theta1.ravel(), theta2.ravel()], axis=1)])
figure, axes = plt.subplots(figsize=(8, 6))
levels = axes.contourf(theta1, theta2, cost.reshape(theta1.shape), levels=25, cmap="Greys")
for (name, way), style in zip(ways.items(), ("r-o", "b-", "g-s", "m-^"), strict=True):
    axes.plot(*way.trace_x.T, style, ms=4, lw=1.5, label=f"{name}, {way.steps} steps")
axes.plot(-np.pi / 3, -2 * np.pi / 3, "y*", ms=16, label="ideal pose")
axes.set(title="Cost of an arm with two joints", xlabel="theta1, rad", ylabel="theta2, rad")
axes.legend(fontsize="small", loc="upper left")
figure.colorbar(levels, label="H")
if out:
    figure.savefig(out, dpi=120)
if plt.get_backend().lower() != "agg":  # matplotlib falls back to it where there is no display
    plt.show()
