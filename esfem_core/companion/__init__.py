"""The book's own machinery: claims and verdicts, long runs and their stored results."""

from esfem_core.companion import campaign, claims, experiments, figures, regimes, revolution, tori
from esfem_core.companion.checking import expect
from esfem_core.companion.scans import bunny

__all__ = [
    "bunny",
    "campaign",
    "claims",
    "expect",
    "experiments",
    "figures",
    "regimes",
    "revolution",
    "tori",
]
