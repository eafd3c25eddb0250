"""What a person looks at: plots and moving surfaces; files for other programs."""

from esfem_core.output.animation import animate
from esfem_core.output.pictures import plot
from esfem_core.output.plotting import COLOURS, MARKERS, convergence_plot, load_matplotlib, style
from esfem_core.output.series import SeriesWriter, save_series
from esfem_core.output.spreadsheets import TableWriter, save_table

__all__ = [
    "COLOURS",
    "MARKERS",
    "SeriesWriter",
    "TableWriter",
    "animate",
    "convergence_plot",
    "load_matplotlib",
    "plot",
    "save_series",
    "save_table",
    "style",
]
