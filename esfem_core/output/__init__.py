"""What a person looks at: plots and moving surfaces."""

from esfem_core.output.animation import surface_animation
from esfem_core.output.plotting import COLOURS, MARKERS, convergence_plot, style

__all__ = [
    "COLOURS",
    "MARKERS",
    "convergence_plot",
    "style",
    "surface_animation",
]
