r"""Problems that are made for a solution: the right-hand sides that a given motion and u need.

The surface is {d(x, t) = 0}, its points move by x = X(p, t), and u(x, t) lives on it. sympy
differentiates d, X and u; all else is linear algebra at the points where f or the force is asked
for

.. math::

    \nu &= \nabla d/|\nabla d|, \qquad P = I - \nu\nu^T, \qquad
        H = \nabla_\Gamma \cdot \nu = P : D^2 d/|\nabla d|, \\
    \nabla_\Gamma w &= P\, \nabla w, \qquad \nabla_\Gamma \cdot w = P : \nabla w, \qquad
        \partial^\bullet u = \partial_t u + v \cdot \nabla u, \\
    \Delta_\Gamma w &= P : D^2 w - H\, \nu \cdot \nabla w.

These hold for any extension of w off the surface. That of the velocity is v(x, t) = V(p, t) with
V = dX/dt and X(p, t) = x: with F = DX, of inverse G, the chain rule gives

.. math::

    \partial_j v_i = V_{i,k} G_{kj}, \qquad
    \partial_j \partial_l v_i = (V_{i,km} - \partial_a v_i\, X_{a,km})\, G_{kj} G_{ml}.

sympy is needed (``pip install "esfem-core[symbolic]"``); it is imported when a problem is made.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from esfem_core.checks import Array, flag, number, package, shown
from esfem_core.elements import Surface
from esfem_core.laws import Prescribed, Regularised, Species
from esfem_core.problems.problem import Exact, Problem
from esfem_core.problems.smoothness import find_break, walks
from esfem_core.surfaces import project_to_level_set

__all__ = ["manufactured"]

POSITIONS = ("x1", "x2", "x3")
ORIGINS = ("p1", "p2", "p3")
TOLERANCE = 1e-10  # of the checks, relative to the size of the surface
TIMES = np.array([0.0, 0.1, 0.381966, 0.618034, 1.0])  # of the checks, relative to the last one
SAMPLES = 400  # points that look for the surface
ITERATIONS = 30  # of Newton's method: too few where it converges linearly, as to a double zero
PATHS = (1, 2, 4, 8, 16, 32)  # numbers of steps in time on which it is tried


class Jet(NamedTuple):
    """Values, first and second derivatives in space and the one in time of m functions.

    Of shapes (..., m), (..., m, 3), (..., m, 3, 3) and (..., m).
    """

    value: Array
    gradient: Array
    hessian: Array
    rate: Array


class Geometry(NamedTuple):
    """Normal ν, projection P and mean curvature H: (..., 3), (..., 3, 3), (...)."""

    normal: Array
    P: Array
    H: Array

    @classmethod
    def of(cls, d: Jet) -> "Geometry":
        """Of the level sets of a function."""
        size = np.linalg.norm(d.gradient[..., 0, :], axis=-1)
        normal = d.gradient[..., 0, :] / size[..., None]
        P = np.eye(3) - normal[..., :, None] * normal[..., None, :]
        return cls(normal, P, np.sum(P * d.hessian[..., 0, :, :], axis=(-2, -1)) / size)

    def divergence(self, gradient: Array) -> Array:
        """div_Γ, (...), of a field of gradient [..., i, j] = D_j w_i."""
        divergence: Array = np.sum(self.P * gradient, axis=(-2, -1))
        return divergence

    def laplacian(self, gradient: Array, hessian: Array) -> Array:
        """lap_Γ, (..., m), of functions of these derivatives."""
        trace = np.sum(self.P[..., None, :, :] * hessian, axis=(-2, -1))
        laplacian: Array = trace - self.H[..., None] * (gradient @ self.normal[..., None])[..., 0]
        return laplacian


class Velocity(NamedTuple):
    """Value, gradient and second derivatives of v(x, t): (..., 3), (..., 3, 3), (..., 3, 3, 3)."""

    value: Array
    gradient: Array
    hessian: Array


class Expressions:
    """Functions of three coordinates and t, as sympy's expressions; arrays of them and of jets."""

    def __init__(self, name: str, given: Any, names: Sequence[str], count: int) -> None:
        sympy, self.name = _sympy(), name
        texts = [given] if count == 1 else _three(name, given)
        self.symbols = sympy.symbols((*names, "t"), real=True)
        known = dict(zip((*names, "t"), self.symbols, strict=True))
        self.expressions = [_expression(name, text, known) for text in texts]
        *space, t = self.symbols
        gradient = [sympy.diff(w, s) for w in self.expressions for s in space]
        self.values = self._numeric(self.expressions, (count,))
        self.gradients = self._numeric(gradient, (count, 3))
        self.rates = self._numeric([sympy.diff(w, t) for w in self.expressions], (count,))
        hessian = [sympy.diff(w, s) for w in gradient for s in space]
        self.hessians = self._numeric(hessian, (count, 3, 3))
        try:
            self.jet(np.ones((2, 3)), 1.0)  # functions of math take an array of one in old NumPy
        except (NameError, TypeError, ValueError) as error:
            raise ValueError(
                f"{name} must be smooth and of functions that NumPy has, but it or one of its "
                f"derivatives is not: {error}"
            ) from None

    def jet(self, x: Array, t: float) -> Jet:
        """Of points (..., 3)."""
        return Jet(self.values(x, t), self.gradients(x, t), self.hessians(x, t), self.rates(x, t))

    def in_time(self) -> "Expressions":
        """The derivatives in time."""
        sympy = _sympy()
        *names, t = self.symbols
        rates = [sympy.diff(w, t) for w in self.expressions]
        return Expressions("motion", rates, [str(s) for s in names], len(rates))

    def _numeric(self, expressions: list[Any], shape: tuple[int, ...]) -> Callable[..., Array]:
        """A function of points (..., 3) and a time with values (..., *shape)."""
        try:
            function = _sympy().lambdify(self.symbols, expressions, "numpy", cse=True)
        except (NotImplementedError, ValueError) as error:  # an integral, the derivative of Mod
            raise ValueError(f"{self.name} has no form that NumPy can evaluate: {error}") from None

        def evaluate(x: Array, t: float) -> Array:
            with np.errstate(all="ignore"):  # what is not finite is refused where it is used
                values = function(*np.moveaxis(x, -1, 0), np.float64(t))  # 1/0 raises in Python
            columns = [np.broadcast_to(value, x.shape[:-1]) for value in values]
            return np.stack(columns, axis=-1).reshape(*x.shape[:-1], *shape)

        return evaluate


