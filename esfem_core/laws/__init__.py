"""How a surface moves, and what moves with it: one law, one file."""

from esfem_core.laws.law import Law, Solve
from esfem_core.laws.prescribed import Prescribed
from esfem_core.laws.regularised import Regularised
from esfem_core.laws.species import Part, Species
from esfem_core.laws.values import values_at

__all__ = ["Law", "Part", "Prescribed", "Regularised", "Solve", "Species", "values_at"]
