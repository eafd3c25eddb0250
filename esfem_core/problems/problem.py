"""How a problem is stated."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Exact", "Problem"]

Array = NDArray[np.float64]
Source = Callable[[Array, Array, Array, float], Array]


class Exact(NamedTuple):
    """An exact solution.

    Attributes
    ----------
    x : callable
        X(p, t): positions at time t, (n, 3), of points p, (n, 3), of the initial surface.
    v : callable
        v(p, t): velocities, (n, 3), of the same points.
    u : callable
        u(x, t): values (n,) or (n, m) at points x, (n, 3), of the surface at time t.
    closest : callable, optional
        p(x, t): closest points, (n, 3), on the surface at time t, of points x, (n, 3), near it
        ([N] (2.2)). This and `origin` are needed for lifted errors only.
    origin : callable, optional
        The inverse of X: points p of the initial surface, (n, 3), with X(p, t) = x, for points x,
        (n, 3), of the surface at time t.
    """

    x: Callable[[Array, float], Array]
    v: Callable[[Array, float], Array]
    u: Callable[[Array, float], Array]
    closest: Callable[[Array, float], Array] | None = None
    origin: Callable[[Array, float], Array] | None = None


@dataclass(frozen=True)
class Problem:
    r"""Diffusion on a surface whose velocity is given by a law or prescribed.

    The equation on the surface is [N] (2.7), the regularised velocity law [N] (2.8)::

        u' + u div v - D lap u = f(u, grad u, x, t)
        v - alpha lap v + beta H nu = g(u, grad u, x, t) nu

    with u' the material derivative, H the sum of the principal curvatures (positive on a sphere)
    and nu the outward unit normal.

    Parameters
    ----------
    u0 : callable or array
        Initial values: u0(x) at points (n, 3), returning (n,) or (n, m); or the nodal values.
    f, g : callable, optional
        ``f(u, grad_u, x, t)`` with u of shape (T, Q) or (T, Q, m) and grad_u with one more index,
        at the quadrature points x, (T, Q, 3), of the extrapolated surface; returns the shape of u
        (f) or (T, Q) (g). None is zero.
    alpha, beta : float
        Regularisation alpha >= 0 and weight beta >= 0 of mean curvature.
    diffusivity : float or (m,) array
        D > 0, for all components or each.
    law : {"regularised"}
        The velocity law; not used with a prescribed motion.
    motion : callable, optional
        X(p, t), positions at time t of the points p of the initial surface: the surface's motion
        is then prescribed ([LMV]) and g, alpha, beta are not used.
    exact : Exact, optional
        Exact solution, for starting values and errors.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range or no function where one is needed.

    Examples
    --------
    Mean curvature flow, regularised, with a diffusing substance that pushes outwards:

    >>> problem = Problem(
    ...     u0=lambda x: 1 + x[:, 0], g=lambda u, grad_u, x, t: 2 * u, alpha=0.1, beta=1.0
    ... )
    """

    u0: Callable[[Array], Array] | Array
    f: Source | None = None
    g: Source | None = None
    alpha: float = 1.0
    beta: float = 1.0
    diffusivity: float | Array = 1.0
    law: str = "regularised"
    motion: Callable[[Array, float], Array] | None = None
    exact: Exact | None = None

    def __post_init__(self) -> None:
        for name in ("f", "g", "motion"):
            value = getattr(self, name)
            if value is not None and not callable(value):
                raise TypeError(f"{name} must be a function or None, got {type(value).__name__}")
        for name in ("alpha", "beta"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be finite and not negative, got {value!r}")
        if not (np.isfinite(self.diffusivity).all() and np.all(np.asarray(self.diffusivity) > 0)):
            raise ValueError(f"diffusivity must be positive, got {self.diffusivity!r}")
        if self.law != "regularised":
            raise ValueError(f'law must be "regularised", got {self.law!r}')
        if self.motion is not None and self.g is not None:
            raise ValueError("g belongs to a velocity law, but the motion is prescribed")

    def initial_values(self, x: Array) -> Array:
        """Nodal values of u0 at the nodes x, (N, 3)."""
        values = np.array(self.u0(x) if callable(self.u0) else self.u0, dtype=float)
        if values.ndim == 0 or len(values) != len(x):
            raise ValueError(f"u0 must give one row for each of {len(x)} nodes, got {values.shape}")
        if not np.isfinite(values).all():
            i = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise ValueError(f"u0 is not finite at node {i}, {x[i].tolist()}")
        return values