class Motion:
    """X(p, t) with its inverse and its velocity."""

    def __init__(self, given: Any) -> None:
        self.position = Expressions("motion", given, ORIGINS, 3)
        self.velocity = self.position.in_time()

    def origin(self, x: Array, t: float) -> Array:
        """The points p, (..., 3), with X(p, t) = x.

        By Newton's method, if need be along a path of times from X(p, 0) = p.
        """
        for steps in PATHS:
            p = x
            for s in np.linspace(0, t, steps + 1)[1:]:
                p = self._newton(p, x, float(s))
            if np.isfinite(p).all():
                return p
        raise ValueError(f"motion has no inverse that Newton's method finds at t = {t:g}")

    def _newton(self, p: Array, x: Array, t: float) -> Array:
        """Solve X(p, t) = x; NaN where that fails."""
        scale = float(np.abs(x).max(initial=0)) or 1.0
        for _ in range(ITERATIONS):
            F = self.position.gradients(p, t)
            step = _solve(F, self.position.values(p, t) - x)
            p = p - step
            far = np.abs(step).max(initial=0)
            if not far > 1e-9 * scale:  # quadratic: the error is now that of rounding
                return p
        return np.full_like(p, np.nan)

    def at(self, x: Array, t: float) -> Velocity:
        """The velocity as a function of x, by the chain rule."""
        p = self.origin(x, t)
        X, V = self.position.jet(p, t), self.velocity.jet(p, t)
        G = np.linalg.inv(X.gradient)
        gradient = V.gradient @ G
        in_p = V.hessian - np.einsum("...ia,...akm->...ikm", gradient, X.hessian)
        hessian = np.einsum("...ikm,...kj,...ml->...ijl", in_p, G, G)
        return Velocity(V.value, gradient, hessian)


