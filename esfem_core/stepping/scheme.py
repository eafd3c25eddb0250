"""One step after the other: linearly implicit BDF for a velocity law, BDF for a given motion."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from esfem_core.elements import Assembly, DegenerateElementError, SurfaceSpace, with_data
from esfem_core.problems import Problem
from esfem_core.solvers import Solver
from esfem_core.stepping.bdf import combine, delta, extrapolate
from esfem_core.stepping.state import EvolutionError, State

__all__ = ["Perturbation", "march"]

Array = NDArray[np.float64]
Perturbation = Callable[[int], tuple[Array, Array, Array]]
"""What is added to (2.19), (2.20) and (2.21) in step n: nodal vectors r_u, r_v, r_x."""
GUESS = 5  # values that a first guess is extrapolated from, if there are so many


def march(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    step: float,
    states: Sequence[State],
    times: Iterable[tuple[int, float]],
    mass: str,
    *,
    make_solver: Callable[[], Solver],
    perturbation: Perturbation | None = None,
) -> Iterator[State]:
    """Step from p states through the given (number, time) pairs: [N] (2.19)-(2.21), [LMV] (3.1)."""
    d = delta(order)
    xs = deque((s.x for s in reversed(states)), maxlen=order)  # newest first
    us = deque((s.u for s in reversed(states)), maxlen=order)
    # First guesses for the linear solver are extrapolated from more values than the scheme has.
    last_us, last_vs = (deque(values, maxlen=max(order, GUESS)) for values in (us, ()))
    # There is no extrapolation at the first p levels: M(x^j) is taken.
    Mus = deque((space.mass_times(s.x, s.u) for s in reversed(states)), maxlen=order)
    u_solver, v_solver = make_solver(), make_solver()
    normals: Array | None = None

    for n, t in times:
        with _naming_the_step(n, t):
            u_tilde, x_past = extrapolate(us), combine(d[1:], xs)
            r_u, r_v, r_x = (None, None, None) if perturbation is None else perturbation(n)
            if problem.motion is not None:
                x_tilde = x = np.array(problem.motion(space.nodes, t), dtype=float)
                at = space.assemble(x_tilde, None if problem.f is None else u_tilde)
                v = (d[0] * x + x_past) / step
            else:
                x_tilde = extrapolate(xs)
                at = space.assemble(x_tilde, u_tilde)
                normals = _turn(at.normals, normals)
                guess = extrapolate(last_vs) if last_vs else np.zeros_like(x_tilde)
                if r_x is not None:
                    x_past = x_past - step * r_x
                past = x_past / d[0]
                v = _velocity(space, problem, v_solver, at, t, step / d[0], past, r_v, guess)
                x = (step * v - x_past) / d[0]
            M = space.mass_stiffness(x)[0] if mass == "updated" else at.M
            b = -combine(d[1:], Mus) / step
            if problem.f is not None:
                b += space.load_with(at.density, _source(problem.f, "f", at, t))
            if r_u is not None:
                b += r_u
            guess = extrapolate(last_us)
            u = _diffuse(problem, u_solver, d[0] / step, M, at.A, b, guess)
            if not (np.isfinite(u).all() and np.isfinite(x).all()):
                raise FloatingPointError("the solution is not finite")
            Mus.appendleft(space.mass_times(x, u) if mass == "reassembled" else M @ u)
        xs.appendleft(x)
        us.appendleft(u)
        last_us.appendleft(u)
        last_vs.appendleft(v)
        yield State(t, x, v, u)


@contextmanager
def _naming_the_step(n: int, t: float) -> Iterator[None]:
    """Say in which step and at which time numbers or elements went bad."""
    try:
        yield
    except DegenerateElementError as error:
        raise EvolutionError(str(error), n, t, error.element) from error
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        raise EvolutionError(str(error), n, t) from error


def _velocity(
    space: SurfaceSpace,
    problem: Problem,
    solver: Solver,
    at: Assembly,
    t: float,
    tau: float,
    past: Array,
    extra: Array | None,
    guess: Array,
) -> Array:
    """Solve K v + beta A x = g + extra for v, where x = tau v - past, on the surface `at`.

    These are [N] (2.20) and (2.21), with delta_0 divided out of tau and of the past values. One
    (N, N) matrix serves the three components. Solving for v and not for x avoids the division of
    x's rounding errors by tau.
    """
    b = problem.beta * (at.A @ past)
    if problem.g is not None:
        g = _source(problem.g, "g", at, t)
        b += space.load_with(at.density, g[..., None] * at.normals)
    if extra is not None:
        b += extra
    return solver.solve(_sum(1.0, at.M, problem.alpha + problem.beta * tau, at.A), b, guess)


def _diffuse(
    problem: Problem,
    solver: Solver,
    weight: float,
    M: csr_array,
    A: csr_array,
    b: Array,
    guess: Array,
) -> Array:
    """Solve [N] (2.19), (weight M + D A) u = b, together for components of equal D."""
    D = problem.diffusivity
    if b.ndim == 1 or np.ndim(D) == 0:
        return solver.solve(_sum(weight, M, float(D), A), b, guess)
    u = np.empty_like(b)
    for value in np.unique(D):
        same = np.broadcast_to(D, b.shape[1:]) == value
        u[:, same] = solver.solve(_sum(weight, M, value, A), b[:, same], guess[:, same])
    return u


def _sum(a: float, M: csr_array, b: float, A: csr_array) -> csr_array:
    """The matrix a M + b A of two matrices with the same sparsity pattern."""
    data = a * M.data
    data += b * A.data
    return with_data(M, data)


def _source(function: Callable[..., Array], name: str, at: Assembly, t: float) -> Array:
    """Values of f or g at the quadrature points of a surface."""
    values = np.asarray(function(at.u, at.grad_u, at.points, t), dtype=float)
    expected = at.u.shape if name == "f" else at.u.shape[:2]
    if values.shape != expected:
        raise ValueError(f"{name} must return an array of shape {expected}, got {values.shape}")
    finite = np.isfinite(values)
    if not finite.all():
        element, point = np.argwhere(~finite)[0, :2].tolist()
        where = np.array2string(at.points[element, point], precision=4)
        raise DegenerateElementError(
            f"{name} returned {values[element, point]} in element {element} at {where}", element
        )
    return values


def _turn(normals: Array, previous: Array | None) -> Array:
    """Return the normals, unless some element has turned over since the previous step."""
    if previous is not None:
        turned = np.einsum("tqi,tqi->tq", normals, previous) <= 0
        if turned.any():
            element = int(np.argmax(turned.any(axis=1)))
            raise DegenerateElementError(
                f"element {element} has turned over: its normal changed by more than a right "
                "angle within a step",
                element,
            )
    return normals
