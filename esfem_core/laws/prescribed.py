"""A given motion, as in [LMV]."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from esfem_core.checks import Array, check_arguments, function, real_array
from esfem_core.elements import Surface
from esfem_core.laws.law import Law, Solve

__all__ = ["Prescribed"]

FLOW: dict[str, Any] = {"method": "DOP853", "rtol": 1e-12}  # of a velocity field
MOST_CALLS = 50_000  # of a velocity field in one step
ATOL = 1e-14  # relative to the size of the surface


class Prescribed(Law):
    """The nodes move as a given flow takes them: by positions or by a velocity field.

    Parameters
    ----------
    motion : callable
        X(p, t): positions at time t, (N, 3), of the points p, (N, 3), of the initial surface, with
        X(p, 0) = p. The points p are always ``space.nodes``; of new triangles, which
        :func:`esfem_core.remeshed` makes, there is another number of them: a motion that is known
        at nodes only, such as a table of their positions, holds until then.
    velocity : callable
        v(x, t): velocities, (N, 3), at points x, (N, 3). Its flow is integrated from step to step
        by a Runge-Kutta method of order eight to a relative accuracy of 1e-12.

    Raises
    ------
    ValueError, TypeError
        If not exactly one of them is given, or it is no function.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    >>> spin = ec.laws.Prescribed(velocity=lambda x, t: np.cross([0, 0, 1], x))
    >>> problem = ec.Problem(species={"u": ec.Species(lambda x: x[:, 0])}, law=spin)
    >>> *_, last = ec.evolve(space, problem, order=2, step=np.pi / 40, end=np.pi / 2)
    >>> bool(np.allclose(last.x[:, 1], space.nodes[:, 0], atol=1e-10))
    True
    """

    def __init__(
        self,
        motion: Callable[[Array, float], Array] | None = None,
        velocity: Callable[[Array, float], Array] | None = None,
    ) -> None:
        if (motion is None) == (velocity is None):
            both = "none" if motion is None else "both"
            raise ValueError(f"exactly one of motion and velocity must be given, got {both}")
        for name, value in (("motion", motion), ("velocity", velocity)):
            if value is not None:
                function(name, value, "or None")
        check_arguments("motion", motion, "p, t", "p has the nodes (N, 3) at the start, t the time")
        check_arguments("velocity", velocity, "x, t", "x has points (N, 3), t is the time")
        self.motion, self.field = motion, velocity

    def __repr__(self) -> str:
        kind = "motion" if self.motion is not None else "velocity"
        return f"Prescribed({kind}=...)"

    def position(self, nodes: Array, t: float, before: tuple[float, Array]) -> Array:
        """Positions at time t of the nodes.

        Parameters
        ----------
        nodes : (N, 3) float array
            On the initial surface.
        t : float
        before : (float, (N, 3) float array)
            A time and the positions then.

        Returns
        -------
        (N, 3) float array
        """
        if self.motion is not None:
            moved = real_array("motion(p, t)", self.motion(nodes.copy(), t), nodes.shape)
            _require_finite("motion(p, t)", moved, nodes, t)
            return np.array(moved)
        start, x = before
        if t == start:
            return np.array(x)
        assert self.field is not None
        rate = _Rate(self.field, (start, t), nodes.shape)
        size = float(np.abs(x).max())
        from scipy.integrate import solve_ivp  # a tenth of the package's start, for this alone

        with np.errstate(over="ignore", invalid="ignore"):  # in trials that the method rejects
            flow = solve_ivp(rate, (start, t), x.ravel(), atol=ATOL * size, **FLOW)
        if not flow.success:
            rate.refuse_bad()
            raise FloatingPointError(f"the velocity cannot be integrated: {flow.message}")
        end: Array = flow.y[:, -1].reshape(nodes.shape)
        return end

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        """The difference quotient of the given positions, so that x = tau v - past."""
        quotient: Array = (at.x + past) / tau
        return quotient


class _Rate:
    """A velocity field as the integrator calls it, which may find a trial bad and shorten a step.

    Bad values are kept until that fails; none but smooth fields let it come to an end.
    """

    def __init__(
        self,
        field: Callable[[Array, float], Array],
        times: tuple[float, float],
        shape: tuple[int, ...],
    ) -> None:
        self.field, self.times, self.shape = field, times, shape
        self.calls = 0
        self.bad: tuple[Array, Array, float] | None = None  # velocities, points and time

    def __call__(self, t: float, flat: Array) -> Array:
        start, end = self.times
        self.calls += 1
        if self.calls > MOST_CALLS:
            raise FloatingPointError(
                f"the velocity cannot be integrated from t = {start:.6g} to {end:.6g}: after "
                f"{MOST_CALLS} evaluations t = {t:.6g} is reached; it must be smooth"
            )
        x = flat.reshape(self.shape)
        if not np.isfinite(x).all():  # later in a trial that is bad
            return np.full_like(flat, np.nan)
        v = real_array("velocity(x, t)", self.field(x.copy(), t), self.shape)
        if not np.isfinite(v).all():
            self.bad = v, x.copy(), t
            if t == start:
                self.refuse_bad()
        return v.ravel()

    def refuse_bad(self) -> None:
        """Say where the last bad values are, if there are any."""
        if self.bad is not None:
            _require_finite("velocity(x, t)", *self.bad)


def _require_finite(name: str, values: Array, x: Array, t: float) -> None:
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        node = int(np.argmin(finite))
        where = np.array2string(x[node], precision=4)
        raise FloatingPointError(
            f"{name} is not finite at node {node} near {where} at t = {t:.6g}: it must be"
        )
