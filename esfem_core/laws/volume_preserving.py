r"""A law with a uniform pressure that keeps the enclosed volume.

The volume changes by the integral of v · ν. So g becomes g - lambda(t), such that on the
extrapolated surface

.. math:: v = v_1 - \lambda v_2, \qquad \int_{\Gamma_h[\tilde x]} v \cdot \nu = 0,

where by linearity v_1 is the law's velocity and v_2 the answer to a unit force along the normal:

- regularised law: (K + beta tau A) v_2 = load(nu), the matrix of v_1, whose x = tau v - past is
  implicit; both are solved for by one factorisation;
- mean curvature flow: v_2 = nu. Here lambda = mean(g - beta H) also stands in the equation of H,
  where, as all of g, it is extrapolated. For g = 0 this is V = beta (mean(H) - H), the flow of
  G. Huisken (J. reine angew. Math. 382, 1987).

What is left is the drift between the two surfaces, of order p in time.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, shown
from esfem_core.elements import Surface
from esfem_core.laws.law import Law, Solve, check_no_slip
from esfem_core.laws.mean_curvature import MeanCurvature
from esfem_core.laws.regularised import Regularised
from esfem_core.laws.species import Species
from esfem_core.laws.values import Once

__all__ = ["VolumePreserving"]


@dataclass(frozen=True, eq=False)
class VolumePreserving(Law):
    """The law with g - lambda(t) in place of g, where lambda keeps the enclosed volume.

    lambda is one number: of a surface with several components the sum of the volumes stays, and
    large ones grow at the cost of small ones.

    Parameters
    ----------
    law : Regularised or MeanCurvature
        The `velocity` of a class derived from Regularised solves for v first, for its three
        components at once, as a run finds out: the pressure is solved for with them.

    Raises
    ------
    TypeError
        If the law is another.
    ValueError
        If it is of a class of one's own that has a slip.

    Examples
    --------
    >>> import esfem_core as ec
    >>> axes = (1.2, 1.0, 0.9)
    >>> tri = ec.sphere("octahedron", 3).apply_scale(axes)
    >>> space = ec.SurfaceSpace(tri, 2, ec.exact_surfaces.Ellipsoid(axes).closest)
    >>> law = ec.laws.VolumePreserving(ec.laws.MeanCurvature())
    >>> run = ec.evolve(space, ec.Problem(law=law), order=2, step=1 / 100, end=0.3)
    >>> first, *_, last = (ec.measure(state) for state in run)
    >>> last.area < first.area, bool(abs(last.volume / first.volume - 1) < 1e-4)
    (True, True)
    """

    law: Regularised | MeanCurvature

    def __post_init__(self) -> None:
        law: object = self.law
        if not isinstance(law, Regularised | MeanCurvature):
            advice = ""
            if isinstance(law, type) and issubclass(law, Regularised | MeanCurvature):
                advice = f": write {law.__name__}(...)"
            elif hasattr(law, "w"):
                advice = "; slip comes last, with_slip(VolumePreserving(law), w)"
            raise TypeError(
                f"law must be a Regularised or a MeanCurvature, got {shown(law)}{advice}"
            )
        check_no_slip(law, "it comes last, with_slip(VolumePreserving(law), w)")

    @property
    def species(self) -> Mapping[str, Species]:
        """Those of the law, with the pressure."""
        return self._pressed.species

    def initial(self, at: Surface) -> Mapping[str, Array]:
        """As the law's."""
        return self.law.initial(at)

    def equations(self, tau: float, past: Array) -> Mapping[str, Species]:
        """Those of the law, with the pressure."""
        return self._pressed.equations(tau, past)

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        """Return v_1 - lambda v_2, whose flux through the surface is zero."""
        flux = at.load(at.normal)
        if isinstance(self.law, MeanCurvature):
            first, second = self.law.velocity(at, new, tau, past, solve), new["normal"]
        else:
            answers: list[Array] = []

            def with_pressure(K: csr_array, b: Array) -> Array:
                if answers:  # what a class of one's own solves beside
                    return solve(K, b)
                if np.shape(b) != flux.shape:
                    raise ValueError(self._must_solve(f"b of shape {np.shape(b)}"))
                both = solve(K, np.hstack([b, flux]))
                answers.append(both[:, 3:])
                return both[:, :3]

            first = self.law.velocity(at, new, tau, past, with_pressure)
            if not answers:
                raise ValueError(self._must_solve("nothing"))
            (second,) = answers
        v: Array = first - np.vdot(flux, first) / np.vdot(flux, second) * second
        return v

    def _must_solve(self, found: str) -> str:
        return (
            "the first solve(K, b) in velocity of law must be that for v, for its three components "
            f"at once, b of shape (N, 3), since the pressure is solved for with it; {self.law!r} "
            f"solves for {found}"
        )

    @property
    def _pressed(self) -> Regularised | MeanCurvature:
        """The law that the functions obey: mean curvature flow with g - mean(g - beta H) for g."""
        law = self.law
        if isinstance(law, Regularised):
            return law

        def forcing(at: Surface) -> Array:
            g = law.forcing(at)
            if g is None:
                g = np.zeros(len(at.x))
            pressed: Array = g - at.mean(at.space.evaluate(g) - law.beta * at["H"])
            return pressed

        pressed = copy(law)  # of a class of one's own, with all that it overrides
        object.__setattr__(pressed, "forcing", Once(forcing))
        return pressed
