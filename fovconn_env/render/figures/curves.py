"""The functions behind the controller: V of lambda2 (Fig. 2) and the activation functions (Fig. 3)."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from fovconn_env.kernel.maths.weights import rise
from fovconn_env.render.figures import style


@matplotlib.rc_context(style.RC)
def draw_potential(
    lambda2: np.ndarray, value: np.ndarray, bounds: tuple[float, float], *, clamp: float = 0.0
) -> Figure:
    """Fig. 2: V over lambda2, V on a logarithmic axis.

    lambda2 (L,), increasing, above the asymptote; value (L,), V of it; bounds: lambda2_min, where V has its asymptote,
    and lambda2_max, above which V is 0. The law clamps lambda2 to lambda2_min + clamp.
    """
    (low, high), clamped = bounds, bounds[0] + clamp
    figure = style.sheet(7.5, 3.6)
    axes = figure.add_subplot()
    shown = value > 0
    floor, top = float(np.interp(0.97 * high, lambda2, value)), float(value.max())
    axes.set(yscale="log", xlim=(-0.03 * high, 1.08 * high), ylim=(floor, 3.0 * top))
    active = lambda2 >= clamped
    axes.plot(lambda2[~active], value[~active], ls=":", color=style.FAINT, lw=1.4)
    axes.plot(lambda2[active & shown], value[active & shown], color="#0072B2", lw=2.0)
    axes.axvline(low, color=style.TRUTH, ls="--", lw=1.1)
    axes.axvline(high, color=style.FAINT, ls="--", lw=1.1)
    note = {"textcoords": "offset points", "va": "center", "fontsize": 8.5}
    leader_line = {"arrowstyle": "-", "color": style.FAINT, "lw": 0.7}
    axes.annotate(
        rf"asymptote at $\lambda_2^{{\min}} = {low:g}$",
        (low, 1.6 * top),
        (24, 0),
        color=style.TRUTH,
        arrowprops=leader_line | {"color": style.TRUTH},
        **note,
    )
    if clamp > 0:
        height = float(np.interp(clamped, lambda2, value))
        text = rf"slope held below $\lambda_2 = {clamped:g}$ (clamp {clamp:g})"
        axes.plot(clamped, height, "o", color="#0072B2", ms=5)
        axes.annotate(text, (clamped, height), (24, 0), arrowprops=leader_line, **note)
    axes.annotate(rf"$V = 0$ from $\lambda_2^{{\max}} = {high:g}$", (high, 0.3 * top), (-6, 0), ha="right", **note)
    axes.set(xlabel=r"$\lambda_2$", ylabel=r"$V^\lambda(\lambda_2)$")
    return figure


@matplotlib.rc_context(style.RC)
def draw_activation(low: float = 2.0, high: float = 6.0) -> Figure:
    """Fig. 3: the rising (7) and the falling (8) activation function between two thresholds."""
    x = np.linspace(low - 0.5 * (high - low), high + 0.5 * (high - low), 401)
    rising = np.array([rise(float(at), low, high) for at in x])
    figure = style.sheet(7.5, 2.9)
    curves = (("rising", r"$w_1^0(x, x^d, x^D)$  (7)", rising), ("falling", r"$w_0^1(x, x^d, x^D)$  (8)", 1.0 - rising))
    for axes, (name, label, values) in zip(figure.subplots(1, 2, sharey=True), curves, strict=True):
        axes.axvspan(low, high, color="#F2F2F2", lw=0, zorder=0)
        axes.plot(x, values, color="#0072B2", lw=2.0)
        axes.set(title=name, xlabel="$x$", ylabel=label, xlim=(x[0], x[-1]), ylim=(-0.06, 1.06))
        axes.set_xticks([low, high], [r"$x^d$", r"$x^D$"], fontsize=11)
        axes.set_yticks([0.0, 0.5, 1.0])
    return figure