def manufactured(
    d: Any,
    motion: Any,
    u: Any = None,
    alpha: float | None = None,
    beta: float | None = None,
    diffusivity: float = 1.0,
    *,
    prescribed: bool = False,
    until: float = 1.0,
) -> Problem:
    r"""A problem whose solution is a given motion of a given surface, with a given u on it.

    f and the force are such that, on {d(x, t) = 0} with points x = X(p, t), v = dX/dt,

    .. math::

        \partial^\bullet u + u\, \nabla_\Gamma \cdot v - D \Delta_\Gamma u &= f, \\
        v - \alpha \Delta_\Gamma v + \beta H \nu &= \text{force}.

    The force is a vector, since the left-hand side is not normal to the surface in general, even
    if v is.

    Expressions are those of sympy, with symbols x1, x2, x3, p1, p2, p3 and t, or their text, such
    as ``"x1**2 + x2**2 + x3**2 - 1"``; a text is run by Python, so take none from strangers.

    Parameters
    ----------
    d : expression
        Level set, a function of x1, x2, x3, t: zero on the surface at time t, smooth nearby.
    motion : three expressions
        X(p, t), functions of p1, p2, p3, t that are smooth and can be inverted near the surface,
        with X(p, 0) = p.
    u : expression, optional
        A function of x1, x2, x3, t. Without it nothing diffuses.
    alpha, beta : float, optional
        Of the law, :class:`esfem_core.laws.Regularised`; 1 if not given.
    diffusivity : float
        D >= 0.
    prescribed : bool
        Whether the motion is prescribed, instead of following from the law.
    until : float
        The motion is checked at times from 0 to this one.

    Returns
    -------
    Problem
        With an exact solution, including closest points and origins.

    Raises
    ------
    ImportError
        Without sympy (``pip install "esfem-core[symbolic]"``).
    ValueError, TypeError
        If an expression has other symbols, cannot be read, or is not smooth, as those with absolute
        values; if d has no zeros or a vanishing gradient there, X(p, 0) is not p, or X(p, t) leaves
        the surface; or if a number is out of range. Jumps and kinks are noticed on random walks on
        the surface, at t = 0 and two later times: not those in time, nor where they are below a
        hundredth of what the function, or its derivatives, range over.

    Examples
    --------
    A torus that is sheared while it grows:

    >>> import esfem_core as ec
    >>> d = "(sqrt(x1**2 + x2**2) - 1 - t/4)**2 + (x3 - t*x1/2)**2 - (2/5)**2"
    >>> grown = "(1 + t/4/sqrt(p1**2 + p2**2))"
    >>> motion = [f"p1*{grown}", f"p2*{grown}", f"p3 + t/2*p1*{grown}"]
    >>> problem = ec.problems.manufactured(d, motion, "x1*x3 + exp(-t)", alpha=0.1, beta=0.1)
    >>> torus = ec.exact_surfaces.Torus(1.0, 0.4)
    >>> space = ec.SurfaceSpace(ec.torus(1.0, 0.4, 20, 8), 2, torus.closest)
    >>> *_, last = ec.evolve(space, problem, order=3, step=1 / 40, end=0.5)
    >>> print(f"{ec.errors.compare(space, problem, last).x_l2:.0e}")
    4e-04
    """
    level = Expressions("d", d, POSITIONS, 1)
    path = Motion(motion)
    D = number("diffusivity", diffusivity, least=0)
    until, prescribed = number("until", until, above=0), flag("prescribed", prescribed)
    p = _found(level)
    _check(level, path, p, until)
    exact_u = None if u is None else Expressions("u", u, POSITIONS, 1)
    _check_smooth(level, path, exact_u, p, until)

    def u_of(x: Array, t: float) -> Array:
        assert exact_u is not None
        return exact_u.values(x, t)[..., 0]

    def source(at: Surface) -> Array:
        assert exact_u is not None
        x, t = at.points, at.t
        on, w, v = Geometry.of(level.jet(x, t)), exact_u.jet(x, t), path.at(x, t)
        material = w.rate[..., 0] + np.sum(v.value * w.gradient[..., 0, :], axis=-1)
        stretched = w.value[..., 0] * on.divergence(v.gradient)
        f: Array = material + stretched - D * on.laplacian(w.gradient, w.hessian)[..., 0]
        return f

    def closest(x: Array, t: float) -> Array:
        return project_to_level_set(
            lambda y: level.values(y, t)[..., 0], lambda y: level.gradients(y, t)[..., 0, :]
        )(x)

    if prescribed:
        for name, value in (("alpha", alpha), ("beta", beta)):
            if value is not None:
                raise ValueError(f"{name} must not be given where the motion is prescribed")
        law: Any = Prescribed(path.position.values)
    else:
        law = _forced(level, path, alpha, beta)
    species = {"u": Species(lambda x: u_of(x, 0.0), source, diffusivity=D)}
    return Problem(
        species={} if u is None else species,
        law=law,
        exact=Exact(
            path.position.values,
            path.velocity.values,
            None if u is None else u_of,
            closest,
            path.origin,
        ),
    )


