"""The usual numbers of a state, for tables, events and pictures over time."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from esfem_core.checks import Array, object_of
from esfem_core.stepping.state import State
from esfem_core.surfaces import angles_of

__all__ = ["Measures", "measure"]


class Measures(NamedTuple):
    """Numbers of a state; made by :func:`measure`.

    Attributes
    ----------
    t : float
    area, volume : float
        Of Γ_h[x], and what it encloses: NaN if it has a boundary.
    centre : (3,) float array
        Mean of the positions over the surface.
    h : float
        Longest side of the triangles between the corners of the elements.
    min_angle : float
        Smallest angle of these triangles, in degrees.
    amount : float or (m,) float array
        Integral of "u" over the surface; NaN if there is no "u".
    amounts : mapping of str to float or (m,) float array
        The same for every species and field.
    """

    t: float
    area: float
    volume: float
    centre: Array
    h: float
    min_angle: float
    amount: Array | float
    amounts: Mapping[str, Array | float]

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the read-only view of a mapping."""
        return _rebuild, (tuple(self)[:-1], dict(self.amounts))


def _rebuild(values: tuple[Any, ...], amounts: dict[str, Array | float]) -> Measures:
    return Measures._make((*values, MappingProxyType(amounts)))


def measure(state: State) -> Measures:
    """Measure a state.

    Parameters
    ----------
    state : State
        Of a run: one that knows its space.

    Returns
    -------
    Measures

    Raises
    ------
    TypeError, ValueError
        If it is no state, or knows no space.
    DegenerateElementError
        If an element has no area.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    >>> for state in ec.evolve(space, ec.problems.growing_sphere(), 2, 1 / 20, 0.5):
    ...     m = ec.measure(state)
    >>> print(f"t = {m.t:g}: area {m.area:.3f}, volume {m.volume:.3f}, u {m.amount:.3f}")
    t = 0.5: area 19.949, volume 8.378, u 50.261
    """
    object_of("state", state, State)
    at = state.surface()
    area = float(at.integral(1.0))
    centre = at.integral(at.points) / area
    closed = len(at.space.boundary_nodes) == 0
    third = at.integral(((at.points - centre) * at.normal).sum(axis=-1)) / 3
    amounts = {name: at.integral(at[name]) for name in state.fields}
    corners = state.x[at.space.cells[:, :3]]
    return Measures(
        t=state.t,
        area=area,
        volume=float(third) if closed else float("nan"),
        centre=centre,
        h=at.space.mesh_size(state.x),
        min_angle=float(np.degrees(angles_of(corners)).min()),
        amount=amounts.get("u", float("nan")),
        amounts=MappingProxyType(amounts),
    )
