"""The surface that sources, coefficients and laws see, against other ways to compute the same."""

import copy
import pickle
from itertools import permutations, product
from math import factorial

import naive
import numpy as np
import pytest

import esfem_core as ec

DEGREES = (1, 2, 3)
KEYS = ("M", "A", "points", "normal", "density", "u", "grad_u", "several", "grad several")


def torus(degree, monkeypatch=None):
    """A deformed torus in elements of this degree, and nodal values on it."""
    if monkeypatch is not None:  # several chunks
        monkeypatch.setattr("esfem_core.elements.integrals.CHUNK", 777)
    space = ec.SurfaceSpace(ec.torus(n=14, m=8), degree)
    rng = np.random.default_rng(degree)
    x = space.nodes @ (np.eye(3) + 0.3 * rng.standard_normal((3, 3)))
    x = x + 0.01 * rng.standard_normal(x.shape)
    fields = {"u": rng.standard_normal(len(x)), "several": rng.standard_normal((len(x), 2))}
    return space, x, fields


def get(at, key):
    """One thing of a surface, as arrays."""
    if key in ("M", "A"):
        return getattr(at, key).data
    if key.startswith("grad "):
        return at.grad(key.removeprefix("grad "))
    return at[key] if key == "several" else getattr(at, key)


@pytest.fixture(params=DEGREES)
def case(request, monkeypatch):
    return torus(request.param, monkeypatch)


class TestAgainstTheSpace:
    def test_values_and_geometry(self, case):
        space, x, fields = case
        at = ec.Surface(space, x, fields)
        M, A = space.mass_stiffness(x)
        expected = (
            M.data,
            A.data,
            space.quadrature_points(x),
            space.normals(x),
            space.density(x),
            space.evaluate(fields["u"]),
            space.gradient(x, fields["u"]),
            space.evaluate(fields["several"]),
            space.gradient(x, fields["several"]),
        )
        for key, values in zip(KEYS, expected, strict=True):
            # Equal to the last bit, but where a BLAS sums in another order.
            np.testing.assert_allclose(get(at, key), values, rtol=1e-12, atol=1e-14, err_msg=key)
        for matrix in (at.M, at.A):
            assert np.shares_memory(matrix.indices, space.pattern.indices)

    def test_an_array_alone_is_u(self, case):
        space, x, fields = case
        at = ec.Surface(space, x, fields["u"])
        assert list(at.fields) == ["u"]
        np.testing.assert_array_equal(at.u, at["u"])
        np.testing.assert_array_equal(at.grad_u, ec.Surface(space, x, fields).grad("u"))

    @pytest.mark.parametrize("trailing", [(), (2,), (2, 3)])
    def test_integrals_and_loads(self, case, trailing):
        space, x, _ = case
        at = ec.Surface(space, x)
        values = np.random.default_rng(0).standard_normal((*at.density.shape, *trailing))
        load = at.load(values)
        np.testing.assert_array_equal(load, space.load(x, values))
        total = at.integral(values)
        assert total.shape == trailing
        np.testing.assert_array_equal(total, space.integrate(x, values))
        np.testing.assert_allclose(total, load.sum(axis=0), rtol=0, atol=1e-13)
        area = at.M.sum()
        np.testing.assert_allclose(at.mean(values), total / area, rtol=1e-12)
        assert at.integral(2) == pytest.approx(2 * area, rel=1e-13)
        assert at.mean(-3) == pytest.approx(-3, rel=1e-15)

    def test_a_number_is_a_constant_load(self, case):
        space, x, _ = case
        at = ec.Surface(space, x)
        ones = np.ones(at.density.shape)
        np.testing.assert_array_equal(at.load(2.5), at.load(2.5 * ones))
        np.testing.assert_allclose(at.load(1), at.M @ np.ones(len(x)), rtol=0, atol=1e-14)
        np.testing.assert_array_equal(at.load(None), np.zeros(len(x)))


