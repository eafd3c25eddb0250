"""What a run yields, and how it stops."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["EvolutionError", "State"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class State:
    """The discrete solution at one time.

    Attributes
    ----------
    t : float
    x : (N, 3) float array
        Node positions.
    v : (N, 3) float array or None
        Nodal velocities, from (2.21); None in the starting states.
    u : (N,) or (N, m) float array
        Nodal values of the solution.
    """

    t: float
    x: Array
    v: Array | None
    u: Array


class EvolutionError(RuntimeError):
    """A run cannot go on; the states it has yielded are good.

    Attributes
    ----------
    step : int
        Number n of the step that failed.
    t : float
        Its time.
    element : int or None
        Row of ``space.cells`` where the trouble was first seen, if it has a place.
    """

    def __init__(self, reason: str, step: int, t: float, element: int | None = None) -> None:
        super().__init__(f"step {step}, t = {t:.6g}: {reason}")
        self.step, self.t, self.element = step, t, element
