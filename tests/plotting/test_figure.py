"""A notebook shows the package's figures as they come, without `%matplotlib inline`."""

from __future__ import annotations

from matplotlib.figure import Figure

import replant as rp

PNG = b"\x89PNG\r\n\x1a\n"


def shown(figure: object) -> dict[str, object]:
    """Return a notebook's output for the object at the end of a cell."""
    from IPython.core.interactiveshell import InteractiveShell

    shell = InteractiveShell()
    data, _ = shell.display_formatter.format(figure)
    return data


def test_a_notebook_shows_what_figures_and_plot_return() -> None:
    model = rp.fit(rp.examples.motor(), poles=1).model
    for axes in (model.step().plot(), rp.figures.draw_spectrum(None, rp.examples.motor().output, 0.02)):
        figure = next(iter(getattr(axes, "flat", [axes]))).figure
        assert shown(figure)["image/png"].startswith(PNG)


def test_a_figure_of_matplotlib_alone_is_not_shown() -> None:
    """Otherwise `blank_figure` would be unnecessary."""
    assert "image/png" not in shown(Figure())
