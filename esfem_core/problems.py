"""The papers' own problems, and two with simple exact solutions."""

from esfem_core.prescribed import baseball_bat, oscillating_ellipsoid
from esfem_core.spheres import expanding_sphere, growing_sphere, shrinking_sphere

__all__ = [
    "baseball_bat",
    "expanding_sphere",
    "growing_sphere",
    "oscillating_ellipsoid",
    "shrinking_sphere",
]
