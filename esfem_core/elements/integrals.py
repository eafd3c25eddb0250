r"""Element integrals over Γ_h[x], for all elements at once.

An element is the image of the reference triangle under

.. math:: \Phi(\xi) = \sum_a x_a \varphi_a(\xi), \qquad t_i = \partial_i \Phi,

with the metric E = t1·t1, F = t1·t2, G = t2·t2 of its tangents. The area density, and the product
of gradients of functions on the element, are

.. math::

    s = \sqrt{EG - F^2}, \qquad
    \nabla u \cdot \nabla w = \frac{G\, \partial_1 u\, \partial_1 w
    - F\, (\partial_1 u\, \partial_2 w + \partial_2 u\, \partial_1 w)
    + E\, \partial_2 u\, \partial_2 w}{s^2}.

This is [N] Section 7.2 with the third column of its 3 x 3 differential, the normal, eliminated.
Each integral is then (products of basis functions at the quadrature points) @ (metric factors), one
small matrix product for many elements. Arrays here have the elements last.
"""

from typing import NamedTuple

import numpy as np

from esfem_core.checks import Array, Bools, ReadOnly, read_only
from esfem_core.elements.lagrange import Basis
from esfem_core.elements.quadrature import TriangleRule
from esfem_core.surfaces import FLATTEST, NO_LENGTH

__all__ = [
    "CHUNK",
    "DegenerateElementError",
    "ElementError",
    "ElementTables",
    "Metric",
    "NotFiniteError",
]

CHUNK = 24576  # points at which the metric is computed at a time: few calls, arrays of 0.2 MB each
LEAST = FLATTEST / np.sqrt(3)  # smallest allowed s/(E + G - F), as for flat triangles


class ElementError(ArithmeticError):
    """Something went wrong in an element.

    Attributes
    ----------
    element : int
        Row of ``space.cells``.
    """

    def __init__(self, message: str, element: int) -> None:
        super().__init__(message)
        self.element = element

    def __reduce__(self) -> tuple[object, ...]:  # for pools: exceptions are pickled by their text
        return type(self), (str(self), self.element), vars(self)


class DegenerateElementError(ElementError):
    """An element has lost its area or turned over, or a nodal position is not finite."""


class NotFiniteError(ElementError):
    """A function returned NaN, infinity or a coefficient out of range in an element."""


class Metric(NamedTuple):
    """Nodes of some elements, and tangents and metric at their quadrature points.

    Flat elements have Q = 1 here, whatever the number of quadrature points.
    """

    nodes: Array  # (3, n, C)
    t1: Array  # (3, Q, C)
    t2: Array  # (3, Q, C)
    E: Array  # (Q, C)
    F: Array
    G: Array
    s: Array  # area density
    inverse: Array  # 1/s

    def normals(self) -> Array:
        """Unit normals, (3, Q, C)."""
        n = np.empty_like(self.t1)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(self.t1[j], self.t2[k], out=n[i])
            n[i] -= self.t1[k] * self.t2[j]
        n *= self.inverse
        return n