class TestFluxes:
    def test_a_gradient_gives_the_stiffness_matrix(self, case):
        space, x, fields = case
        at = ec.Surface(space, x, fields)
        for name, gradient in (("u", at.grad_u), ("several", at.grad("several"))):
            expected = at.A @ fields[name]
            b = at.load(None, flux=gradient)
            np.testing.assert_allclose(b, expected, rtol=0, atol=1e-13 * abs(expected).max())

    def test_a_field_gives_what_the_gradients_of_the_basis_give(self, case):
        space, x, _ = case
        at = ec.Surface(space, x)
        flux = np.random.default_rng(0).standard_normal((*at.density.shape, 3))
        expected = naive.gradient_load(space, x, flux)
        scale = abs(expected).max()
        np.testing.assert_allclose(at.load(None, flux), expected, rtol=0, atol=1e-13 * scale)
        values = flux[..., 0] ** 2
        both = at.load(values, flux)
        np.testing.assert_allclose(both, at.load(values) + expected, rtol=0, atol=1e-13 * scale)
        np.testing.assert_allclose(
            at.load(2.0, flux), at.load(2.0) + expected, rtol=0, atol=1e-13 * scale
        )

    def test_components_are_like_single_ones(self, case):
        space, x, _ = case
        at = ec.Surface(space, x)
        flux = np.random.default_rng(0).standard_normal((*at.density.shape, 2, 3))
        for values in (None, flux[..., 0]):
            b = at.load(values, flux)
            assert b.shape == (len(x), 2)
            for i in range(2):
                alone = at.load(None if values is None else values[..., i], flux[..., i, :])
                np.testing.assert_allclose(b[:, i], alone, rtol=0, atol=1e-14)

    def test_only_the_tangential_part_counts_and_constants_see_nothing(self, case):
        space, x, _ = case
        at = ec.Surface(space, x)
        flux = np.random.default_rng(0).standard_normal((*at.density.shape, 3))
        b = at.load(None, flux)
        scale = abs(b).max()
        np.testing.assert_allclose(
            at.load(None, flux + 5 * at.normal), b, rtol=0, atol=1e-12 * scale
        )
        assert abs(b.sum()) < 1e-12 * scale * len(x) ** 0.5


class TestWeightedMatrices:
    """For every combination of numbers, weights and tensors, against sums of products."""

    @staticmethod
    def weights(at):
        rng = np.random.default_rng(0)
        B = rng.standard_normal((*at.density.shape, 3, 3))
        return rng.standard_normal(at.density.shape), B + np.swapaxes(B, 2, 3)

    @pytest.mark.parametrize("mass_kind", ["zero", "number", "weight"])
    @pytest.mark.parametrize("stiffness_kind", ["zero", "number", "weight", "tensor"])
    def test_against_sums_of_products(self, case, mass_kind, stiffness_kind):
        space, x, _ = case
        at = ec.Surface(space, x)
        weight, tensor = self.weights(at)
        points = at.density.shape
        mass = {"zero": 0, "number": 2.5, "weight": weight}[mass_kind]
        stiffness = {"zero": 0, "number": 0.7, "weight": weight, "tensor": tensor}[stiffness_kind]
        full = stiffness if np.ndim(stiffness) else np.full(points, float(stiffness))
        if full.ndim == 2:
            full = full[..., None, None] * np.eye(3)
        expected = naive.weighted_mass(space, x, mass * np.ones(points))
        expected += naive.weighted_stiffness(space, x, full)
        found = at.matrix(mass, stiffness)
        assert found.nnz == space.pattern.nnz
        assert np.shares_memory(found.indices, space.pattern.indices)
        assert abs(found - found.T).max() == 0
        scale = max(abs(expected).max(), 1e-300)
        np.testing.assert_allclose(found.toarray(), expected, rtol=0, atol=1e-12 * scale)

    def test_only_the_tangential_part_of_a_tensor_counts(self, case):
        space, x, _ = case
        at = ec.Surface(space, x)
        _, tensor = self.weights(at)
        normal = at.normal[..., :, None] * at.normal[..., None, :]
        K = at.matrix(stiffness=tensor)
        assert abs(at.matrix(stiffness=tensor + 7 * normal) - K).max() < 1e-12 * abs(K).max()
        P = np.eye(3) - normal
        assert abs(at.matrix(stiffness=P) - at.A).max() < 1e-12 * abs(at.A).max()

    def test_matrices_may_be_written_to_without_harm(self, case):
        space, x, _ = case
        at = ec.Surface(space, x)
        before = at.M.data.copy()
        K = at.matrix(1.0, 0.0)
        K.data[:] = 0
        np.testing.assert_array_equal(at.M.data, before)


