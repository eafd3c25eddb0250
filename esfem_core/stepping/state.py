"""What a run yields, and how it stops."""

from dataclasses import dataclass

from esfem_core.checks import Array, finite_array, number
from esfem_core.elements import SurfaceSpace

__all__ = ["EvolutionError", "State", "check_state"]


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


def check_state(space: SurfaceSpace, state: State, name: str = "state") -> None:
    """Refuse what is no state of this space.

    Parameters
    ----------
    space : SurfaceSpace
    state : State
    name : str
        What the message calls it.

    Raises
    ------
    TypeError
        If an array does not hold real numbers.
    ValueError
        If an array has not one row for each node of the space, or something is not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    >>> check_state(space, State(0.0, space.nodes, None, space.nodes[:5, 0]))
    Traceback (most recent call last):
        ...
    ValueError: state.u must have shape (6,) or (6, m), got (5,)
    """
    n = len(space.nodes)
    number(f"{name}.t", state.t)
    finite_array(f"{name}.x", state.x, (n, 3))
    if state.v is not None:
        finite_array(f"{name}.v", state.v, (n, 3))
    u = finite_array(f"{name}.u", state.u, ("N", "..."))
    if u.ndim > 2 or len(u) != n:
        raise ValueError(f"{name}.u must have shape ({n},) or ({n}, m), got {u.shape}")


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
