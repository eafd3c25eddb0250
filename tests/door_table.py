"""The table of doors: every function that scripts call, each argument with a good value."""

import tempfile
from functools import cache
from pathlib import Path

import meshio
import numpy as np
from doors import (
    Argument,
    Door,
    answering,
    array,
    flag,
    function,
    number,
    one,
    option,
    path,
    returning,
    several,
    text,
    whole,
)

import esfem_core as ec
from esfem_core import elements, solvers, stepping, study, surfaces, theory
from esfem_core.study import ConvergenceTable, final, observed_orders, space_study, time_study

DEGREES = (0, -1, 1000, 10**12)
NAN = float("nan")
HUGE = (-1, 10**12, 10**30)


def _norm(x):
    return np.linalg.norm(x, axis=1) - 1


def _still(p, t):
    return p


def _along(at):
    return np.cross([0.0, 0.0, 0.1], at.x)


def _turning(x, t):
    return np.cross([0.0, 0.0, 1.0], x)


def _squared(side):
    return {"area": side**2}


@cache
def doors() -> list[Door]:
    """All of them; made once."""
    tri = ec.sphere("octahedron", 1)
    space = ec.SurfaceSpace(tri, 2, ec.to_unit_sphere)
    x, n = space.nodes, len(space.nodes)
    T, Q = len(space.cells), len(space.rule.weights)
    u = x[:, 0] + 0.1
    at = ec.Surface(space, x, {"u": u, "normal": x}, 0.5)
    M, A = space.mass_stiffness(x)
    K = (M + A).tocsr()
    problem = ec.problems.growing_sphere()
    states = list(ec.evolve(space, problem, 2, 0.125, 0.5))
    last = states[-1]
    points, pairs = np.array([[0.0, 0.6, 1.0], [1.1, 0.1, 0.0]]), np.ones((T, Q))
    folder = Path(tempfile.mkdtemp())
    ec.save(folder / "run.npz", states)
    rough = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    flat = ec.SurfaceSpace(tri)
    simple = ec.Problem(u0=1.0, motion=_still)
    curved = meshio.Mesh(space.nodes, [("triangle6", space.cells)])

    density = space.density(x)
    table = ConvergenceTable("h", [1.0, 0.5], {"e": [1.0, 0.2]})
    areas = study.Experiment("areas", "", _squared, [[{"side": 2}]])

    def run_study(cases=({"side": 2},), compute=_squared, **given):
        options = {"folder": folder, "workers": 0, "progress": False, "name": "areas", **given}
        return study.run(cases, compute, **options)

    def evolve(problem=simple, space=rough, order=1, step=0.5, end=1.0, **options):
        """Run to the end."""
        return list(ec.evolve(space, problem, order, step, end, **options))

    def run(**given):
        """Run a problem made of these."""
        return evolve(ec.Problem(**given))

    def run_species(**given):
        return evolve(
            ec.Problem(species={"u": ec.Species(**given)}, law=ec.laws.Prescribed(_still))
        )

    def run_law(law):
        return lambda **given: evolve(
            ec.Problem(species={"u": ec.Species(1.0)}, law=law(**given)), step=0.01, end=0.02
        )

    def run_exact(**given):
        return evolve(ec.Problem(1.0, motion=_still, exact=ec.Exact(**given)))

    def lifted(**given):
        exact = ec.Exact(**{"x": _still, "v": lambda p, t: 0 * p, "u": lambda x, t: x[:, 0],
                            "closest": lambda x, t: ec.to_unit_sphere(x),
                            "origin": lambda x, t: ec.to_unit_sphere(x), **given})  # fmt: skip
        state = ec.State(0.0, x, None, u, space=space)
        return ec.errors.lifted(space, ec.Problem(u0=1.0, motion=_still, exact=exact), state)

    class Own:
        """A law of one's own, some of whose methods misbehave."""

        def __init__(self, **given):
            self.given = given

        @property
        def species(self):
            return {"w": ec.Species(None, diffusivity=0.1)}

        def initial(self, at):
            return {"w": self.given.get("initial", lambda at: at.x[:, 0])(at)}

        def equations(self, tau, past):
            return self.given.get("equations", lambda tau, past: self.species)(tau, past)

        def slip(self, at):
            return self.given.get("slip", lambda at: None)(at)

        def velocity(self, at, new, tau, past, solve):
            if "matrix" in self.given:
                return 0.1 * solve(self.given["matrix"](at.M), self.given["load"](at.x))
            return self.given.get("velocity", lambda at: 0.1 * at.x)(at)

    def run_own(**given):
        return evolve(
            ec.Problem(species={"u": ec.Species(1.0)}, law=Own(**given)), step=0.05, end=0.1
        )

    def chosen(n):
        zero = np.zeros_like(rough.nodes)
        return theory.defects.Defects(zero[:, 0], zero, zero)

    def respond(**given):
        options = {"space": rough, "problem": problem, "order": 1, "step": 0.25, "end": 0.5,
                   "chosen": chosen, **given}  # fmt: skip
        return list(theory.stability.response(**options))

    def misbehaving(*bad):
        """Functions n -> defects that are none."""
        return [lambda n, b=b: b for b in bad]

    def small(n):
        zero = np.zeros_like(rough.nodes)
        return theory.defects.Defects(zero[:, 0], 1e-6 * rough.nodes, zero)

    compared = list(theory.stability.response(rough, problem, 1, 0.25, 0.5, small))
    unit = ec.exact_surfaces.Sphere()
    onto = theory.forms.lift(space, x, unit)

    def error_terms(**given):
        options = {"space": rough, "pairs": compared, "order": 1, "step": 0.25, "chosen": small,
                   **given}  # fmt: skip
        return theory.stability.error_terms(**options)

    def growing(t):
        return ec.exact_surfaces.Sphere(1 + t)

    def geometric_errors(**given):
        options = {"space": rough, "surface": growing, "motion": lambda x, t: (1 + t) * x,
                   "velocity": lambda x: x, "u": lambda x: x[..., 2],
                   "gradient": lambda x: 0 * x + [0, 0, 1.0], **given}  # fmt: skip
        return theory.geometry.geometric_errors(**options)

    linear = ec.Problem(
        u0=lambda x: x[:, 2],
        exact=ec.Exact(lambda p, t: p * (1 + t), lambda p, t: p, lambda x, t: x[..., 2]),
    )
    near = {"surface": growing, "v": lambda x, t: x / (1 + t), "f": lambda x, t: x[..., 0]}

    def spatial_terms_u(**given):
        field = theory.defect_terms.Field(**{**near, **given})
        return list(theory.defect_terms.spatial_terms_u(rough, linear, field, 0.5).values())

    sphere_text = "x1**2 + x2**2 + x3**2 - 1"

    def manufactured(**given):
        options = {"d": sphere_text, "motion": ("p1", "p2", "p3"), "until": 0.1, **given}
        return ec.manufactured(**options)

    EXPRESSIONS = (None, [], {}, object(), NAN, True, "", "no such", "x1 +", b"x1", 1j, np.ones(3),
                   "q1 + x1", "import os", ["x1", "x2"])  # fmt: skip

    def write_series(state):
        ec.SeriesWriter(folder / "written.pvd").write(state)

    def write_table(row):
        ec.TableWriter(folder / "written.csv").write(row)

    def surfaces_state(**given):
        return ec.Surface(**{"space": space, "x": x, **given})

    made = [
        # surfaces
        Door("sphere", ec.sphere,
             {"kind": option("octahedron"), "refinements": whole(1, *HUGE, 13)}),
        Door("bisected_sphere", surfaces.bisected_sphere, {"bisections": whole(2, *HUGE)}),
        Door("torus", ec.torus, {"R": number(1.0, 0, -1, 0.4), "r": number(0.4, 0, -1, 1.0),
                                 "n": whole(8, 2, *HUGE), "m": whole(6, 2, *HUGE)}),
        Door("to_unit_sphere", ec.to_unit_sphere, {"points": array(points, np.zeros((2, 3)), before=True, rows=True)}),
        Door("displaced", surfaces.displaced,
             {"tri": one(tri), "share": number(0.1, -1.0), "project": returning(ec.to_unit_sphere),
              "seed": whole(0, -1)}),
        Door("check_triangulation", ec.check_triangulation, {"tri": one(tri)}),
        Door("smooth", ec.smooth,
             {"tri": one(tri), "crease": number(50.0, -1, 181), "boundary": flag(False)}),
        Door("mesh_quality", ec.mesh_quality, {"tri": one(tri)}),
        Door("repair", lambda tri=tri, **o: ec.repair(tri, **{"report": None, **o}),
             {"tri": one(tri), "holes": whole(12, -1), "boundary": flag(False),
              "report": function(lambda text: None, optional=True)}),
        Door("read_mesh", lambda source, **o: ec.read_mesh(source, **{"report": None, **o}),
             {"source": Argument(tri, "listed", [None, 1, 1.5, [], {}, "", "/no/such/file.stl",
                                                 object(), True])}),
        Door("project_to_level_set",
             lambda d=_norm, gradient=None, points=points:
             ec.project_to_level_set(d, gradient)(points),
             {"d": returning(_norm),
              "gradient": returning(lambda x: x, optional=True),
              "points": array(points, rows=True)}),
        Door("from_level_set", ec.from_level_set,
             {"d": returning(_norm), "bounds": array([[-1.3] * 3, [1.3] * 3]),
              "h": number(0.9, 0, -1, 1e-9),
              "gradient": returning(lambda x: x / np.linalg.norm(x, axis=1)[:, None],
                                    optional=True)}),
        Door("Sphere", lambda radius=1.0, x=points: ec.exact_surfaces.Sphere(radius).near(x),
             {"radius": number(1.0, 0, -1), "x": array(points, before=True, rows=True)}),
        Door("Torus", lambda R=1.0, r=0.4, x=points: ec.exact_surfaces.Torus(R, r).near(x),
             {"R": number(1.0, 0, -1), "r": number(0.4, 0, -1, 2.0), "x": array(points, before=True, rows=True)}),
        Door("Ellipsoid",
             lambda axes=(1.0, 1.1, 1.2), x=points: ec.exact_surfaces.Ellipsoid(axes).near(x),
             {"axes": array((1.0, 1.1, 1.2), (0.0, 1.0, 1.0), (-1.0, 1, 1), called=("x",)), "x": array(points, before=True, rows=True)}),
        Door("LevelSet",
             lambda d=_norm, gradient=None, x=points:
             ec.exact_surfaces.LevelSet(d, gradient).near(x),
             {"d": returning(_norm), "gradient": returning(lambda x: x, optional=True),
              "x": array(points, before=True, rows=True, called=("points", "d"))}),
        # elements
        Door("SurfaceSpace", ec.SurfaceSpace,
             {"tri": one(tri), "degree": whole(2, *DEGREES),
              "project": returning(ec.to_unit_sphere, optional=True),
              "exactness": whole(4, -1, 10**9, 0, optional=True),
              "project_vertices": flag(False)}),
        Door("from_nodes", ec.SurfaceSpace.from_nodes,
             {"nodes": array(space.nodes), "cells": array(space.cells, space.cells + 1),
              "exactness": whole(4, -1, 10**9, 0, optional=True), "order": option("vtk")}),
        Door("SurfaceSpace.read",
             lambda source=None, **o: ec.SurfaceSpace.read(curved if source is None else source,
                                                           **{"report": None, **o}),
             {"source": Argument(curved, "listed", [1, 1.5, [], {}, "", "/no/such/file.msh", object(), True,
                                                    np.ones((3, 3)), b"a", str(folder),
                                                    meshio.Mesh(curved.points, []),
                                                    meshio.Mesh(curved.points[:, :2], curved.cells),
                                                    meshio.Mesh(curved.points * NAN, curved.cells),
                                                    meshio.Mesh(curved.points[:3], [("triangle", [[0, 1, 2]])])]),
              "exactness": whole(4, -1, 10**9, 0, optional=True),
              "report": function(lambda text: None, optional=True), "boundary": flag(False)}),
        Door("mass_stiffness", space.mass_stiffness, {"x": array(x)}),
        Door("mass", space.mass, {"x": array(x)}),
        Door("evaluate", space.evaluate, {"u": array(u, finite=False, after=True)}),
        Door("gradient", space.gradient, {"x": array(x), "u": array(u, finite=False, after=True)}),
        Door("load", space.load, {"x": array(x), "values": array(pairs, finite=False, after=True)}),
        Door("integrate", space.integrate,
             {"x": array(x), "values": array(pairs, finite=False, constant=True, after=True)}),
        Door("interpolate", space.interpolate,
             {"function": returning(lambda x: x[:, 0], any_shape=True), "x": array(x)}),
        Door("probe", space.probe, {"x": array(x), "u": array(u, after=True), "points": array(points, rows=True)}),
        Door("mass_times", space.mass_times, {"x": array(x), "u": array(u, finite=False, after=True)}),
        Door("mesh_size", space.mesh_size, {"x": array(x)}),
        Door("normals", space.normals, {"x": array(x)}),
        Door("density", space.density, {"x": array(x)}),
        Door("integral_with", space.integral_with,
             {"density": array(density, finite=False, only=True),
              "values": array(pairs, finite=False, constant=True, after=True)}),
        Door("load_with", space.load_with,
             {"density": array(density, finite=False, only=True),
              "values": array(pairs, finite=False, after=True, only=True)}),
        Door("quadrature_points", space.quadrature_points, {"x": array(x)}),
        Door("basis_gradients", space.basis_gradients, {"x": array(x)}),
        Door("Surface", surfaces_state,
             {"space": one(space), "x": array(x, finite=False), "t": number(0.0),
              "fields": Argument({"u": u}, "listed",
                                 ["a", 1.0, [], {"u": "a"}, {1: u}, {"u": u[:-1]}, {"u": None},
                                  {"u": u * 1j}, u[:-1], u * 1j], called=("u",))}),
        Door("Surface.load", lambda values=1.0, **o: at.load(values, **o),
             {"values": array(pairs, finite=False, constant=True, optional=True, after=True),
              "flux": array(np.ones((T, Q, 3)), finite=False, optional=True)}),
        Door("Surface.integral", at.integral, {"values": array(pairs, finite=False, constant=True, after=True)}),
        Door("Surface.mean", at.mean, {"values": array(pairs, finite=False, constant=True, after=True)}),
        Door("Surface.matrix", at.matrix,
             {"mass": array(pairs, finite=False, constant=True),
              "stiffness": array(pairs, finite=False, constant=True)}),
        Door("Surface.grad", at.grad, {"name": text("u")}),
        Door("Surface[]", lambda name: at[name], {"name": text("u")}),
        Door("triangle_rule", elements.triangle_rule, {"exactness": whole(3, -1, 10**9)}),
        # laws and problems
        Door("Species", ec.Species,
             {"initial": Argument(1.0, "listed", ["a", [], {}, np.array(["a"]), object(), True]),
              "source": function(lambda at: at.u, optional=True),
              "rate": Argument(1.0, "listed", [-1, "a", [], NAN, 1j, True, {}]),
              "diffusivity": Argument(1.0, "listed", [None, "1", -1, NAN, [], [-1.0], [NAN], {},
                                                      np.ones((2, 2)), 1j, True]),
              "conserved": flag(True)}),
        Door("Species, run", run_species,
             {"initial": returning(lambda x: x[:, 0], constant=True, called=("u0",), instead=(int,)),
              "source": returning(lambda at: at.u, constant=True, instead=(None,)),
              "rate": returning(lambda at: 0 * at.u, constant=True, instead=(int, None)),
              "diffusivity": returning(lambda at: 0 * at.u + 1, constant=True, instead=(int,))}),
        Door("Problem", ec.Problem,
             {"u0": Argument(1.0, "listed", ["a", [], {}, object(), True, NAN]),
              "f": function(lambda at: at.u, optional=True),
              "g": function(lambda at: at.u, optional=True),
              "alpha": number(1.0, -1, optional=True), "beta": number(1.0, -1, optional=True),
              "diffusivity": Argument(1.0, "listed", [-1, "a", [], NAN, 1j, True, {}, [-1.0], ["a"]]),
              "exact": one(problem.exact, optional=True)}),
        Door("Problem, motion", lambda u0=1.0, **o: ec.Problem(u0, **o),
             {"motion": function(_still, optional=True)}),
        Door("Problem, species", ec.Problem,
             {"species": Argument({"a": ec.Species(1.0)}, "listed",
                                  [1, "a", [], [ec.Species(1.0)], {"a": 1}, {1: ec.Species(1.0)},
                                   ec.Species(1.0), {"x": ec.Species(1.0)}, {"a": None}]),
              "law": Argument(ec.laws.Regularised(), "listed",
                              [1, "a", [], {}, ec.laws.Regularised, object()])}),
        Door("Problem, run", run,
             {"u0": returning(lambda x: x[:, 0] + 2, constant=True, instead=(int, None)),
              "f": returning(lambda at: at.u, constant=True, instead=(None,)),
              "g": returning(lambda at: 0.1 * at.u, constant=True, instead=(None,))}),
        Door("Problem, run with a motion", lambda motion: run(u0=1.0, motion=motion),
             {"motion": returning(_still, instead=(None,))}),
        Door("Prescribed, run", lambda velocity: run_law(ec.laws.Prescribed)(velocity=velocity),
             {"velocity": returning(_turning)}),
        Door("Exact", ec.Exact,
             {"x": function(_still), "v": function(_still),
              "u": function(lambda x, t: x[:, 0], optional=True),
              "closest": function(_still, optional=True),
              "origin": function(_still, optional=True),
              "fields": Argument({}, "listed", [1, "a", [], {"a": 1}, {1: _still}, None])}),
        Door("Exact, run", run_exact,
             {"x": returning(_still, called=("exact.x",)),
              "v": returning(lambda p, t: 0 * p, called=("exact.v",)),
              "u": returning(lambda x, t: np.ones(len(x)), called=("exact.u",), instead=(None,))}),
        Door("lifted", lifted,
             {"x": returning(_still), "v": returning(lambda p, t: 0 * p),
              "u": returning(lambda x, t: x[:, 0], instead=(None,)),
              "closest": returning(lambda x, t: ec.to_unit_sphere(x)),
              "origin": returning(lambda x, t: ec.to_unit_sphere(x))}),
        Door("Exact.nodal", problem.exact.nodal,
             {"nodes": array(x, rows=True, only=True), "t": number(0.25)}),
        Door("Problem.initial_values", problem.initial_values,
             {"x": array(x, rows=True, only=True)}),
        Door("Species.initial_values", ec.Species(lambda x: x[:, 0]).initial_values,
             {"x": array(x, rows=True, only=True)}),
        Door("Regularised", ec.laws.Regularised,
             {"alpha": number(1.0, -1), "beta": number(1.0, -1),
              "g": function(lambda at: at.u, optional=True)}),
        Door("MeanCurvature", ec.laws.MeanCurvature,
             {"beta": number(1.0, 0, -1), "g": function(lambda at: at.u, optional=True),
              "normal": Argument(None, "listed", ["a", 1.0, [], {}, object(), True]),
              "curvature": Argument(None, "listed", ["a", [], {}, object(), True])}),
        Door("MeanCurvature, run", run_law(ec.laws.MeanCurvature),
             {"normal": returning(lambda x: x, instead=(None,)),
              "curvature": returning(lambda x: 2 + 0 * x[:, 0], called=("H",), instead=(None,)),
              "g": returning(lambda x, t: 0 * x[:, 0], constant=True, instead=(None,))}),
        Door("Dynamic", ec.laws.Dynamic,
             {"v0": Argument(0.0, "listed", ["a", [], {}, object(), True, None, NAN, [1.0, 2.0],
                                             np.ones((2, 3, 4)), 1j]),
              "alpha": number(1.0, -1), "beta": number(1.0, -1),
              "g": function(lambda at: at.u, optional=True)}),
        Door("Dynamic, run", run_law(ec.laws.Dynamic),
             {"v0": returning(lambda x: x, instead=(int, np.ndarray)),
              "g": returning(lambda at: 0 * at.density, constant=True,
                             instead=(None,))}),
        Door("Elastic", ec.laws.Elastic, {"rate": number(10.0, 0, -1), "area": number(1.0, -1)}),
        Door("Elastic.largest_step", ec.laws.Elastic().largest_step, {"order": whole(2, 0, -1)}),
        Door("VolumePreserving", ec.laws.VolumePreserving, {"law": one(ec.laws.Regularised())}),
        Door("with_slip", ec.laws.with_slip,
             {"law": Argument(ec.laws.Regularised(), "listed",
                              [None, 1, "a", [], {}, object(), ec.laws.Regularised]),
              "w": Argument("elastic", "listed", [None, 1, "no such", [], {}, True])}),
        Door("with_slip, run",
             lambda w: run_law(lambda: ec.laws.with_slip(ec.laws.Regularised(), w))(),
             {"w": returning(lambda at: np.cross([0, 0, 1.0], at.x))}),
        Door("law of one's own, run", run_own,
             {"initial": answering(lambda at: at.x[:, 0], called=("w",)),
              "equations": Argument(lambda tau, past: {"w": ec.Species(None)}, "listed",
                                    [lambda t, p: None, lambda t, p: 1, lambda t, p: "a",
                                     lambda t, p: {}, lambda t, p: {"w": 1}, lambda t, p: [],
                                     lambda t, p: {"z": ec.Species(1.0)}]),
              "slip": answering(_along, instead=(None,)),
              "velocity": answering(lambda at: 0.1 * at.x)}),
        Door("law of one's own, solve", run_own,
             {"matrix": Argument(lambda M: M, "listed",
                                 [lambda M: None, lambda M: 1, lambda M: "a", lambda M: M.toarray(),
                                  lambda M: M[:-1], lambda M: -M, lambda M: 0 * M, lambda M: M * NAN,
                                  lambda M: M * 1j], called=("A",)),
              "load": answering(lambda b: b, called=("b", "w"))}),
        Door("Species, fixed", lambda fixed: run_species(initial=1.0, fixed=([0, 2], fixed)),
             {"fixed": returning(lambda x, t: x[:, 0], constant=True, instead=(int,))}),
        Door("Species, fixed nodes",
             lambda nodes: run_species(initial=1.0, fixed=(nodes, 0.0)),
             {"nodes": Argument([0, 2], "listed", [None, 1j, "a", [], {}, [0, 0], [-1], [10**6], [0.5],
                                                   [NAN], [[0]], True, object(), lambda x: 5],
                                called=("fixed",))}),
        Door("manufactured", manufactured,
             {"d": Argument(sphere_text, "listed", [*EXPRESSIONS, "x1**2 + x2**2 + x3**2", "1",
                                                    "x1**2 + x2**2 + x3**2 + 1", 1.0]),
              "motion": Argument(("p1", "p2", "p3"), "listed",
                                 [*EXPRESSIONS, ("p1", "p2"), ("p1", "p2", "q"), ("2*p1", "p2", "p3"),
                                  ("p1", "p2", "p3", "p1"), ("p1 + t", "p2", "p3"), 1.0]),
              "u": Argument("x1", "listed", [v for v in EXPRESSIONS if v is not None]),
              "alpha": number(1.0, -1, optional=True), "beta": number(1.0, -1, optional=True),
              "diffusivity": number(1.0, -1), "prescribed": flag(False),
              "until": number(0.1, 0, -1)}),
        Door("expanding_sphere", ec.problems.expanding_sphere,
             {"coupling": option("smooth"), "alpha": number(1.0, -1), "beta": number(1.0, -1)}),
        Door("growing_sphere", ec.problems.growing_sphere,
             {"alpha": number(1.0, -1), "beta": number(1.0, -1), "delta": number(1.0),
              "u0": number(4.0)}),
        Door("shrinking_sphere", ec.problems.shrinking_sphere,
             {"alpha": number(1.0, -1), "beta": number(1.0, -1), "u0": number(1.0)}),
        Door("logistic_sphere", ec.problems.logistic_sphere,
             {"alpha": number(1.0, -1), "beta": number(1.0, -1), "delta": number(0.4),
              "limit": number(2.0, 0, -1), "rate": number(0.5, 0, -1)}),
        Door("oscillating_ellipsoid", ec.problems.oscillating_ellipsoid,
             {"solution": option("decay"), "evaluation": option("direct")}),
        Door("baseball_bat", ec.problems.baseball_bat,
             {"u0": Argument(None, "listed", ["a", [], {}, object(), True])}),
        # stepping
        Door("delta", ec.bdf.delta, {"p": whole(2, 0, *HUGE)}),
        Door("gamma", ec.bdf.gamma, {"p": whole(2, 0, *HUGE)}),
        Door("delta_exact", ec.bdf.delta_exact, {"p": whole(2, 0, *HUGE)}),
        Door("combine", ec.bdf.combine,
             {"coefficients": Argument([1.0, 2.0], "listed",
                                       [None, 1, "ab", [], {}, object(), [1.0], [None, 1.0],
                                        [1.0, "a"], [NAN, 1.0], [1j, 1], np.ones((2, 2))]),
              "values": Argument([u, u], "listed", [None, 1, "ab", [], {}, [u], [u, None], [u, u[:-1]],
                                                    [u, u * 1j], [u, u.astype(str)]])}),
        Door("extrapolate", ec.bdf.extrapolate,
             {"values": Argument([u, u], "listed", [None, 1, "a", [], ["a"], [None], [u, u[:-1]],
                                                    [u * 1j], {}])}),
        Door("evolve", evolve,
             {"space": one(rough), "problem": one(simple), "order": whole(1, 0, 7, *HUGE),
              "step": number(0.5, 0, -1, 1e-320, 0.3), "end": number(1.0, -1, 0.7),
              "mass": option("updated"),
              "start": Argument("euler", "listed", [1, "no", [], {}, True, NAN, [None], [1, 2],
                                                    object(), [last]]),
              "solver": Argument("direct", "listed", [None, 1, "no", [], {}, lambda: None,
                                                      lambda: object(), True]),
              "allow_unstable": flag(False),
              "perturbation": Argument(None, "listed", [1, "a", [], lambda n: None, lambda n: 1,
                                                        lambda n: {"u": "a"}, lambda n: (1, 2),
                                                        lambda n: {"no": x}, lambda n: {1: x},
                                                        lambda n: {"u": u}]),
              "growth": Argument(1e12, "listed", [0, 1, -1, NAN, None, "a", [], 1j, True, np.ones(2)]),
              "statistics": Argument(None, "listed", [1, "a", [], {}, True, object(),
                                                      ec.Statistics]),
              "save": path(str(folder / "out.npz"), optional=True), "every": whole(50, 0, -1)}),
        Door("State", lambda **o: ec.State(**{"t": 0.0, "x": x, **o}),
             {"t": number(0.0), "x": array(x, finite=False, rows=True),
              "v": array(x, finite=False, optional=True),
              "u": array(u, finite=False, optional=True, after=True),
              "space": one(space, optional=True),
              "fields": Argument(None, "listed", [1, "a", [], {"a": "b"}, {1: u}, {"u": u[:-1]}],
                                 called=("u", "a")),
              "products": Argument(None, "listed", [1, "a", [], {"a": "b"}, {1: u}]),
              "method": Argument(None, "listed", [1, "a", [], (1, 2), ("no", 1, 0.1),
                                                  ("updated", 1.5, 0.1), ("updated", 1, NAN)])}),
        Door("State[]", lambda name: last[name], {"name": text("u")}),
        Door("State.with_functions", last.with_functions,
             {"functions": Argument({"w": u}, "listed", [None, 1, "a", [], {"a": "b"}, {1: u},
                                                         {"w": u[:-1]}], called=("w", "a"))}),
        Door("measure", ec.measure, {"state": one(last)}),
        Door("exact_state", stepping.exact_state,
             {"space": one(space), "problem": one(problem), "t": number(0.5)}),
        Door("save", ec.save, {"path": path(str(folder / "a.npz")), "states": several(states)}),
        Door("load file", ec.load, {"path": path(str(folder / "run.npz"))}),
        Door("remeshed", lambda states=last, h=0.9, **o: ec.remeshed(states, h, **o),
             {"states": Argument(last, "listed", [None, 1, "a", [], {}, object(), [None], [1]]),
              "h": number(0.9, 0, -1, optional=True),
              "problem": one(problem, optional=True)}),
        Door("respaced", ec.respaced,
             {"states": several(states), "step": number(0.1, 0, -1),
              "order": whole(2, 0, *HUGE, optional=True)}),
        Door("started_anew", ec.started_anew,
             {"state": one(last), "problem": one(problem), "order": whole(2, 0, *HUGE),
              "step": number(0.1, 0, -1),
              "solver": Argument("direct", "listed", [None, 1, "no", [], {}, lambda: None,
                                                      lambda: object(), True]),
              "growth": Argument(1e12, "listed", [0, 1, -1, NAN, None, "a", [], 1j, True, np.ones(2)])}),
        # errors and studies
        Door("seminorm", ec.errors.seminorm, {"matrix": one(M), "w": array(u, after=True)}),
        Door("compare", ec.errors.compare,
             {"space": one(space), "problem": one(problem), "state": one(last)}),
        Door("errors.lifted", ec.errors.lifted,
             {"space": one(space), "problem": one(problem), "state": one(last)}),
        Door("difference", ec.errors.difference,
             {"space": one(space), "state": one(last), "reference": one(last)}),
        Door("time_norms", ec.errors.time_norms,
             {"space": one(space), "problem": one(problem), "states": several(states),
              "window": array((0.0, 0.5), (0.5, 0.0), (NAN, 1.0), finite=False), "measure": function(ec.errors.compare)}),
        Door("observed_orders", observed_orders,
             {"sizes": array([0.4, 0.2], [1.0, -1.0], [1.0, 1.0]),
              "values": array([4.0, 1.0], [-1.0, 1.0], finite=False)}),
        Door("ConvergenceTable", ConvergenceTable,
             {"parameter": text("h"), "sizes": array([0.4, 0.2], [1.0, -1.0], [0.0, 1.0]),
              "errors": Argument({"a": [1.0, 2.0]}, "listed",
                                 [None, 1, "a", [], {"a": 1}, {"a": [1.0]}, {1: [1.0, 2.0]}],
                                 called=("a",))}),
        Door("ConvergenceTable.of", ConvergenceTable.of,
             {"parameter": text("h"), "sizes": array([0.4, 0.2], [1.0, -1.0], [0.0, 1.0]),
              "rows": Argument([{"a": 1.0}, {"a": 2.0}], "listed",
                               [None, 1, "a", [], {}, [1, 2], [None, {"a": 1.0}], [{1: 1.0}, {1: 1.0}],
                                [{"a": 1.0}, {"b": 1.0}]])}),
        Door("ConvergenceTable.join", ConvergenceTable.join,
             {"tables": Argument({"a": table, "b": table}, "listed",
                                 [None, 1, "a", [], {}, [table], {"a": 1}, {1: table}]),
              "name": text("e")}),
        Door("ConvergenceTable.orders", table.orders, {"name": text("e")}),
        Door("study.grid", lambda order: study.grid(order=order),
             {"order": Argument((1, 2), "listed", [None, 1, 1.5, "ab", b"a", True, object(),
                                                   np.array(1.0)])}),
        Door("study.run", run_study,
             {"cases": Argument([{"side": 2}], "listed",
                                [None, 1, "a", {"side": 1}, [1], ["a"], [None], [{1: 2}],
                                 [[{"side": 1}, 2]], [{"side": object()}], [{"side": np.ones(2)}]],
                                called=("case",)),
              "compute": function(_squared),
              "folder": Argument(str(folder), "listed", [None, 1, [], b"a", True, "a\0"]),
              "executor": Argument(None, "listed", [1, "a", [], {}, object(), True]),
              "name": Argument("areas", "listed", [1, "", "a/b", "..", [], b"a", True]),
              "workers": Argument(0, "listed", [-1, 1.5, "1", [], True, NAN]),
              "threads": Argument(1, "listed", [0, -1, 1.5, "1", [], True, NAN]),
              "enough": function(lambda one, other: False, optional=True),
              "stale": option("renew"),
              "progress": Argument(False, "listed", [None, 1, "a", [], {}, object()])}),
        Door("study.outcomes",
             lambda experiments, **o: list(study.outcomes(experiments, folder, workers=0, **o)),
             {"experiments": Argument([areas], "listed", [None, 1, "a", {}, [None], [1], [{}]]),
              "stale": option("keep")}),
        Door("study.case", study.case,
             {"experiment": one(areas), "parameters": Argument({"side": 1}, "listed",
                                                               [None, 1, "a", [], [1], {1: 2}])}),
        Door("study.is_current", study.is_current,
             {"experiment": one(areas), "row": one(study.case(areas, {"side": 2}))}),
        Door("study.read", study.read,
             {"path": Argument(str(folder / "none.jsonl"), "listed",
                               [None, 1, [], b"a", True, str(folder), "a\0"])}),
        Door("study.select", study.select,
             {"rows": Argument([study.case(areas, {"side": 2})], "listed",
                               [None, 1, "a", {}, [1], [None]])}),
        Door("Processes", study.Processes,
             {"workers": whole(1, 0, -1, optional=True), "threads": whole(1, 0, -1, optional=True)}),
        Door("final", final, {"states": several(states)}),
        Door("time_study",
             lambda space=rough, problem=problem, order=1, steps=(0.5,), end=0.5, **o:
             time_study(space, problem, order, steps, end, **o),
             {"space": one(rough), "problem": one(problem), "order": whole(1, 0, 7),
              "steps": array([0.5], [0.0], [], called=("step",)), "end": number(0.5, -1),
              "reference": one(last, optional=True), "measure": function(ec.errors.compare),
              "fine": Argument(None, "listed", [1, "a", [], [None], {}, [1, 2]])}),
        Door("space_study",
             lambda spaces=(rough,), problem=problem, order=1, step=0.5, end=0.5, **o:
             space_study(spaces, problem, order, step, end, **o),
             {"spaces": several([rough]), "problem": one(problem), "order": whole(1, 0, 7),
              "step": number(0.5, 0, -1), "end": number(0.5, -1),
              "measure": function(ec.errors.compare)}),
        # theory
        Door("smallest_eta", ec.multipliers.smallest_eta, {"p": whole(3, 0, 6, *HUGE)}),
        Door("g_matrix", ec.multipliers.g_matrix,
             {"p": whole(3, 0, 6, *HUGE), "eta": number(0.5, 1, 2, -1, 0.0)}),
        Door("gammas", ec.multipliers.gammas,
             {"p": whole(3, 0, 6, *HUGE), "eta": number(0.5, 1, 2, -1, 0.0)}),
        Door("g_matrix_of", ec.multipliers.g_matrix_of,
             {"delta": array([1.5, -2.0, 0.5], [], rows=True), "mu": array([1.0], [], [1.0, 1.0], rows=True)}),
        Door("gammas_of", ec.multipliers.gammas_of,
             {"delta": array([1.5, -2.0, 0.5], [], rows=True), "mu": array([1.0], [], [1.0, 1.0], rows=True)}),
        Door("circle_polynomial", ec.multipliers.circle_polynomial,
             {"delta": array([1.5, -2.0, 0.5], [], rows=True), "mu": array([1.0], [], rows=True)}),
        Door("bdf_kernel", ec.peano.bdf_kernel,
             {"p": whole(2, 0, *HUGE), "degree": whole(1, 0, 3, optional=True)}),
        Door("extrapolation_kernel", ec.peano.extrapolation_kernel,
             {"p": whole(2, 0, *HUGE), "degree": whole(1, 0, 3, optional=True)}),
        Door("forms.mass", ec.forms.mass,
             {"space": one(space), "x": array(x), "weight": array(pairs, optional=True)}),
        Door("forms.stiffness", ec.forms.stiffness,
             {"space": one(space), "x": array(x),
              "tensor": array(np.ones((T, Q, 3, 3)), optional=True)}),
        Door("forms.divergence", ec.forms.divergence,
             {"space": one(space), "x": array(x), "v": array(x)}),
        Door("forms.deformation", ec.forms.deformation,
             {"space": one(space), "x": array(x), "v": array(x)}),
        Door("forms.mass_rate", ec.forms.mass_rate,
             {"space": one(space), "x": array(x), "v": array(x)}),
        Door("forms.stiffness_rate", ec.forms.stiffness_rate,
             {"space": one(space), "x": array(x), "v": array(x)}),
        Door("forms.check_symmetric", lambda matrix: ec.forms.check_symmetric("K", matrix),
             {"matrix": one(K, called=("K",))}),
        Door("forms.check_definite", lambda matrix: ec.forms.check_definite("K", matrix),
             {"matrix": one(K, called=("K",))}),
        Door("forms.lift", ec.forms.lift,
             {"space": one(space), "x": array(x), "surface": one(unit)}),
        Door("forms.near_of", ec.forms.near_of,
             {"surface": one(unit), "points": array(points, before=True, rows=True)}),
        Door("forms.check_surface", ec.forms.check_surface, {"surface": one(unit)}),
        Door("forms.relative_norm", ec.forms.relative_norm,
             {"form": one(M), "norm": one(K), "seminorm": flag(False)}),
        Door("dual_norm", ec.defects.dual_norm, {"K": one(K), "functional": array(u, after=True)}),
        Door("defects", ec.defects.defects,
             {"space": one(space), "problem": one(problem), "order": whole(1, 0),
              "step": number(0.1, 0, -1), "n": whole(2, 0, -1)}),
        Door("exact_values", ec.defects.exact_values,
             {"space": one(space), "problem": one(problem), "t": number(0.5)}),
        Door("rate_of_u", ec.defects.rate_of_u,
             {"space": one(space), "problem": one(problem), "t": number(0.5)}),
        Door("stretching", ec.defects.stretching,
             {"space": one(space), "x": array(x), "v": array(x), "u": array(u, after=True)}),
        Door("rate_of_mass", ec.defects.rate_of_mass,
             {"space": one(space), "x": array(x), "v": array(x), "u": array(u, after=True),
              "rate": array(u)}),
        Door("diffusion", ec.defects.diffusion,
             {"problem": one(problem), "A": one(A), "u": array(u, after=True)}),
        Door("source_load", ec.defects.source_load,
             {"space": one(space), "problem": one(problem), "x": array(x), "u": array(u, after=True),
              "t": number(0.5)}),
        Door("force_load", ec.defects.force_load,
             {"space": one(space), "problem": one(problem), "x": array(x), "u": array(u, after=True),
              "t": number(0.5)}),
        Door("spatial_defects", ec.defects.spatial_defects,
             {"space": one(space), "problem": one(problem), "t": number(0.5)}),
        Door("constant_diffusivity", ec.defects.constant_diffusivity, {"problem": one(problem)}),
        Door("regularised_law", ec.defects.regularised_law, {"problem": one(problem)}),
        Door("velocity_law", ec.defects.velocity_law, {"problem": one(problem)}),
        Door("temporal_terms_v", theory.defect_terms.temporal_terms_v,
             {"space": one(space), "problem": one(problem), "order": whole(2, 0, *HUGE),
              "step": number(0.1, 0, -1, called=("t",)), "t": number(0.5)}),
        Door("temporal_terms_u", theory.defect_terms.temporal_terms_u,
             {"space": one(space), "problem": one(problem),
              "order": whole(2, 0, *HUGE, called=("n",)),
              "step": number(0.1, 0, -1), "n": whole(4, 0, -1)}),
        Door("spatial_terms_u", theory.defect_terms.spatial_terms_u,
             {"space": one(rough), "problem": one(linear),
              "field": one(theory.defect_terms.Field(**near)),
              "t": number(0.5, called=("radius",))}),
        Door("spatial_terms_u, field", spatial_terms_u,
             {"surface": function(near["surface"]), "v": returning(near["v"]),
              "f": returning(near["f"])}),
        Door("error_terms", error_terms,
             {"space": one(rough), "order": whole(1, 0, *HUGE, called=("pairs",)),
              "step": number(0.25, 0, -1), "chosen": function(small),
              "pairs": Argument(compared, "listed", [None, 1, "a", [], {}, [1], [(1, 2)]])}),
        Door("proposition_1", theory.stability.proposition_1,
             {"terms": one(error_terms()), "corrected": flag(False)}),
        Door("tangent_projection", theory.geometry.tangent_projection,
             {"normal": array(points, before=True, rows=True)}),
        Door("apply", theory.geometry.apply,
             {"matrices": array(np.ones((T, Q, 3, 3)), called=("vectors",)),
              "vectors": array(np.ones((T, Q, 3)))}),
        Door("largest_norm", theory.geometry.largest_norm,
             {"tensors": array(np.ones((T, Q, 3)), after=True, rows=True)}),
        Door("lifted_norm", theory.geometry.lifted_norm,
             {"space": one(space), "x": array(x), "onto": one(onto),
              "values": array(np.ones((T, Q, 3)), after=True)}),
        Door("closest_point_derivative", theory.geometry.closest_point_derivative,
             {"surface": one(unit),
              "points": array(points, before=True, rows=True, called=("x",))}),
        Door("lift_operators", theory.geometry.lift_operators,
             {"space": one(space), "x": array(x), "surface": one(unit)}),
        Door("geometric_errors", geometric_errors,
             {"space": one(rough), "surface": function(growing),
              "motion": returning(lambda x, t: (1 + t) * x), "velocity": returning(lambda x: x),
              "u": returning(lambda x: x[..., 2]),
              "gradient": returning(lambda x: 0 * x + [0, 0, 1.0])}),
        Door("response", respond,
             {"space": one(rough), "problem": one(problem),
              "order": whole(1, 0, 7, *HUGE, called=("start",)),  # of which there are so many
              "step": number(0.25, 0, -1, 0.3), "end": number(0.5, -1, 0.7),
              "chosen": Argument(chosen, "listed",
                                 [None, 1, "a", [], {}, *misbehaving(
                                     None, 1, "a", (), {}, chosen(0)._replace(u=np.ones(2)),
                                     chosen(0)._replace(v=chosen(0).v * 1j),
                                     chosen(0)._replace(x=None), chosen(0)._replace(u="a"),
                                     chosen(0)._replace(u=chosen(0).u * NAN))]),
              "start": Argument([(0 * rough.nodes, np.zeros(len(rough.nodes)))], "listed",
                                [1, "a", [], {}, [None], [1], [(1, 2)], ["ab"],
                                 [(rough.nodes, rough.nodes)], [(rough.nodes * 1j, rough.nodes[:, 0])],
                                 [(rough.nodes * NAN, rough.nodes[:, 0])], object(), True])}),
        Door("prolongation", theory.ritz.prolongation, {"space": one(flat), "fine": one(space)}),
        Door("ritz_projection", theory.ritz.ritz_projection,
             {"space": one(flat), "x": array(flat.nodes), "fine": one(space), "y": array(x),
              "z": array(u)}),
        # solvers
        Door("LaggedSolver", ec.LaggedSolver,
             {"rtol": number(1e-9, 0, 1, -1), "price": whole(30, 0, -1),
              "factorise": function(solvers.superlu)}),
        Door("DirectSolver", ec.DirectSolver, {"factorise": function(solvers.superlu)}),
        Door("LaggedSolver.solve", lambda A=K, b=u, guess=u: ec.LaggedSolver().solve(A, b, guess),
             {"A": one(K), "b": array(u, after=True, called=("guess",)), "guess": array(u, finite=False)}),
        Door("DirectSolver.solve", lambda A=K, b=u, guess=u: ec.DirectSolver().solve(A, b, guess),
             {"A": one(K), "b": array(u, after=True)}),
        Door("superlu", solvers.superlu,
             {"A": one(K), "order": array(np.arange(n), np.zeros(n), optional=True)}),
        Door("cholmod", solvers.cholmod,
             {"A": one(K), "order": array(np.arange(n), np.zeros(n), optional=True)}),
        Door("factorise", solvers.factorise,
             {"A": one(K), "fronts": one(space.fronts),
              "dtype": Argument(None, "listed", ["no", int, complex, [], {}, object(), np.float16])}),
        # output
        Door("plot", ec.plot,
             {"state": one(last), "values": Argument("u", "listed", ["no", 1.0, [], u[:-1], {},
                                                                     lambda s: None]),
              "title": text("a", optional=True), "label": text("a", optional=True),
              "limits": array((0.0, 1.0), (1.0, 0.0), optional=True)}),
        Door("animate", ec.animate,
             {"states": several(states[:1]), "values": Argument("u", "listed", ["no", 1.0, [], {}]),
              "path": Argument(None, "listed", [1, [], "a.txt", "", b"a.gif"]),
              "title": text("a"), "label": text("a", optional=True),
              "limits": array((0.0, 1.0), (1.0, 0.0), optional=True),
              "duration": whole(80, 0, -1)}),
        Door("SeriesWriter", ec.SeriesWriter,
             {"path": Argument(str(folder / "b.pvd"), "listed",
                               [1, None, [], "a.txt", "", b"a", "/no/such/folder/a.pvd", True]),
              "normals": flag(False), "go_on": flag(False)}),
        Door("SeriesWriter.write", write_series, {"state": one(last)}),
        Door("TableWriter", ec.TableWriter,
             {"path": Argument(str(folder / "b.csv"), "listed",
                               [1, None, [], "a.txt", "", b"a", "/no/such/folder/a.csv", True])}),
        Door("TableWriter.write", write_table,
             {"row": Argument({"t": 0.1, "a": np.ones(2)}, "listed",
                              [None, 1, "a", [], {}, [1], object(), {1: 2.0},
                               {"a": 1j}, {"a": object()}, {"b": {}},
                               {"a": {"b": 1j}}], called=("rows",))}),
        Door("save_series", ec.save_series,
             {"path": Argument(str(folder / "a.pvd"), "listed", [1, None, [], "a.txt", "", b"a"]),
              "states": several(states[:1]), "normals": flag(False), "go_on": flag(False)}),
        Door("save_table", ec.save_table,
             {"path": Argument(str(folder / "a.csv"), "listed", [1, None, [], "a.txt", "", b"a"]),
              "rows": Argument([ec.measure(last)], "listed", [None, 1, "a", [1], [None], ["a"]])}),
    ]  # fmt: skip
    return made
