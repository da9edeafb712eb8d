"""The training curve: losses over epochs, as figure "LSTM-based model training" of Wahby et al. 2018."""

from __future__ import annotations

import io
from collections.abc import Sequence

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def curve_png(
    train: Sequence[float],
    validate: Sequence[float],
    best_epochs: Sequence[int],
    *,
    level: tuple[str, float] | None = None,
    unit: str = "mean absolute error (normalised unit)",
) -> bytes:
    """Both losses over epochs, on a logarithmic axis.

    Args:
        train, validate: L_t and L_v per epoch, in units.
        best_epochs: those whose weights were kept, counted from 1: one, or one of each member.
        unit: of the losses, as the axis names it.
        level: name and loss of a trivial predictor, drawn as a line.

    Returns:
        A PNG; the same numbers give the same bytes.
    """
    figure = Figure(figsize=(6.4, 3.6), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    epochs = range(1, len(train) + 1)
    axes.plot(epochs, train, color="#3b6fd4", marker=".", label="training loss $L_t$")
    axes.plot(epochs, validate, color="#c8372d", marker=".", label="validation loss $L_v$")
    kept = f"kept: epoch {', '.join(map(str, best_epochs))}{' (of each member)' if len(best_epochs) > 1 else ''}"
    for k, epoch in enumerate(best_epochs):
        axes.axvline(epoch, color="#9a9a9a", linestyle="--", linewidth=1, label="" if k else kept)
    if level is not None:
        axes.axhline(level[1], color="black", linestyle=":", linewidth=1, label=level[0])
    axes.set_yscale("log")
    axes.set(xlabel="epoch", ylabel=unit)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    png = io.BytesIO()
    figure.savefig(png, format="png", metadata={"Software": None})
    return png.getvalue()
