"""A check that could not fail is none: a deliberate fault turns the verdict of a row.

Each line puts one fault, of a kind that a program or a formula may well have, into the source of a
chapter, runs what the claim needs of it, and sees the claim fail. Rows whose checks take long are
represented by quick ones of the same kind.
"""

import matplotlib
import pytest
import slices
import yaml

from esfem_core.companion.claims import STRICT, accepted

ROWS = yaml.safe_load((slices.BOOK / "claims.yml").read_text("utf8"))
CHECKS = [row["id"] for row in ROWS if row["kind"] == "check"]

# chapter, claim, what stands there, the fault
FAULTS = [
    # the closest point is on the wrong side of the core circle
    (
        "01",
        "N-2.2-projection",
        "    normal, _, core = split(x)\n    return core + r * normal",
        "    normal, _, core = split(x)\n    return core - r * normal",
    ),
    # a velocity that does not follow the stretching
    ("01", "N-2.3-velocity", "sigma * X1, sigma / 2])", "sigma * X1, sigma])"),
    # the convective term with the wrong sign
    (
        "01",
        "N-2.3-material",
        "w.diff(T) + velocity.dot(gradient(w))",
        "w.diff(T) - velocity.dot(gradient(w))",
    ),
    # 11/r² is not the eigenvalue of x1 x2 x3
    ("01", "N-7.3-f", "5 * dr / rt + da / at + 12 / rt**2", "5 * dr / rt + da / at + 11 / rt**2"),
    # the function that is carried along is taken for the fixed one
    (
        "01",
        "N-2.7-test",
        'defects = [defect("carried"), defect("fixed")]',
        'defects = [defect("carried"), defect("carried")]',
    ),
    # midpoints are not projected
    (
        "02",
        "N-7.1-midpoints",
        "midpoint_error, np.abs(x[node] - flat / np.linalg.norm(flat)).max())",
        "midpoint_error, np.abs(x[node] - flat).max())",
    ),
    # the third column of the element map is not the normal
    (
        "02",
        "N-7.1-gradient",
        "D = np.concatenate([B, normal[..., None]], axis=-1)",
        "D = np.concatenate([B, (normal + B[..., 0])[..., None]], axis=-1)",
    ),
    # the third column is tilted: as regular, with the same determinant
    (
        "02",
        "N-7.1-normal",
        "D = np.concatenate([B, normal[..., None]], axis=-1)",
        "D = np.concatenate([B, (normal + B[..., 0])[..., None]], axis=-1)",
    ),
    # the nodes of the next degree
    (
        "02",
        "N-2.8-nodal-basis",
        "nodes = node_indices(k)[:, 1:] / k",
        "nodes = node_indices(k)[:, 1:] / 7",
    ),
    # the Leibniz formula without the rate of u
    (
        "03",
        "N-2.10-mass-term",
        "product_rule = np.abs(left - (M @ du + stretching))",
        "product_rule = np.abs(left - stretching)",
    ),
    # the curvature term counted twice
    (
        "03",
        "N-2.10-kronecker",
        "beta * inner_gradients(x, x, psi)",
        "2 * beta * inner_gradients(x, x, psi)",
    ),
    # both orderings mixed up, in the corrected form as well
    (
        "03",
        "N-2.10-ordering",
        "error(kron(K, eye_array(3)), node_by_node",
        "error(kron(K, eye_array(3)), component_by_component",
    ),
    # the mean of the principal curvatures in the place of their sum
    (
        "03",
        "N-2.10-velocity-law",
        "return (D.sum() - (D * nu**2).sum(axis=-1, keepdims=True)) / length * nu",
        "return (D.sum() - (D * nu**2).sum(axis=-1, keepdims=True)) / (2 * length) * nu",
    ),
    # BDF coefficients in the wrong direction
    (
        "04",
        "N-2.21-order",
        "@ ec.bdf.delta(p) / tau - dy(t)",
        "@ ec.bdf.delta(p)[::-1] / tau - dy(t)",
    ),
    # extrapolation by a method of one order more
    (
        "04",
        "N-2.18-extrapolation",
        "order_of(extrapolated(p, ec.bdf.gamma(p))) for p",
        "order_of(extrapolated(p + 1, ec.bdf.gamma(p + 1))) for p",
    ),
    # the weights of the differences are not 1/j
    (
        "04",
        "N-2.22-delta",
        "(one_minus**j / j for j",
        "(one_minus**j / (j + 1) for j",
    ),
    ("04", "N-2.22-gamma", "(1 - one_minus**p).coef[1:]", "(1 - one_minus**p).coef[:-1]"),
    # the seventh method among the stable ones
    (
        "04",
        "LMV-3.1-stable",
        "roots = np.roots(ec.bdf.delta(p))  #",
        "roots = np.roots(ec.bdf.delta(p + 1))  #",
    ),
    # velocities at the wrong times
    (
        "04",
        "N-2.11.1-velocity",
        "- combine(problem.exact.v, t)",
        "- combine(problem.exact.v, t + tau)",
    ),
    # a right-hand side with half the Lipschitz constant
    ("04", "N-T2.1-lipschitz", "L * (at.u - np.sin(at.t))", "L / 2 * (at.u - np.sin(at.t))"),
    # starting values of an order too low
    ("04", "N-T2.1-start", "wrong * (n == 0)", "50 * np.sqrt(wrong) * (n == 0)"),
    # the square of the identity with the wrong sign
    (
        "05",
        "LMV-L3.1-identity",
        "telescoped + gamma @ products @ gamma",
        "telescoped - gamma @ products @ gamma",
    ),
    # the printed exponent, in the corrected form
    ("05", "LMV-3.2-delta", "np.polyval(d[::-1], z)", "np.polyval(d, z)"),
    # the real parts of another polynomial, for p = 1 and 2 as well
    (
        "05",
        "N-L4.2-eta",
        "    real = real_part(p, 0.0, angles)",
        "    real = real_part(p + 2, 0.0, angles)",
    ),
    # singular values squared in the place of eigenvalues
    (
        "05",
        "N-4.29-equivalence",
        "lam, vectors = np.linalg.eigh(G)",
        "lam, vectors = np.linalg.eigh(G @ G)",
    ),
    # the transpose of ∇e in its place
    (
        "06",
        "N-4.17-gradient",
        "(bracket, grad_e, np.swapaxes(bracket, 2, 3))",
        "(np.swapaxes(bracket, 2, 3), grad_e, bracket)",
    ),
    # no term with ν
    (
        "06",
        "N-L3.4-commutator",
        "bracket = grad_e - nu[..., :, None] * nu_e[..., None, :]",
        "bracket = grad_e - 0 * nu[..., :, None] * nu_e[..., None, :]",
    ),
    # fields larger than the lemma allows
    (
        "06",
        "N-L3.1-normals",
        "def scaled(space, y, e, size=0.5):",
        "def scaled(space, y, e, size=0.6):",
    ),
    # a stiffness matrix too many
    (
        "06",
        "N-3.3-equivalence",
        "relative_norm(M1 + A1 - M0 - A0, M0 + A0)",
        "relative_norm(M1 + 2 * A1 - M0 - A0, M0 + A0)",
    ),
    # lifts to another torus, of a tube that is thicker by one percent
    (
        "07",
        "N-L5.1-equivalence",
        "onto = forms.lift(space, space.nodes, Torus())\n        attained",
        "onto = forms.lift(space, space.nodes, Torus(1.0, 0.404))\n        attained",
    ),
    # a power of h too many
    (
        "07",
        "LMV-5.11-interpolation",
        "(h**2 * (curved + h * plain))",
        "(h**3 * (curved + h * plain))",
    ),
    # the gradient in the place of the second derivatives, in the corrected form as well
    (
        "07",
        "N-6.2-maximum",
        "f in (eta_gradient, eta_second))",
        "f in (eta_gradient, eta_gradient))",
    ),
    # a stretching motion beside the one whose velocity is used
    (
        "07",
        "N-6.11-commute",
        "v[..., 0] * x[..., 2] + x[..., 0] * v[..., 2]",
        "v[..., 0] * x[..., 2] - x[..., 0] * v[..., 2]",
    ),
    # the discrete surface with a degree too low for the order claimed
    (
        "07",
        "LMV-5.6-material",
        "moving_torus(t).closest(space.quadrature_points(moved))",
        "moving_torus(2 * t).closest(space.quadrature_points(moved))",
    ),
    # the divergence alone, in the corrected form as well
    (
        "07",
        "LMV-5.13-divergence",
        "np.abs(divergence), np.linalg.norm(grad_v, axis=(-2, -1))",
        "np.abs(divergence), np.abs(divergence)",
    ),
    # the defect of another step
    (
        "08",
        "N-4.4-error",
        "relative(quotient - v_error + d.x, quotient)",
        "relative(quotient - v_error - d.x, quotient)",
    ),
    # one of the five differences is forgotten
    (
        "08",
        "N-4.2-error",
        "rest = -(At_star - A) @ e_u[n] - (At - At_star) @ run[n].u - d.u",
        "rest = -(At_star - A) @ e_u[n] - d.u",
    ),
    # the later step is still one of the first
    (
        "08",
        "N-L6.1-first",
        "for n in (q, 2 * q - 1, 2 * q)]",
        "for n in (q, 2 * q - 1, 2 * q - 1)]",
    ),
    # a dual norm without the gradient
    ("08", "LMV-T5.1-dualnorm", "K, H1 = M + alpha * A, M + A", "K, H1 = M + alpha * A, M"),
    # a kernel with a power of τ too many
    ("08", "LMV-T5.1-peano", "tau**p_ * integral(bdf", "tau ** (p_ + 1) * integral(bdf"),
    # an amplitude twice as large as the bound allows for
    (
        "08",
        "N-6.3-dx",
        "np.array(steps) ** p_ / (p_ + 1) * largest",
        "np.array(steps) ** p_ / (p_ + 2) * largest",
    ),
    # the weight of the paper, in the corrected form
    ("09", "LMV-L4.1-weight", "left_over((1 - etas) / 8)", "left_over((1 - etas) / 4)"),
    # half of the first energy, in the corrected form
    ("09", "LMV-L4.1-energy", "for first in (0, energies[0])", "for first in (0, energies[0] / 2)"),
    # a method that is not zero-stable
    (
        "09",
        "N-4.33-mu",
        "mu = {p: one_over(ec.bdf.delta(p)) for p in range(1, 8)}",
        "mu = {p: one_over(ec.bdf.delta(p + 1)) for p in range(1, 8)}",
    ),
    # errors with a power of h too few
    (
        "09",
        "N-R2-restrictions",
        "size = space.mesh_size(space.nodes) ** DEGREE +",
        "size = space.mesh_size(space.nodes) ** (DEGREE - 1) +",
    ),
    # the zero at one is not divided out
    (
        "09",
        "N-4.24-decay",
        "chi = {p: one_over(np.cumsum(ec.bdf.delta(p))[:-1])",
        "chi = {p: one_over(ec.bdf.delta(p))",
    ),
    # a term of second order is left out
    ("09", "N-4.28-weight", "1 - eta - ct * (1 + eta / 2 + ct)", "1 - eta - ct * (1 + eta / 2)"),
    # the factor of Parseval's formula
    (
        "09",
        "N-4.26-parseval",
        "integral = fourier.mean() * 2 * np.pi",
        "integral = fourier.mean() * np.pi",
    ),
    # the gradient is forgotten in the norm that is put right
    (
        "09",
        "N-4.21-rest",
        "return top / np.sqrt([square(M, e), square(M + A, e)])",
        "return top / np.sqrt([square(M, e), square(M, e)])",
    ),
    # a power of τ too many
    (
        "09",
        "N-4.21-gamma",
        "return ec.bdf.delta(p)[0] * top * n**p",
        "return ec.bdf.delta(p)[0] * top * n ** (p + 1)",
    ),
    # starting errors that are divided by τ
    (
        "09",
        "N-4.34-chain",
        "e_x = tau * lfilter([1], ec.bdf.delta(p), -d_hat)",
        "e_x = lfilter([1], ec.bdf.delta(p), -d_hat)",
    ),
    # the normal turns the other way
    (
        "09",
        "N-4.14-coupling",
        'turn = -np.einsum("tqij,tqj->tqi", E, nu)',
        'turn = np.einsum("tqij,tqj->tqi", E, nu)',
    ),
    # the semi-discrete equation without the velocity's divergence
    (
        "10",
        "LMV-5.2-residual",
        "return M @ du + space.load(x, space.evaluate(u) * divergence)",
        "return M @ du + 0 * space.load(x, space.evaluate(u) * divergence)",
    ),
    # a source that does not fit the solution
    (
        "10",
        "LMV-L5.1-bound",
        "A @ u - source(space, problem, x, t), x",
        "A @ u - 1.01 * source(space, problem, x, t), x",
    ),
    # a motion whose second derivative is as rough as the mesh
    (
        "10",
        "LMV-T5.1-derivatives",
        "space.mass(driven.exact.x(space.nodes, t + half * s))",
        "space.mass(driven.exact.x(space.nodes, t) + 0.02 * s**2 * np.sin(1e6 * space.nodes))",
    ),
    # a solution that is smooth enough
    ("10", "LMV-T5.2-bound", "def rough(x, sigma=1 / 5)", "def rough(x, sigma=6 / 5)"),
    # (6.2) without the division
    ("11", "LMV-6.2-sphere", "g * x2 / s, g * x3 / s])", "g * x2, g * x3])"),
    # errors at the nodes in the place of lifted ones
    (
        "12",
        "N-7.4-space-l2",
        'found = max((last[mesh, "lifted"][q] for mesh in meshes)',
        'found = max((last[mesh, "at the nodes"][q] for mesh in meshes)',
    ),
    # a bound with a power of τ too many
    ("12", "N-T2.1-restrictions", "/ (h**2 + tau**2)", "/ (h**2 + tau**3)"),
    # the difference on a mesh against the one with another step
    (
        "13",
        "N-7.4-figure5",
        'stored[r, n]["difference"][1] / stored[finest[n], n]["difference"][1]',
        'stored[r, n]["difference"][1] / stored[finest[n], n]["difference"][0]',
    ),
    # a difference that does not depend on the step
    (
        "13",
        "N-7.4-figure5",
        '[stored[key]["difference"][i] for key in by_step]',
        '[stored[4, 160]["difference"][i] for key in by_step]',
    ),
]


