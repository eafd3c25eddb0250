"""How a surface moves: the fields that a law carries, and its formula for the velocity."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, mapping, object_of, real_array, shown
from esfem_core.elements import Surface
from esfem_core.laws.fixed import Fixed
from esfem_core.laws.species import Species

__all__ = ["Law", "Solve", "check_law", "check_no_slip", "positions_of", "same_species"]

Solve = Callable[[csr_array, Array], Array]
"""What solves a linear system: a function of a matrix (N, N) and right-hand sides (N, ...)."""


class Law(Protocol):
    """What a time scheme asks of a velocity law.

    A class of one's own needs `velocity`; the rest may be left out, or be inherited from this
    class.

    Attributes
    ----------
    species : mapping of str to Species
        Functions that the law needs beside those of the problem, solved for before the velocity.
    """

    @property
    def species(self) -> Mapping[str, Species]:
        """Functions that the law needs."""
        return {}

    def initial(self, at: Surface) -> Mapping[str, Array]:
        """Initial values of those functions of the law whose species have None, on the mesh."""
        return {}

    def equations(self, tau: float, past: Array) -> Mapping[str, Species]:
        """What the law's functions solve in this step: `species`.

        Others, if they are implicit in the position x^n = tau v^n - past, as for `velocity`. Only
        their source, rate and diffusivity may differ from those of `species`.
        """
        return self.species

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        r"""Return v^n of [N] (2.20), implicit in the position x^n = tau v^n - past of (2.21).

        .. math::

            x^n = \frac{\tau}{\delta_0} v^n - \frac1{\delta_0} \sum_{j=1}^p \delta_j x^{n-j}

        Parameters
        ----------
        at : Surface
            The extrapolated surface Γ_h[x~^n], with the extrapolated functions of the problem and
            of the law.
        new : mapping of str to (N, ...) float array
            The law's own functions at t_n.
        tau : float
            The step over delta_0, the factor of v^n.
        past : (N, 3) float array
            What is subtracted.
        solve : callable
            ``solve(K, b)`` solves K w = b with the run's solver, for K symmetric positive definite,
            such as ``at.matrix(mass=1.0, stiffness=2.0)``, and b of shape (N,) or (N, m).

        Returns
        -------
        (N, 3) float array
        """
        ...

    def slip(self, at: Surface) -> Array | None:
        """Tangential velocity of the nodes against the particles of the surface, (N, 3), or None.

        The nodes then move with v + w. What they would carry along is corrected for in every
        species, and `past` contains -tau w. A class of one's own that has both `position` and
        `slip` states where nodes are and how they slip: particles then move with dX/dt - w.
        """
        return None

    # A law that knows the positions has a further method,
    #     position(nodes, t, before) -> (N, 3),
    # and (2.19) and (2.20) are then assembled on them and not on an extrapolated surface: see
    # `Prescribed`.


def check_law(law: Any) -> None:
    """Refuse what is no law.

    Examples
    --------
    >>> check_law("rest")
    Traceback (most recent call last):
        ...
    TypeError: law must have a method velocity, as Regularised(), MeanCurvature() and the others in
    esfem_core.laws have (Law says what it does); got 'rest'
    """
    if callable(getattr(law, "velocity", None)):
        if isinstance(law, type):
            raise TypeError(f"law must be an object, got {shown(law)}: write {law.__name__}(...)")
        return
    fixed = law is Fixed or isinstance(law, Fixed)
    advice = "; Prescribed(lambda x, t: x) is rest, Fixed is for values of a Species"
    raise TypeError(
        "law must have a method velocity, as Regularised(), MeanCurvature() and the others in "
        f"esfem_core.laws have (Law says what it does); got {shown(law)}{advice if fixed else ''}"
    )


def check_no_slip(law: Any, advice: str) -> None:
    """Refuse a law with a slip of its own where that would be lost, or wrong, in silence.

    Examples
    --------
    >>> class Turning(Law):
    ...     def slip(self, at):
    ...         return np.cross([0, 0, 1], at.x)
    >>> check_no_slip(Turning(), "add the two velocities to one")
    Traceback (most recent call last):
        ...
    ValueError: law must have no slip, but has one: add the two velocities to one
    """
    slip = getattr(law, "slip", None)
    if slip is not None and getattr(slip, "__func__", None) is not Law.slip:
        raise ValueError(f"law must have no slip, but has one: {advice}")


def positions_of(law: Any, nodes: Array, t: float, before: tuple[float, Array]) -> Array:
    """What ``law.position`` returns, as an array that nobody else has.

    Raises
    ------
    ValueError, TypeError
        If the shape is not that of the nodes, or they are no real numbers.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> flat = SimpleNamespace(position=lambda nodes, t, before: nodes[:, :2])
    >>> positions_of(flat, np.eye(3), 0.0, (0.0, np.eye(3)))
    Traceback (most recent call last):
        ...
    ValueError: what law.position returns must have shape (3, 3), got (3, 2)
    """
    returned = law.position(nodes, t, before)
    return np.array(real_array("what law.position returns", returned, nodes.shape))


def same_species(own: Mapping[str, Species], returned: object) -> Mapping[str, Species]:
    """What ``law.equations`` returns, refused if these are not the law's functions.

    What is kept from step to step depends on `conserved`, and `fixed` is that of the species.

    Examples
    --------
    >>> same_species({"H": Species(1.0)}, {})
    Traceback (most recent call last):
        ...
    ValueError: what law.equations returns must have the species of law, 'H', but has none
    """
    if returned is own:
        return own
    found = mapping("what law.equations returns", returned, "Species")
    if found.keys() != own.keys():
        wanted, names = (", ".join(map(repr, s)) or "none" for s in (own, found))
        raise ValueError(
            f"what law.equations returns must have the species of law, {wanted}, but has {names}"
        )
    for name, mine in own.items():
        one = object_of(f"law.equations: {name!r}", found[name], Species)
        if one.conserved != mine.conserved:
            raise ValueError(
                f"law.equations: {name!r} must have conserved={mine.conserved} as in the species "
                f"of law, got {one.conserved}"
            )
        if one.fixed is not None and not one.fixed.may_be(mine.fixed):
            raise ValueError(
                f"law.equations: {name!r} must have the fixed of the species of law or none, got "
                "another"
            )
    return found
