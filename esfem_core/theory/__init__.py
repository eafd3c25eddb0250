"""What the proofs of both papers use, made computable."""

from esfem_core.theory import (
    defect_terms,
    defects,
    forms,
    geometry,
    multipliers,
    peano,
    ritz,
    stability,
)

__all__ = [
    "defect_terms",
    "defects",
    "forms",
    "geometry",
    "multipliers",
    "peano",
    "ritz",
    "stability",
]