@pytest.fixture(autouse=True)
def _as_in_the_build(monkeypatch):
    monkeypatch.setenv(STRICT, "1")
    matplotlib.use("Agg")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.slow
@pytest.mark.parametrize(("chapter", "name", "old", "fault"), FAULTS, ids=[f[1] for f in FAULTS])
def test_a_fault_turns_the_verdict(chapter, name, old, fault):
    with pytest.raises(AssertionError, match=rf"claim {name} (fails|holds) .*:\n"):
        slices.run_claim(chapter, name, (old, fault))


def test_without_a_fault_the_verdict_is_the_accepted_one():
    for chapter, name in (
        ("03", "N-2.10-ordering"),
        ("04", "N-2.22-gamma"),
        ("09", "N-4.34-chain"),
    ):
        assert slices.run_claim(chapter, name).verdict == accepted()[name]


def test_at_least_every_tenth_row_is_turned_by_a_fault():
    turned = {name for _, name, _, _ in FAULTS}
    assert turned <= set(CHECKS)
    assert len(set(FAULTS)) == len(FAULTS)
    assert len(turned) >= len(CHECKS) / 10
    # spread over the ledger: among any twenty checks that follow each other there is one
    gaps = [i for i, name in enumerate(CHECKS) if name in turned]
    assert max(b - a for a, b in zip([-1, *gaps], [*gaps, len(CHECKS)], strict=True)) <= 20