def _forced(
    level: Expressions, path: Motion, alpha: float | None, beta: float | None
) -> Regularised:
    """The law v - alpha lap v + beta H nu = force."""
    alpha = number("alpha", 1.0 if alpha is None else alpha, least=0)
    beta = number("beta", 1.0 if beta is None else beta, least=0)

    def force(at: Surface) -> Array:
        on, v = Geometry.of(level.jet(at.points, at.t)), path.at(at.points, at.t)
        bending = alpha * on.laplacian(v.gradient, v.hessian)
        result: Array = v.value - bending + beta * on.H[..., None] * on.normal
        return result

    return Regularised(alpha, beta, force)


def _check(level: Expressions, path: Motion, p: Array, until: float) -> None:
    """Points stay where they are at t = 0, and later on the surface, on the same side of others."""
    scale = float(np.abs(p).max())
    moved = np.abs(path.position.values(p, 0.0) - p).max(axis=-1)
    worst = int(np.argmax(np.where(np.isfinite(moved), moved, np.inf)))
    if not moved[worst] <= TOLERANCE * scale:
        raise ValueError(
            f"motion must have X(p, 0) = p, but takes {_point(p[worst])} of the surface to "
            f"{_point(path.position.values(p[worst], 0.0))} at t = 0"
        )
    at_first = np.linalg.det(path.position.gradients(p, 0.0))
    for t in until * TIMES[1:]:
        x = path.position.values(p, t)
        gradient = np.linalg.norm(level.gradients(x, t)[..., 0, :], axis=-1)
        with np.errstate(all="ignore"):
            away = np.abs(level.values(x, t)[..., 0]) / gradient
        worst = int(np.argmax(np.where(np.isfinite(away), away, np.inf)))
        if not away[worst] <= TOLERANCE * max(scale, float(np.abs(x[worst]).max())):
            raise ValueError(
                f"motion must stay on the surface, d(X(p, t), t) = 0, but at t = {t:.4g} it takes "
                f"{_point(p[worst])} to {_point(x[worst])}, a distance of {away[worst]:.2g} away "
                "(until=... is the last time that is checked)"
            )
        with np.errstate(all="ignore"):
            volume = np.linalg.det(path.position.gradients(p, t)) / at_first
        worst = int(np.argmin(np.where(np.isfinite(volume), volume, np.inf)))
        if volume[worst] <= 0:
            raise ValueError(
                f"motion must not pass through itself, but at t = {t:.4g} near {_point(x[worst])} "
                f"the determinant of its derivatives is {volume[worst]:.3g} times that at t = 0 "
                "(until=... is the last time that is checked)"
            )