class ElementTables(ReadOnly):
    """Basis functions, their derivatives and their products, tabulated once.

    Parameters
    ----------
    basis : Basis
        At the points of `rule`.
    rule : TriangleRule
    """

    def __init__(self, basis: Basis, rule: TriangleRule) -> None:
        phi, (d1, d2) = basis.values, basis.derivatives
        w = rule.weights
        a, b = np.triu_indices(phi.shape[1])
        self.flat = phi.shape[1] == 3  # a flat element has one metric: one point stands for all
        self.weights = w
        self.values = phi
        self.tests = np.ascontiguousarray((phi * w[:, None]).T)  # (n, Q)
        self.pairs = np.stack([a, b])  # local index pairs a <= b of the symmetric half
        mass = (phi[:, a] * phi[:, b]).T * w  # (P, Q)
        cross = -(d1[:, a] * d2[:, b] + d2[:, a] * d1[:, b])
        stiffness = [c.T * w for c in (d1[:, a] * d1[:, b], cross, d2[:, a] * d2[:, b])]
        self.weighted_mass = np.ascontiguousarray(mass)  # (P, Q), for a weight at each point
        gradient_tests = [(d * w[:, None]).T for d in (d1, d2)]
        if self.flat:
            d1, d2, mass = d1[:1], d2[:1], mass.sum(axis=1, keepdims=True)
            gradient_tests = [c.sum(axis=1, keepdims=True) for c in gradient_tests]
            stiffness = [c.sum(axis=1, keepdims=True) for c in stiffness]
        self.gradients = np.vstack([d1, d2])  # (2Q, n)
        self.gradient_tests = np.hstack(gradient_tests)  # (n, 2Q)
        self.mass = np.ascontiguousarray(mass)
        self.stiffness = np.hstack(stiffness)  # (P, 3Q), for the factors G/s, F/s, E/s
        for name, array in vars(self).items():
            if isinstance(array, np.ndarray):
                # The last bits of products depend on the layout.
                setattr(self, name, array.copy(order="K"))
        read_only(vars(self))

    def metric(self, nodes: Array, first: int = 0) -> Metric:
        """Metric of elements with the given node positions.

        Parameters
        ----------
        nodes : (3, n, C) float array
        first : int
            Number of the first of these elements, for error messages.

        Raises
        ------
        DegenerateElementError
        """
        tangents = self.gradients @ nodes
        n_points = len(self.gradients) // 2
        t1, t2 = tangents[:, :n_points], tangents[:, n_points:]
        # A degenerate or overflowing element is recognised and reported below.
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            E, F, G = _dot(t1, t1), _dot(t1, t2), _dot(t2, t2)
            s2 = E * G - F * F
            smallest = (NO_LENGTH * np.abs(nodes[:, 0]).max()) ** 2
            # One comparison for all; where it fails, element by element.
            if not s2.min() > (1.5 * LEAST * (E.max() + G.max()) + smallest) ** 2:
                sound = s2 > (LEAST * (E + G - F) + smallest) ** 2
                what = "is not finite: the node positions x must be"
                _report_first(~np.isfinite(s2), what, nodes, first)
                _report_first(~sound, "is degenerate", nodes, first)
            s = np.sqrt(s2)
            return Metric(nodes, t1, t2, E, F, G, s, 1 / s)

    def mass_stiffness(self, g: Metric) -> tuple[Array, Array]:
        """Element mass and stiffness entries of the index pairs a <= b, each (P, C)."""
        factors = np.empty((3, *g.s.shape))
        for factor, entry in zip(factors, (g.G, g.F, g.E), strict=True):
            np.multiply(entry, g.inverse, out=factor)
        return self.mass @ g.s, self.stiffness @ factors.reshape(-1, g.s.shape[1])

    def weighted(self, g: Metric, mass: Array | float, tensor: Array | float) -> tuple[Array]:
        """Element entries of int mass w z + grad w . tensor grad z for the pairs a <= b.

        Parameters
        ----------
        g : Metric
        mass : float or (Q, C) float array
            At the quadrature points.
        tensor : float, or (Q, C) or (3, 3, Q, C) float array
            Symmetric.

        Returns
        -------
        tuple of one (P, C) array
        """
        entries = np.zeros((len(self.mass), g.s.shape[1]))
        if np.ndim(mass):
            entries += self.weighted_mass @ (mass * g.s)
        elif mass != 0:
            entries += mass * (self.mass @ g.s)
        if np.ndim(tensor) == 4:
            factors = self._tensor_factors(g, self._one_a_flat_element(np.asarray(tensor)))
        elif np.ndim(tensor) or tensor != 0:
            scale = self._one_a_flat_element(np.asarray(tensor)) if np.ndim(tensor) else tensor
            factors = scale * g.inverse * np.stack([g.G, g.F, g.E])
        else:
            return (entries,)
        entries += self.stiffness @ factors.reshape(-1, g.s.shape[1])
        return (entries,)

    def _one_a_flat_element(self, values: Array) -> Array:
        """Where gradients are constant, the mean over the points does as well as all of them."""
        if not self.flat:
            return values
        share = self.weights / self.weights.sum()
        mean: Array = np.tensordot(values, share, (-2, 0))[..., None, :]
        return mean

    @staticmethod
    def _tensor_factors(g: Metric, tensor: Array) -> Array:
        """Factors of the three products of derivatives, (3, Q, C).

        With the inverse metric, grad phi = c1 t1 + c2 t2, c = [[G, -F], [-F, E]]/s^2 (phi1, phi2):
        what stands between (phi1, phi2) and (psi1, psi2) is inverse metric, t_i . tensor t_j,
        inverse metric.
        """
        dual1 = (g.G * g.t1 - g.F * g.t2) * g.inverse**2
        dual2 = (g.E * g.t2 - g.F * g.t1) * g.inverse**2
        first, second = (np.einsum("ijqc,jqc->iqc", tensor, dual) for dual in (dual1, dual2))
        products = (_dot(dual1, first), -_dot(dual1, second), _dot(dual2, second))
        factors: Array = g.s * np.stack(products)
        return factors

    def flux_load(self, g: Metric, flux: Array) -> Array:
        """Element entries of int flux . grad phi_a, (m, n, C), for fluxes (m, 3, Q, C)."""
        if self.flat:
            flux = self._one_a_flat_element(flux)
        along1 = (flux * g.t1).sum(axis=1)
        along2 = (flux * g.t2).sum(axis=1)
        parts = [g.G * along1 - g.F * along2, g.E * along2 - g.F * along1]
        entries: Array = self.gradient_tests @ (
            np.concatenate(parts, axis=1) * np.tile(g.inverse, (2, 1))
        )
        return entries

    def gradient(self, g: Metric, u: Array) -> Array:
        """Surface gradient (m, 3, Q, C) of the nodal values u (m, n, C)."""
        u1, u2 = np.split(self.gradients @ u, 2, axis=1)
        square = g.inverse * g.inverse
        c1, c2 = (g.G * u1 - g.F * u2) * square, (g.E * u2 - g.F * u1) * square
        gradient: Array = c1[:, None] * g.t1
        gradient += c2[:, None] * g.t2
        return gradient


def _dot(a: Array, b: Array) -> Array:
    out: Array = a[0] * b[0]
    out += a[1] * b[1]
    out += a[2] * b[2]
    return out


def _report_first(bad: Bools, what: str, nodes: Array, first: int) -> None:
    """Raise for the first element with a bad quadrature point."""
    if bad.any():
        element = int(np.argmax(bad.any(axis=0)))
        center = np.array2string(nodes[:, :3, element].mean(axis=1), precision=4)
        raise DegenerateElementError(
            f"element {first + element} near {center} {what}", first + element
        )
