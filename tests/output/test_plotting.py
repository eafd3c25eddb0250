"""Pictures: triangles keep orientation and area, the animation carries what it was given."""

from types import SimpleNamespace

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.elements import flat_triangles, node_indices
from esfem_core.output import convergence_plot, surface_animation


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 6])
def test_flat_triangles_tile_the_element_with_its_orientation(degree):
    indices = node_indices(degree)
    triangles = flat_triangles(np.arange(len(indices))[None], degree)
    assert triangles.shape == (degree**2, 3)
    a, b, c = np.moveaxis(indices[triangles, 1:], 1, 0)
    twice_the_area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (twice_the_area == 1).all()  # of degree**2: all of the same size, none turned
    assert len({frozenset(t) for t in triangles.tolist()}) == degree**2
    assert set(triangles.ravel().tolist()) == set(range(len(indices)))


@pytest.fixture
def run():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), degree=2, project=ec.to_unit_sphere)
    x = space.nodes
    return space, [SimpleNamespace(t=t, x=(1 + t) * x, u=x[:, 0]) for t in (0.0, 0.5, 1.0)]


def test_animation_names_its_picture_its_script_and_its_times(run, monkeypatch):
    space, states = run
    monkeypatch.setenv("ESFEM_PLOTLY_JS", "../_static/plotly.js")
    shown = surface_animation(space, states, title="a < b", div_id="here")
    text = shown._repr_html_()
    assert 'id="here"' in text
    assert 'src="../_static/plotly.js"' in text
    assert "a &lt; b" in text
    assert all(f'"label":"{t}"' in text for t in ("0", "0.5", "1"))
    assert text == surface_animation(space, states, title="a < b", div_id="here").text
    assert repr(shown) == "a < b: 3 frames, t = 0 to 1"


def test_animation_carries_its_script_where_no_page_has_one(run, monkeypatch):
    space, states = run
    monkeypatch.delenv("ESFEM_PLOTLY_JS", raising=False)
    text = surface_animation(space, states, values=lambda s: s.x[:, 2]).text
    assert "src=" not in text.split("<script")[1]
    assert len(text) > 1_000_000


def test_animation_refuses_what_it_cannot_draw(run):
    space, states = run
    with pytest.raises(ValueError, match="no state"):
        surface_animation(space, [])
    with pytest.raises(ValueError, match="one value per node"):
        surface_animation(space, states, values=lambda s: s.x)


def test_convergence_plot_refuses_what_has_no_logarithm_or_no_slope():
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    with pytest.raises(ValueError, match="u: only positive finite"):
        convergence_plot(ax, [0.1, 0.05], {"u": [1e-3, np.nan]}, 3, "step")
    with pytest.raises(ValueError, match="at least two different steps"):
        convergence_plot(ax, [0.1], {"u": [1e-3]}, 3, "step")
    with pytest.raises(ValueError, match="at least two different steps"):
        convergence_plot(ax, [0.1, 0.05], {"u": [1e-3]}, 3, "step")
