"""A velocity law of one's own: a membrane under tension, tied to an elastic skeleton."""

import numpy as np

import esfem_core as ec


class Tethered:
    """v + beta H nu = kappa (p - x): every point x is tied by a spring to where it began, p.

    Weakly  M v + beta A x = kappa M (p - x). A law is asked for v where x = tau v - past, so that
    both forces can be implicit:

        ((1 + kappa tau) M + beta tau A) v = kappa M (p + past) + beta A past
    """

    def __init__(self, beta, kappa):
        self.beta, self.kappa = beta, kappa

    def velocity(self, at, new, tau, past, solve):
        K = at.matrix(mass=1 + self.kappa * tau, stiffness=self.beta * tau)
        spring = self.kappa * (at.M @ (at.space.nodes + past))
        return solve(K, spring + self.beta * (at.A @ past))


# On the unit sphere r' = -2 beta/r + kappa (1 - r), with a radius at which it comes to rest.
beta, kappa = 0.1, 1.0
rest = (1 + np.sqrt(1 - 8 * beta / kappa)) / 2

space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
problem = ec.Problem(species={}, law=Tethered(beta, kappa))
for state in ec.evolve(space, problem, order=2, step=1 / 10, end=20.0):
    if round(state.t * 10) in (0, 10, 50, 200):
        print(f"t = {state.t:g}: radius {np.linalg.norm(state.x, axis=1).mean():.6f}")
print(f"radius at rest: {rest:.6f}")
