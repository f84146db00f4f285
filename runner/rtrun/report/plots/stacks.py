"""The picture of layers put upon one another: the mean of the lowest one, then what each layer above adds to it."""

from collections.abc import Iterator, Sequence

from rtrun.report.layers import LayerBar
from rtrun.report.plots.charts import Plot, Trace, plain

_COLOURS = 8  # --series-0 to --series-7
_BAR = 0.36  # of the room that a chain has


def stacked(chains: Sequence[Sequence[LayerBar]]) -> list[Plot]:
    """One plot with a bar for each chain of layers; none where there are no chains."""
    if not chains:
        return []
    hidden = {"visible": False, "fixedrange": True, "range": [len(chains) - 0.5, -0.6]}
    layout = {
        "barmode": "overlay",
        "height": 90 + 74 * len(chains),
        "xaxis": {"rangemode": "tozero"},
        "yaxis": hidden,
    }
    caption = (
        "Means in us put upon one another, from the lowest layer on the left. Lines are intervals of what each adds. "
        "Quantiles and shares of late values do not add up: they are in the table."
    )
    data = [part for row, chain in enumerate(chains) for part in _parts(row, chain)]
    data += [text for row, chain in enumerate(chains) for text in _texts(row, chain)]
    return [Plot(caption=caption, data=data, layout=layout)]


def _parts(row: int, chain: Sequence[LayerBar]) -> Iterator[Trace]:
    """A bar for each layer, which begins where the one below ends."""
    begin_us = 0.0
    for place, bar in enumerate(chain):
        told = f"{bar.label}: {bar.us:.1f} us"
        if place:
            told = f"{bar.label} adds {bar.us:+.1f} us, {bar.low_us:+.1f} to {bar.high_us:+.1f} us"
        yield {
            "type": "bar",
            "orientation": "h",
            "showlegend": False,
            "y": [row],
            "base": [round(begin_us, 3)],
            "x": [round(bar.us, 3)],
            "width": [_BAR],
            "hovertext": [plain(told)],
            "hovertemplate": "%{hovertext}<extra></extra>",
            "marker": {"color": f"--series-{place % _COLOURS}"},
            "error_x": {
                "type": "data",
                "symmetric": False,
                "array": [round(bar.high_us - bar.us, 3)],
                "arrayminus": [round(bar.us - bar.low_us, 3)],
                "color": "--ink",
                "thickness": 1.2,
                "visible": place > 0,
            },
        }
        begin_us += bar.us


def _texts(row: int, chain: Sequence[LayerBar]) -> Iterator[Trace]:
    """The name of the chain above its bar, and what each of its parts is, in their order, below it."""
    yield _text(row - _BAR / 2, "top right", chain[-1].label)
    lowest, *above = chain
    parts = [f"{lowest.short} {lowest.us:.0f}", *(f"{bar.short} {bar.us:+.0f}" for bar in above)]
    yield _text(row + _BAR / 2, "bottom right", ", ".join(parts))


def _text(y: float, position: str, text: str) -> Trace:
    return {
        "type": "scatter",
        "mode": "text",
        "showlegend": False,
        "hoverinfo": "skip",
        "cliponaxis": False,
        "x": [0],
        "y": [y],
        "text": [plain(text)],
        "textposition": position,
    }