class TestOnTheOctahedron:
    """Flat faces, on which |x1|, |x2| and |x3| are the barycentric coordinates."""

    SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 0), 2)
    AREA = np.sqrt(3) / 2
    SIGNS = np.array(list(product([1, -1], repeat=3)))  # of the eight faces

    @classmethod
    def integral(cls, a, b, c):
        """Of x1^a x2^b x3^c, by the formula for barycentric coordinates."""
        if a % 2 or b % 2 or c % 2:
            return 0.0
        one = factorial(a) * factorial(b) * factorial(c) / factorial(a + b + c + 2)
        return 8 * 2 * cls.AREA * one

    def test_integrals_of_polynomials(self):
        x = self.SPACE.nodes
        at = ec.Surface(self.SPACE, x, x**2)
        x1, x2, x3 = np.moveaxis(at.points, -1, 0)
        for powers in [(0, 0, 0), (2, 0, 0), (1, 1, 2), *permutations((0, 2, 2)), (0, 0, 4)]:
            a, b, c = powers
            exact = pytest.approx(self.integral(*powers), rel=1e-13, abs=1e-14)
            assert at.integral(x1**a * x2**b * x3**c) == exact
        volume = at.integral((at.points * at.normal).sum(-1)) / 3
        assert volume == pytest.approx(4 / 3, rel=1e-14)
        np.testing.assert_allclose(at.mean(at.u), np.full(3, 1 / 6), rtol=1e-13)

    def test_values_and_gradients_of_quadratic_functions(self):
        x = self.SPACE.nodes
        at = ec.Surface(self.SPACE, x, x[:, 0] * x[:, 2])
        x1, _, x3 = np.moveaxis(at.points, -1, 0)
        np.testing.assert_allclose(at.u, x1 * x3, atol=1e-15)
        np.testing.assert_allclose(np.abs(at.normal), 1 / np.sqrt(3), rtol=1e-14)
        assert (at.normal * at.points > 0).all()  # outwards
        free = np.stack([x3, 0 * x1, x1], axis=-1)
        along = (free * at.normal).sum(-1, keepdims=True)
        np.testing.assert_allclose(at.grad_u, free - along * at.normal, atol=1e-14)
        np.testing.assert_allclose(at.density, 2 * self.AREA, rtol=1e-14)

    def test_a_weighted_mass_matrix(self):
        x = self.SPACE.nodes
        at = ec.Surface(self.SPACE, x)
        K = at.matrix(mass=at.points[..., 2] ** 2)
        assert x[:, 0] @ (K @ x[:, 0]) == pytest.approx(self.integral(2, 0, 2), rel=1e-13)
        assert K.sum() == pytest.approx(self.integral(0, 0, 2), rel=1e-13)
        assert abs(x[:, 0] @ (K @ x[:, 1])) < 1e-15

    def test_a_stiffness_matrix_with_a_tensor(self):
        """Int (a . grad x1)^2 for a fixed vector a: on each face a1 - s1 (s . a)/3."""
        x, a = self.SPACE.nodes, np.array([1.0, 2.0, 3.0])
        at = ec.Surface(self.SPACE, x)
        K = at.matrix(stiffness=np.broadcast_to(np.outer(a, a), (8, 6, 3, 3)))
        slopes = a[0] - self.SIGNS[:, 0] * (self.SIGNS @ a) / 3
        assert x[:, 0] @ (K @ x[:, 0]) == pytest.approx(self.AREA * (slopes**2).sum(), rel=1e-13)

    def test_a_load_with_a_flux(self):
        """Int x1 a . grad x1 = 0, and int x1^2 + a . grad x1 as above."""
        x, a = self.SPACE.nodes, np.array([1.0, 2.0, 3.0])
        at = ec.Surface(self.SPACE, x, x[:, 0])
        b = at.load(at.u, flux=np.broadcast_to(a, (8, 6, 3)))
        slopes = a[0] - self.SIGNS[:, 0] * (self.SIGNS @ a) / 3
        expected = self.integral(2, 0, 0) + self.AREA * slopes.sum()
        assert b @ x[:, 0] == pytest.approx(expected, rel=1e-13)