def _check_smooth(
    level: Expressions, path: Motion, exact_u: Expressions | None, p: Array, until: float
) -> None:
    """No jumps and no kinks on the surface, of which the right-hand sides would know nothing."""
    origins = walks(p, partial(_newton_step, level, 0.0))
    for t in until * TIMES[::2]:
        x = path.position.values(p, t)
        on = walks(x, partial(_newton_step, level, t))
        _check_one_smooth(level, on, t)
        _check_one_smooth(path.position, origins, t)
        if exact_u is not None:
            _check_one_smooth(exact_u, on, t)


def _check_one_smooth(w: Expressions, on: Array, t: float) -> None:
    found = find_break(lambda x: w.jet(x, t)[:3], on)
    if found is not None:
        raise ValueError(
            f"{w.name} must be smooth, but at t = {t:.4g} it jumps or has a kink near "
            f"{_point(found)}"
        )


def _found(level: Expressions) -> Array:
    """Points, (n, 3), of {d(x, 0) = 0}, by Newton's method from random ones of all sizes."""
    random = np.random.default_rng(0)
    size = 10.0 ** random.uniform(-2, 2, (SAMPLES, 1))
    x, shift = size * random.normal(size=(SAMPLES, 3)), np.full(SAMPLES, np.inf)
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            step = _newton_step(level, 0.0, x)
            x, shift = x + step, np.abs(step).max(axis=1)
        found: Array = x[(shift <= 1e-12 * np.abs(x).max(axis=1)) & np.isfinite(x).all(axis=1)]
    if len(found) < SAMPLES // 20:
        raise ValueError(
            f"d must have zeros near the origin, but Newton's method found {len(found)} from "
            f"{SAMPLES} points between 0.01 and 100: is its gradient zero on the surface?"
        )
    return found


def _newton_step(level: Expressions, t: float, x: Array) -> Array:
    """From points x, (n, 3), towards {d(x, t) = 0}."""
    with np.errstate(all="ignore"):
        g = level.gradients(x, t)[:, 0]
        step: Array = -(level.values(x, t) / np.sum(g * g, axis=1, keepdims=True)) * g
    return step


def _point(x: Array) -> str:
    return str(np.array2string(x, precision=4, suppress_small=True))


def _solve(F: Array, b: Array) -> Array:
    """F^{-1} b of (..., 3, 3) and (..., 3); NaN where there is none."""
    try:
        return np.asarray(np.linalg.solve(F, b[..., None])[..., 0], dtype=float)
    except np.linalg.LinAlgError:
        return np.full_like(b, np.nan)


def _three(name: str, given: Any) -> list[Any]:
    ordered = hasattr(given, "__getitem__") and not isinstance(given, str | Mapping)
    if not ordered or len(given) != 3:
        raise ValueError(f"{name} must be three expressions, got {shown(given)}")
    return list(given)


def _expression(name: str, given: Any, known: dict[str, Any]) -> Any:
    """An expression in the known symbols, whatever was assumed of those of the same name."""
    sympy = _sympy()
    try:
        expression = sympy.sympify(given, locals=known)
    except (sympy.SympifyError, TypeError, SyntaxError, AttributeError) as error:
        raise ValueError(f"{name} must be an expression, got {shown(given)}: {error}") from None
    allowed = ", ".join(known)
    if not isinstance(expression, sympy.Expr) or getattr(expression, "is_Matrix", False):
        raise TypeError(f"{name} must be an expression in {allowed}, got {shown(given)}")
    symbols = sorted(expression.free_symbols, key=str)
    strange = [str(s) for s in symbols if str(s) not in known]
    strange += [str(f) for f in expression.atoms(sympy.core.function.AppliedUndef)]
    strange += [str(c) for c in expression.atoms(*_no_reals(sympy))]
    if strange:
        raise ValueError(f"{name} must be an expression in {allowed}, but has {', '.join(strange)}")
    return expression.xreplace({s: known[str(s)] for s in symbols})


def _no_reals(sympy: Any) -> list[Any]:
    """Kinds of constants that no real function has."""
    of = sympy.core.numbers
    return [of.NaN, of.ImaginaryUnit, of.Infinity, of.NegativeInfinity, of.ComplexInfinity]


def _sympy() -> Any:
    return package("manufactured needs sympy", "sympy", "symbolic")
