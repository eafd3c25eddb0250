r"""A velocity that is accelerated: the dynamic law.

[N], introduction, after B. Kovács, B. Li, C. Lubich, C. A. Power Guerra (Numer. Math. 137, 2017),
with v in place of the printed u, and a term of surface tension that is ours (beta = 0 there):

.. math::

    \partial^\bullet v + v\, \nabla_\Gamma \cdot v - \alpha \Delta_\Gamma v + \beta H \nu = g \nu.

In space it is

.. math::

    \frac{\mathrm d}{\mathrm dt} \bigl(M(x) v\bigr) + \alpha A(x) v + \beta A(x) x
    = \Bigl( \int_{\Gamma_h[x]} g \nu \varphi_j \Bigr)_j,

so that v is a conserved species. An explicit :math:`\beta A x` would be stable for small steps
only, :math:`\tau\beta/\alpha` < 2, 4/3, 20/21, 32/45, 0.419 for p = 1, ..., 5: up to p = 4 waves
of the shortest lengths grow first, for p = 5 those whose eigenvalue :math:`\lambda` of the
Laplacian has :math:`\tau\alpha\lambda` near 2.7. So :math:`x^n = \bar\tau v^n - \text{past}` is put
in, with :math:`\bar\tau = \tau/\delta_0` and the past of (2.21):

.. math::

    \Bigl( \frac{\delta_0}{\tau} M + (\alpha + \beta\bar\tau) A \Bigr) v^n
    = \beta A\, \text{past} + \dotsb

On a sphere of radius r, with :math:`v = r' \nu`,

.. math:: r'' + 2\,\frac{r'^2}{r} + 2\alpha\,\frac{r'}{r^2} + \frac{2\beta}{r} = g.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, ReadOnly, finite_array, frozen, function, number
from esfem_core.elements import Surface
from esfem_core.laws.law import Law, Solve
from esfem_core.laws.species import Species
from esfem_core.laws.values import check_of_points, check_of_surface, force_at

__all__ = ["Dynamic"]


@dataclass(frozen=True, eq=False)
class Dynamic(ReadOnly, Law):
    r"""The dynamic law, whose velocity is accelerated.

    .. math::

        \partial^\bullet v + v\, \nabla_\Gamma \cdot v - \alpha \Delta_\Gamma v + \beta H \nu
        = g \nu

    It carries the function "velocity", (N, 3), whose integral changes by the forces only.

    Parameters
    ----------
    v0 : callable, array or float
        Initial velocity: of points (N, 3), returning (N, 3); or the nodal values; or one vector
        (3,); or a number for all components.
    alpha, beta : float
        Viscosity alpha >= 0, positive in [N], a squared length per time, and surface tension
        beta >= 0, a squared length per squared time. Without viscosity the law is a wave equation,
        outside the theory.
    g : callable, optional
        ``g(at)`` on a :class:`esfem_core.Surface`: (T, Q), the force along the normal, or
        (T, Q, 3), a force with a direction of its own. None is zero.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range or no function where one is needed. What functions return is
        looked at in a run, see :func:`esfem_core.evolve`.

    Examples
    --------
    A sphere that was given a push outwards is pulled back by its tension:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> law = ec.laws.Dynamic(v0=lambda x: x, alpha=0.1, beta=0.5)
    >>> run = ec.evolve(space, ec.Problem(law=law), order=3, step=1 / 50, end=1.2)
    >>> radii = [np.linalg.norm(state.x, axis=1).mean() for state in run]
    >>> print(f"{radii[0]:.2f} {max(radii):.2f} {radii[-1]:.2f}")
    1.00 1.30 1.23
    """

    v0: Callable[[Array], ArrayLike] | ArrayLike = 0.0
    alpha: float = 1.0
    beta: float = 0.0
    g: Callable[[Surface], Array] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "alpha", number("alpha", self.alpha, least=0))
        object.__setattr__(self, "beta", number("beta", self.beta, least=0))
        check_of_points("v0", self.v0)
        if not callable(self.v0):
            v0 = finite_array("v0", self.v0, ("...",))
            if v0.size != 1 and (v0.ndim > 2 or v0.shape[-1:] != (3,)):
                raise ValueError(
                    f"v0 must be a number, a vector (3,) or nodal values (N, 3), got {v0.shape}"
                )
            object.__setattr__(self, "v0", frozen(v0))
        if self.g is not None:
            function("g", self.g, "of a Surface or None")
            check_of_surface("g", self.g)

    @property
    def species(self) -> Mapping[str, Species]:
        """The velocity, without the tension."""
        source = None if self.g is None else self._force
        return {"velocity": Species(self._initial, source, diffusivity=self.alpha)}

    def equations(self, tau: float, past: Array) -> Mapping[str, Species]:
        """The velocity with the tension of x = tau v - past, beta A (tau v - past)."""
        if self.beta == 0:
            return self.species

        def source(at: Surface) -> tuple[Array | None, Array]:
            force = None if self.g is None else self._force(at)
            return force, self.beta * at.space.gradient(at.x, past)

        stiffness = self.alpha + self.beta * tau
        return {"velocity": Species(self._initial, source, diffusivity=stiffness)}

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        """The velocity that was solved for."""
        return new["velocity"]

    def _force(self, at: Surface) -> Array:
        assert self.g is not None
        return force_at(self.g, at)

    def _initial(self, x: Array) -> Array:
        values = self.v0(x.copy()) if callable(self.v0) else self.v0
        values = finite_array("v0", values, ("...",))
        if values.ndim < 2 and not callable(self.v0):
            values = np.broadcast_to(values, x.shape)
        return finite_array("v0", values, x.shape)
