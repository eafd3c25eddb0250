r"""Nodes that slip along the surface, so that its triangles stay good.

Particles move with v, nodes with v + w, w tangential. With nodes and test functions that follow
v + w, what a species meets on its way is (C. M. Elliott, V. Styles, Milan J. Math. 80, 2012)

.. math::

    \frac{\mathrm d}{\mathrm dt} \int u \varphi + \dotsb
        &= \dotsb - \int u\, w \cdot \nabla\varphi \qquad \text{(conserved)} \\
    \int \dot u\, \varphi + \dotsb
        &= \dotsb + \int (w \cdot \nabla u)\, \varphi \qquad \text{(not conserved)}

which the scheme does for every species, and v is given w for the new positions: the amounts stay,
as phi = 1 shows.

The built-in slips relax the elastic energy of the map X from the initial surface to the present
one,

.. math:: E = \frac12 \int |\nabla X|^2 + \frac a2 \int \frac{J^2}{\bar J}

with the factor J of areas and its mean over the component, all integrals over the initial surface;
nodes move along the surface only. With a = 0 this is the energy of harmonic maps, as in the DeTurck
trick of C. M. Elliott, H. Fritz (IMA J. Numer. Anal. 37, 2017): from a sphere harmonic maps are
conformal, and keep the angles of the triangles, but not their sizes. J^2 keeps the sizes: the least
deformation is between the two. With nodal derivatives f = dE/dx, matrices on the initial surface, s
the squared radius of a sphere of the area of the component, and P the projections to the tangent
planes at the nodes,

.. math::

    w = -\varrho\, P B P f, \qquad B = s\, (M + s A)^{-1}, \qquad
    \frac{\mathrm dE}{\mathrm dt} = -\varrho\, (P f)^T B\, (P f) \le 0.

B makes w smooth and slow, so that it may be explicit: all wavelengths relax with rates of about
:math:`\varrho` to :math:`(1 + a) \varrho`, on components of every size. Nodes of several components
move as those of each would alone.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Literal

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, number, one_of, real_array, shown, whole_number
from esfem_core.elements import Smoothing, Surface, SurfaceSpace, nodal_average
from esfem_core.laws.law import Law, Solve, check_law, check_no_slip
from esfem_core.laws.prescribed import Prescribed
from esfem_core.laws.species import Species
from esfem_core.laws.values import Once, check_of_surface, finite_nodal
from esfem_core.solvers import factorise
from esfem_core.surfaces import components

__all__ = ["Elastic", "with_slip"]

SlipName = Literal["elastic", "harmonic"]
Slip = Callable[[Surface], Array]

# Largest rate times step near a sphere for p = 1, ..., 6, measured.
STABLE = (1.7, 1.1, 0.8, 0.6, 0.45, 0.37)


class Elastic:
    """The slip towards the least elastic deformation of the initial surface.

    On an ellipsoid that is stretched to three times its length the smallest angle stays 1.3 to 1.7
    times as large as without, on one that is strongly sheared two to four times; with ``area=0`` it
    is larger in most cases, but triangles crowd. One system is solved per step, and three more for
    normals unless the law has them, as vectors "normal" among its functions, with matrices that
    never change. Called with a :class:`esfem_core.Surface`, it returns the velocity w of its nodes,
    (N, 3).

    Parameters
    ----------
    rate : float
        How fast, per unit of time; larger than the rate at which the surface deforms. It is
        explicit: (1 + area) times rate times the step must stay below about 1.7, 1.1, 0.8, 0.6,
        0.45, 0.37 for p = 1, ..., 6 near a sphere at the start (a run warns of more), below a
        quarter of that near a torus of radii 1 and 0.4, and below a tenth where the deformation is
        strong. The size of the surface does not count, nor do other components.
    area : float
        The weight a of the areas; 0 makes the map harmonic.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range.

    Examples
    --------
    A sphere that is stretched to three times its length:

    >>> import esfem_core as ec
    >>> stretch = ec.laws.Prescribed(velocity=lambda x, t: x * [0, 0, np.log(3)])
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 2))
    >>> def angle(law):
    ...     *_, last = ec.evolve(space, ec.Problem(species={}, law=law), 2, 0.02, 1.0)
    ...     return ec.measure(last).min_angle
    >>> angle(ec.laws.with_slip(stretch, Elastic())) > 1.5 * angle(stretch)
    True
    """

    def __init__(self, rate: float = 10.0, area: float = 1.0) -> None:
        self.rate = number("rate", rate, above=0)
        self.area = number("area", area, least=0)
        self._reference = Once(_Reference)

    def __repr__(self) -> str:
        return f"Elastic(rate={self.rate:g}, area={self.area:g})"

    def largest_step(self, order: int) -> float:
        """Step from which on nodes run away on a sphere at rest; a run warns of longer ones.

        It is that of spheres of every size, and so of each component.

        Parameters
        ----------
        order : int
            The order p of the BDF; one above 6 gets the step of 6.

        Returns
        -------
        float

        Raises
        ------
        TypeError, ValueError
            If the order is no positive integer.

        Examples
        --------
        >>> print(f"{Elastic().largest_step(2):.3f}")
        0.055
        """
        order = whole_number("order", order, 1)
        return STABLE[min(order, len(STABLE)) - 1] / ((1 + self.area) * self.rate)

    def __call__(self, at: Surface) -> Array:
        """Velocity w of the nodes, (N, 3)."""
        first = self._reference(at.space)
        n = at.fields.get("normal")  # of a law, such as mean curvature flow
        if n is None or n.shape != at.x.shape:
            n = first.smoothed(nodal_average(at, at.normal))
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
        force = first.A @ at.x
        if self.area:
            J = at.density / first.density
            J *= self.area / first.mean(J)
            force += at.load(None, flux=J[..., None, None] * np.eye(3))
        return -self.rate * _tangential(first.relaxed(_tangential(force, n)), n)


class _Reference:
    """What is kept of the initial surface: not the space, which lives no longer for it."""

    def __init__(self, space: SurfaceSpace) -> None:
        at = Surface(space, space.nodes)
        self.M, self.A, self.density = at.M, at.A, at.density
        self._weights = at.density * space.rule.weights
        self._component = components(space.cells[:, :3])
        self._area = np.bincount(self._component, self._weights.sum(axis=1))
        # Of each node, the squared radius of a sphere as large as its component.
        self._s = np.empty(len(space.nodes))
        self._s[space.cells] = self._area[self._component, None] / (4 * np.pi)
        self._relax = factorise(_sum(at.M, self._s, at.A), space.fronts, np.float64)
        self._smoothing = Smoothing(at)

    def relaxed(self, b: Array) -> Array:
        """B b, for (N, 3)."""
        return self._s[:, None] * self._relax.solve(b)

    def mean(self, values: Array) -> Array:
        """Of values at the quadrature points, (T, Q), those over the component, (T, 1)."""
        sums = np.bincount(self._component, (self._weights * values).sum(axis=1))
        means: Array = sums / self._area
        return means[self._component, None]

    def smoothed(self, w: Array) -> Array:
        """Nodal values without what changes sign within each element."""
        return self._smoothing(self.M @ w)


NAMED: Mapping[str, Callable[[], Slip]] = {
    "elastic": Elastic,
    "harmonic": partial(Elastic, area=0.0),
}


def with_slip(law: Law, w: Slip | SlipName) -> Law:
    """The law, with nodes that move with v + w.

    Parameters
    ----------
    law : Law
        Not one with a slip, nor one that knows the positions of its nodes,
        ``Prescribed(motion=X)``. For ``Prescribed(velocity=v)`` the nodes are no longer exact, but
        of order p. Nodes that slip are not where an exact solution has them: a run starts with
        ``start="euler"``, and of the errors that of u is ``state.u - exact.u(state.x, t)``.
    w : callable or {"elastic", "harmonic"}
        ``w(at)`` on a :class:`esfem_core.Surface`: (N, 3), the tangential velocity of the nodes
        against the particles. A normal part would move the surface: normals at the nodes, to take
        it out, are those of :func:`esfem_core.elements.nodal_average`. It is explicit, with the
        largest steps that :class:`esfem_core.Species` states for transport. "elastic" keeps angles
        and sizes of the triangles near those at the start, "harmonic" angles only: ``Elastic()``
        and ``Elastic(area=0)``, see there.

    Returns
    -------
    Law

    Raises
    ------
    ValueError, TypeError
        If `w` is no function and no name of a slip, or the law cannot have one.

    Examples
    --------
    A mesh that turns on a sphere at rest:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> law = ec.laws.with_slip(
    ...     ec.laws.Prescribed(velocity=lambda x, t: 0 * x), lambda at: np.cross([0, 0, 1], at.x)
    ... )
    >>> problem = ec.Problem(species={"u": ec.Species(lambda x: x[:, 0])}, law=law)
    >>> *_, last = ec.evolve(space, problem, order=4, step=np.pi / 100, end=np.pi / 2)
    >>> bool(abs(last.x[:, 1] - space.nodes[:, 0]).max() < 1e-5)
    True
    >>> print(f"{abs(last.u - np.exp(-2 * last.t) * last.x[:, 0]).max():.0e}")
    9e-06

    The tangential part of a field, with normals at the nodes:

    >>> from esfem_core.elements import nodal_average
    >>> def w(at):
    ...     nu = nodal_average(at, at.normal)
    ...     nu /= np.linalg.norm(nu, axis=1, keepdims=True)
    ...     field = np.array([0, 0, 0.1]) + 0 * at.x
    ...     return field - (field * nu).sum(axis=1, keepdims=True) * nu
    >>> problem = ec.Problem(species={}, law=ec.laws.with_slip(law.law, w))
    >>> *_, last = ec.evolve(space, problem, order=2, step=0.05, end=1.0)
    >>> bool(abs(np.linalg.norm(last.x, axis=1) - 1).max() < 1e-3)
    True
    """
    check_law(law)
    check_no_slip(law, "add the two velocities to one")
    if hasattr(law, "position") and not (isinstance(law, Prescribed) and law.motion is None):
        raise ValueError(
            "law must let its nodes go, but it prescribes their positions: Prescribed(velocity=v) "
            "can slip"
        )
    if isinstance(w, type):
        raise TypeError(f"w must be a function of a Surface, got {shown(w)}: {w.__name__}() is one")
    check_of_surface("w", w)
    if callable(w):
        return _Slipping(law, w)
    if not isinstance(w, str):
        raise TypeError(f"w must be a function of a Surface or a name, got {shown(w)}")
    return _Slipping(law, NAMED[one_of("w", w, SlipName)]())


class _Slipping(Law):
    """See :func:`with_slip`."""

    def __init__(self, law: Law, w: Slip) -> None:
        self.law, self.w = law, w

    def __repr__(self) -> str:
        return f"with_slip({self.law!r}, {self.w!r})"

    @property
    def species(self) -> Mapping[str, Species]:
        return getattr(self.law, "species", {})

    def initial(self, at: Surface) -> Mapping[str, Array]:
        return self.law.initial(at) if hasattr(self.law, "initial") else {}

    def equations(self, tau: float, past: Array) -> Mapping[str, Species]:
        law = self.law
        return law.equations(tau, past) if hasattr(law, "equations") else self.species

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        law = self.law
        if isinstance(law, Prescribed):
            assert law.field is not None
            return finite_nodal("velocity(x, t)", law.field(at.x.copy(), at.t), at.x.shape)
        return law.velocity(at, new, tau, past, solve)

    def slip(self, at: Surface) -> Array:
        return real_array("w(at)", self.w(at), at.x.shape)  # the run looks at the values


def _sum(M: csr_array, s: Array, A: csr_array) -> csr_array:
    """M + diag(s) A, of matrices with the same sparsity pattern."""
    data = np.repeat(s, np.diff(A.indptr)) * A.data + M.data
    return csr_array((data, A.indices, A.indptr), shape=A.shape)


def _tangential(w: Array, n: Array) -> Array:
    t: Array = w - (w * n).sum(axis=1, keepdims=True) * n
    return t
