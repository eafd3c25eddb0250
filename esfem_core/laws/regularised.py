"""The regularised velocity law of [N]."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from esfem_core.checks import Array, function, number
from esfem_core.elements import Surface
from esfem_core.laws.law import Law, Solve
from esfem_core.laws.values import check_of_surface, force_at
from esfem_core.solvers import times

__all__ = ["Regularised"]


@dataclass(frozen=True)
class Regularised(Law):
    r"""v - alpha lap v + beta H nu = g nu, [N] (2.8).

    .. math:: v - \alpha \Delta_\Gamma v + \beta H \nu = g \nu

    H is the sum of the principal curvatures, positive on a sphere, and nu the outward unit normal.
    In space, with :math:`K = M + \alpha A`, it is :math:`K v + \beta A x = g`, [N] (2.20).

    Parameters
    ----------
    alpha, beta : float
        Regularisation alpha >= 0, a squared length, and weight beta >= 0 of mean curvature, a
        squared length per time, in the units of the nodes. alpha = 0 with beta > 0 is Dziuk's
        scheme for mean curvature flow, outside the theorem of [N]: with elements of degree 2 or
        more it loses two orders except on spheres, and p = 4 and 5 are unstable.
    g : callable, optional
        ``g(at)`` on a :class:`esfem_core.Surface`: (T, Q), the speed along the normal, or
        (T, Q, 3), a force with a direction of its own. None is zero.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range or g no function. What g returns is looked at in a run, see
        :func:`esfem_core.evolve`.

    Examples
    --------
    The sphere of radius 2 beta/g rests:

    >>> import esfem_core as ec
    >>> law = ec.laws.Regularised(alpha=0.5, beta=1.0, g=lambda at: 2.0)
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    >>> *_, last = ec.evolve(space, ec.Problem(species={}, law=law), 2, 0.1, 1.0)
    >>> round(float(ec.measure(last).area / (4 * 3.14159265)), 3)
    1.0
    """

    alpha: float = 1.0
    beta: float = 1.0
    g: Callable[[Surface], Array] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "alpha", number("alpha", self.alpha, least=0))
        object.__setattr__(self, "beta", number("beta", self.beta, least=0))
        if self.g is not None:
            function("g", self.g, "of a Surface or None")
            check_of_surface("g", self.g)

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        """Solve K v + beta A x = g, [N] (2.20), for v, where x = tau v - past.

        One (N, N) matrix serves the three components. Solving for v and not for x avoids the
        division of x's rounding errors by tau.
        """
        b = self._right_hand_side(at, past)  # before K, while there is more memory for it
        return solve(at.matrix(1.0, self.alpha + self.beta * tau), b)

    def _right_hand_side(self, at: Surface, past: Array) -> Array:
        """Load vector g + beta A past, (N, 3)."""
        b = times(at.A, past)
        b *= self.beta
        force = self.load(at)
        if force is not None:
            b += force
        return b

    def load(self, at: Surface) -> Array | None:
        """Load vector of g nu, (N, 3); None if g is zero."""
        return None if self.g is None else at.load(force_at(self.g, at))

    def residual(self, at: Surface, x: Array, v: Array) -> Array:
        """K v + beta A x - g with matrices and g on the surface `at`, (N, 3): zero in (2.20)."""
        rest = at.M @ v + at.A @ (self.alpha * v + self.beta * x)
        force = self.load(at)
        result: Array = rest if force is None else rest - force
        return result
