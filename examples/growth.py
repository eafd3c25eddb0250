"""Growth driven by the solution: the surface moves outwards where there is much of u."""

import esfem_core as ec

space = ec.SurfaceSpace(ec.sphere("icosahedron", 3), degree=2, project=ec.to_unit_sphere)

# u diffuses and is conserved; the surface moves by  v - alpha lap v + beta H nu = g nu  with g = u,
# so that what is at the top, where u is 2, grows fastest. u thins out as the surface grows.
problem = ec.Problem(u0=lambda x: 1 + x[:, 2], g=lambda at: at.u, alpha=0.2, beta=0.1)

for state in ec.evolve(space, problem, order=3, step=1 / 40, end=1.0):
    if round(state.t * 40) % 10 == 0:
        m = ec.measure(state)
        print(f"t = {state.t:.2f}: area {m.area:.4f}, volume {m.volume:.4f}, u {m.amount:.6f}")

print(f"centre at the end: {m.centre[2]:.4f} above the origin")
print(f"smallest angle: {m.min_angle:.1f} degrees")