class TestWhatIsComputedWhen:
    def test_one_pass_and_first_use_give_the_same_bits(self, case):
        space, x, fields = case
        one_by_one = {key: get(ec.Surface(space, x, fields), key) for key in KEYS}
        lazy = ec.Surface(space, x, fields)
        for key in reversed(KEYS):
            np.testing.assert_array_equal(get(lazy, key), one_by_one[key], err_msg=key)
        for first in KEYS:  # whatever is asked for first, all of it comes with it
            at = ec.Surface(space, x, fields, expected=lazy.used)
            get(at, first)
            for key in KEYS:
                np.testing.assert_array_equal(get(at, key), one_by_one[key], err_msg=key)

    def test_what_is_expected_comes_out_of_one_pass(self, case, monkeypatch):
        space, x, fields = case
        passes = []
        metrics = space._metrics
        monkeypatch.setattr(space, "_metrics", lambda x: passes.append(1) or metrics(x))
        first = ec.Surface(space, x, fields)
        for key in KEYS:
            get(first, key)
        assert len(passes) > 1
        passes.clear()
        second = ec.Surface(space, x, fields, expected=first.used)
        for key in KEYS:
            get(second, key)
            get(second, key)
        second.load(1.0)
        assert len(passes) == 1

    def test_used_says_what_was_asked_for_and_not_what_was_expected(self, case):
        space, x, fields = case
        at = ec.Surface(space, x, fields, expected={("matrices", ""), ("value", "u")})
        assert at.used == set()
        at.grad("several")
        assert at.used == {("gradient", "several")}
        assert "u" in at.fields
        at.load(1.0)
        assert at.used == {("gradient", "several"), ("s", "")}

    def test_functions_of_another_surface_may_be_expected(self, case):
        space, x, fields = case
        expected = {("value", "gone"), ("gradient", "gone"), ("gradient", "u")}
        at = ec.Surface(space, x, fields, expected=expected)
        np.testing.assert_array_equal(at.u, space.evaluate(fields["u"]))
        with pytest.raises(KeyError, match="there is no function 'gone'"):
            at.grad("gone")

    def test_a_degenerate_element_is_found_on_first_use(self, case):
        space, x, fields = case
        x = x.copy()
        x[space.cells[5]] = x[space.cells[5, 0]]
        at = ec.Surface(space, x, fields)
        np.testing.assert_array_equal(at.u, space.evaluate(fields["u"]))  # knows no geometry
        for key in ("M", "normal", "grad_u"):
            with pytest.raises(ec.DegenerateElementError, match=r"element \d+ near .* degenerate"):
                get(at, key)


def test_all_arrays_are_read_only(case):
    space, x, fields = case
    x, fields = x.copy(), {name: w.copy() for name, w in fields.items()}
    at = ec.Surface(space, x, fields)
    given = {"x": at.x, **at.fields}
    for name, array in {**given, **{key: get(at, key) for key in KEYS}}.items():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
        assert not array.flags.writeable, name
    with pytest.raises(TypeError, match="does not support item assignment"):
        at.fields["u"] = x
    x[0] = 1  # the caller's own arrays stay as they are
    fields["u"][0] = 1
    for name in ("M", "A", "u", "normal", "density"):
        with pytest.raises(AttributeError):
            setattr(at, name, None)


@pytest.mark.parametrize("back", [lambda at: pickle.loads(pickle.dumps(at)), copy.deepcopy])
def test_arrays_of_pickles_and_copies_are_the_same_and_read_only(case, back):
    at = ec.Surface(*case)
    before = {key: get(at, key) for key in KEYS}
    again = back(at)
    for key, array in before.items():
        np.testing.assert_array_equal(get(again, key), array)
        assert not get(again, key).flags.writeable
    assert not again.space.nodes.flags.writeable


def test_one_object_is_one_surface_whatever_becomes_of_the_callers_arrays(case):
    space, x, fields = case
    x, u = x.copy(), fields["u"].copy()
    at, again = (ec.Surface(space, x, u) for _ in range(2))
    area, total = again.integral(1.0), again.integral(again.u)
    x *= 2
    u += 1
    assert (at.M.sum(), at.integral(1.0)) == pytest.approx((area, area))
    assert at.integral(at.u) == total


def test_it_says_what_it_holds():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    assert repr(ec.Surface(space, space.nodes)) == "Surface(t=0, nodes=6, fields: none)"
    at = ec.Surface(space, space.nodes, {"u": np.zeros(6), "w": space.nodes}, 0.25)
    assert repr(at) == "Surface(t=0.25, nodes=6, fields: u, w (3,))"


def test_functions_that_are_not_there_are_named():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    nothing = ec.Surface(space, space.nodes)
    for ask in (lambda: nothing.u, lambda: nothing.grad_u):
        with pytest.raises(KeyError, match="there is no function 'u' on this surface, only none"):
            ask()
    two = ec.Surface(space, space.nodes, {"a": np.zeros(6), "b": np.zeros(6)})
    for ask in (lambda: two["c"], lambda: two.grad("c")):
        with pytest.raises(KeyError, match="no function 'c' on this surface, only 'a', 'b'"):
            ask()
    assert two.used == set()


@pytest.mark.parametrize("ask", [lambda x: 1 + x[:, 0], lambda x: x[0], lambda x: x.grad(0)])
def test_who_takes_a_surface_for_points_is_told_where_the_points_are(ask):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    message = r"name must be a string, got .*no array of points; at\.points\[\.\.\., 0\] has"
    with pytest.raises(TypeError, match=message):
        ask(ec.Surface(space, space.nodes))
    problem = ec.Problem(1.0, g=lambda x: 1 + x[:, 0])
    with pytest.raises(TypeError, match=message):
        list(ec.evolve(space, problem, 1, 0.1, 0.1))
    as_told = ec.Problem(1.0, g=lambda at: 1 + at.points[..., 0])
    *_, last = ec.evolve(space, as_told, 1, 0.1, 0.1)
    assert last.t == 0.1


