"""Parts of what results show in a notebook: HTML without style sheets or scripts."""

from html import escape

import numpy as np
from numpy.typing import NDArray


def table(rows: list[tuple[str, str]]) -> str:
    body = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th><td style="text-align:left">{escape(text)}</td></tr>'
        for name, text in rows
        if text
    )
    return f"<table>{body}</table>"


def bars(rows: list[tuple[str, float]]) -> str:
    """Shares as horizontal bars (SVG)."""
    if not rows:
        return ""
    largest = max(share for _, share in rows) or 1.0
    lines = [
        f'<text x="0" y="{20 * i + 14}">{escape(name)}</text>'
        f'<rect x="230" y="{20 * i + 4}" width="{200 * share / largest:.1f}" height="12" fill="#26859a"/>'
        f'<text x="{236 + 200 * share / largest:.1f}" y="{20 * i + 14}">{100 * share:.0f} %</text>'
        for i, (name, share) in enumerate(rows)
    ]
    size = f'width="500" height="{20 * len(rows) + 6}"'
    return f'<svg {size} font-size="12" fill="currentColor" role="img">{"".join(lines)}</svg>'


def traces(values: NDArray[np.float64], width: int = 500, height: int = 90) -> str:
    """The columns of (T, K) values over time as lines of one scale (SVG)."""
    keep = np.linspace(0, len(values) - 1, min(len(values), width)).astype(int)
    low, high = np.nanmin(values), np.nanmax(values)
    x = width * keep / max(len(values) - 1, 1)
    y = 2 + (height - 4) * (high - values[keep]) / max(high - low, 1e-9)
    lines = [
        f'<polyline fill="none" stroke="hsl({300 * k // y.shape[1]} 60% 42%)" points="'
        + " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, column, strict=True) if np.isfinite(b))
        + '"/>'
        for k, column in enumerate(y.T)
    ]
    return f'<svg width="{width}" height="{height}" role="img">{"".join(lines)}</svg>'
