"""Orders in time of positions, velocities and functions, against a fine run on the mesh."""

import esfem_core as ec
from esfem_core.study import final, observed_orders


def fine_run(space, problem, step, end, settled):
    """States from the time `settled` on, when the first moments, which are rough, are over."""
    run = ec.evolve(space, problem, 5, step, end, start="euler", solver="direct")
    return [state for state in run if state.t > settled - step / 2]


def temporal_orders(space, problem, p, steps, fine):
    """Between two steps; the runs start with states of the fine one."""
    last = fine[-1]
    M, errors = space.mass(last.x), []
    for step in steps:
        start = fine[:: round(step / (fine[1].t - fine[0].t))][:p]
        state = final(ec.evolve(space, problem, p, step, last.t, start=start, solver="direct"))
        pairs = {"x": (state.x, last.x), "v": (state.v, last.v)}
        pairs |= {name: (state[name], last[name]) for name in last.fields}
        errors.append({name: ec.errors.seminorm(M, a - b) for name, (a, b) in pairs.items()})
    return {name: observed_orders(steps, [e[name] for e in errors])[0].item() for name in errors[0]}