FLAT = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2)  # (T, Q) = (32, 6), N = 66


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            {"space": ec.sphere("octahedron", 1)},
            TypeError,
            "space must be a SurfaceSpace, got <tri",
        ),
        ({"x": FLAT.nodes[1:]}, ValueError, r"x must have shape \(66, 3\), got \(65, 3\)"),
        ({"x": 1j * FLAT.nodes}, TypeError, "x must hold real numbers, got complex128"),
        ({"fields": np.zeros(5)}, ValueError, r"u must have shape \(66, \.\.\.\), got \(5,\)"),
        (
            {"fields": {"w": np.zeros((3, 66))}},
            ValueError,
            r"w must have shape \(66, \.\.\.\), got \(3, 66\)",
        ),
        ({"fields": {"w": np.full(66, 1j)}}, TypeError, "w must hold real numbers, got complex128"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.Surface(**({"space": FLAT, "x": FLAT.nodes} | arguments))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            {"values": np.zeros((6, 32))},
            ValueError,
            r"values must have shape \(32, 6, \.\.\.\), got \(6, 32\)",
        ),
        ({"values": 1j}, TypeError, "values must hold real numbers, got complex128"),
        ({"values": np.nan}, ValueError, "values must be a finite number, got nan"),
        (
            {"values": np.zeros((32, 6)), "flux": np.zeros((32, 6))},
            ValueError,
            r"flux must have shape \(32, 6, 3\), got \(32, 6\)",
        ),
        (
            {"values": np.zeros((32, 6)), "flux": np.zeros((32, 6, 2, 3))},
            ValueError,
            r"flux must have shape \(32, 6, 3\), got \(32, 6, 2, 3\)",
        ),
        (
            {"values": None, "flux": np.zeros((32, 6, 2))},
            ValueError,
            r"flux must have shape \(32, 6, 3\), got \(32, 6, 2\)",
        ),
        (
            {"values": None, "flux": np.zeros((32, 6, 3), complex)},
            TypeError,
            "flux must hold real numbers, got complex128",
        ),
    ],
)
def test_loads_refuse(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.Surface(FLAT, FLAT.nodes).load(**arguments)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"mass": "1"}, TypeError, "mass must be a finite number, got .1."),
        ({"stiffness": np.inf}, ValueError, "stiffness must be a finite number, got inf"),
        ({"mass": np.zeros(32)}, ValueError, r"mass must have shape \(32, 6\), got \(32,\)"),
        (
            {"mass": np.zeros((32, 6, 3, 3))},
            ValueError,
            r"mass must have shape \(32, 6\), got \(32, 6, 3, 3\)",
        ),
        (
            {"stiffness": np.zeros((32, 6, 3))},
            ValueError,
            r"stiffness must have shape \(32, 6\), got \(32, 6, 3\)",
        ),
        (
            {"stiffness": np.zeros((32, 6, 2, 2))},
            ValueError,
            r"stiffness must have shape \(32, 6, 3, 3\), got \(32, 6, 2, 2\)",
        ),
        (
            {"stiffness": np.zeros((32, 6), complex)},
            TypeError,
            "stiffness must hold real numbers, got complex128",
        ),
    ],
)
def test_matrices_refuse(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.Surface(FLAT, FLAT.nodes).matrix(**arguments)


def test_tensors_must_be_symmetric_up_to_rounding():
    at = ec.Surface(FLAT, FLAT.nodes)
    tensor = np.tile(np.diag([1.0, 2.0, 3.0]), (32, 6, 1, 1))
    K = at.matrix(stiffness=tensor)
    tensor[7, 3, 0, 2] += 1e-13
    assert abs(at.matrix(stiffness=tensor) - K).max() < 1e-12
    tensor[7, 3, 0, 2] = 0.25
    message = r"stiffness must be symmetric, but entries .* of the tensors differ by up to 0\.25"
    with pytest.raises(ValueError, match=message):
        at.matrix(stiffness=tensor)


def test_a_surface_without_a_curvature_says_what_makes_it():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    at = ec.Surface(space, 2 * space.nodes)
    with pytest.raises(KeyError, match=r"'H' .*; esfem_core\.elements\.normal_and_curvature\(at\)"):
        at["H"]
    np.testing.assert_allclose(ec.elements.normal_and_curvature(at)[1], 1.0, atol=2e-3)
