"""Manufactured solutions: right-hand sides of diffusion on a moving surface, derived symbolically.

The surface is the torus {d = 0}, moved by a flow that is neither rigid nor normal to it. All is
computed from a level set φ(x, t), a velocity v(x, t) and functions u(x, t) defined near the
surface, as expressions in :data:`X` and :data:`T`, with n = grad φ/|grad φ| and P = I - n n^T::

    grad_Γ u = P grad u        div_Γ w = P : Dw        H = div_Γ n
    div_Γ (P q) = div_Γ q - (n . q) H        u' = du/dt + v . grad u
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

import esfem_core as ec
from esfem_core.surfaces import displaced

X = sympy.Matrix(sympy.symbols("x1 x2 x3", real=True))
T = sympy.Symbol("t", real=True)
TORUS = ec.exact_surfaces.Torus(1.0, 0.4)


def numeric(expression):
    """f(x, t) of points (..., 3), with the shape of the expression behind the dots."""
    entries = sympy.Matrix([expression]) if not hasattr(expression, "shape") else expression
    function = sympy.lambdify((*X, T), list(entries), "numpy", cse=True)
    trailing = getattr(expression, "shape", ())
    if len(trailing) == 2 and trailing[1] == 1:
        trailing = trailing[:1]

    def evaluate(x, t):
        values = function(*np.moveaxis(x, -1, 0), t)
        columns = [np.broadcast_to(value, x.shape[:-1]) for value in values]
        return np.stack(columns, axis=-1).reshape(*x.shape[:-1], *trailing)

    return evaluate


def gradient(u):
    return sympy.Matrix([sympy.diff(u, s) for s in X])


@dataclass(frozen=True)
class Flow:
    """A motion with its inverse, as lists of three expressions in :data:`X` and :data:`T`."""

    forward: list
    backward: list

    @cached_property
    def velocity(self):
        """v(x, t)."""
        points = dict(zip(X, self.backward, strict=True))
        rate = [sympy.diff(f, T).xreplace(points) for f in self.forward]
        return sympy.Matrix(rate)

    @cached_property
    def motion(self):
        """X(p, t) as a function of arrays."""
        return numeric(sympy.Matrix(self.forward))

    @cached_property
    def velocity_field(self):
        """v(x, t) as a function of arrays."""
        return numeric(self.velocity)

    def inverse_is_one(self):
        points = dict(zip(X, self.backward, strict=True))
        composed = sympy.Matrix(self.forward).xreplace(points) - X
        return sympy.simplify(composed) == sympy.zeros(3, 1)


STRETCH = 1 + sympy.sin(2 * T) / 4
BEND = sympy.sin(T) / 2
FLOW = Flow(  # x1 is stretched, x3 bent by the product of the others
    [STRETCH * X[0], X[1], X[2] + BEND * X[0] * X[1]],
    [X[0] / STRETCH, X[1], X[2] - BEND * X[0] / STRETCH * X[1]],
)


@dataclass(frozen=True)
class MovingSurface:
    """The torus under a flow, and the differential operators on it."""

    flow: Flow = FLOW

    @cached_property
    def level_set(self):
        p1, p2, p3 = self.flow.backward
        return (sympy.sqrt(p1**2 + p2**2) - 1) ** 2 + p3**2 - sympy.Rational(4, 25)

    @cached_property
    def normal(self):
        d = gradient(self.level_set)
        return d / sympy.sqrt(d.dot(d))

    @cached_property
    def projection(self):
        return sympy.eye(3) - self.normal * self.normal.T

    @cached_property
    def mean_curvature(self):
        return self.divergence(self.normal)

    def divergence(self, w):
        """div_Γ w of a field that need not be tangential."""
        Dw = w.jacobian(X)
        return sum(a * b for a, b in zip(self.projection, Dw, strict=True))

    def tangential_divergence(self, q):
        """div_Γ (P q)."""
        return self.divergence(q) - self.normal.dot(q) * self.mean_curvature

    def surface_gradient(self, u):
        return gradient(u) - self.normal * self.normal.dot(gradient(u))

    def material_derivative(self, u):
        return sympy.diff(u, T) + self.flow.velocity.dot(gradient(u))

    def source(self, u, D=1, rate=0, flux=None, conserved=True):
        """The values f with u' + u div v - div(D grad u) + rate u = f - div(P flux)."""
        f = self.material_derivative(u) + rate * u
        f -= self.tangential_divergence(D * self.surface_gradient(u))
        if conserved:
            f += u * self.divergence(self.flow.velocity)
        if flux is not None:
            f += self.tangential_divergence(flux)
        return f


def torus_space(degree, n, m, share=0.15):
    """A torus of displaced vertices, with all nodes on the exact one."""
    tri = displaced(ec.torus(1.0, 0.4, n, m), share, TORUS.closest)
    return ec.SurfaceSpace(tri, degree, TORUS.closest)
