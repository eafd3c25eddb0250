"""The book's own machinery: claims and verdicts, long runs and their stored results."""

from esfem_core.companion import (
    campaign,
    claims,
    dependencies,
    environment,
    experiments,
    revolution,
)

__all__ = [
    "campaign",
    "claims",
    "dependencies",
    "environment",
    "experiments",
    "revolution",
]
